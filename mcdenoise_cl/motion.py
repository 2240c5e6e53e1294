"""Motion vectors of a frame and those beside it become the `motion` of its neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .errors import FrameError
from .frame import Frame


def with_motion(frame: Frame, neighbours: Sequence[Frame], offsets: Sequence[int | None]) -> list[Frame]:
    """The neighbours of a frame, each with its `motion` where vectors lead there.

    The vectors of a frame, `to_previous` and `to_next`, lead to the frames right before and after it. From there the
    neighbour's own vectors lead on, so that further ones are reached along a chain. Where it breaks, because a frame is
    missing or has no vectors, the rest stay as they are, and motion is searched for.

    Args:
        frame: a host frame.
        neighbours: host frames of its size.
        offsets: how many frames after it each of them is: -1 is the one right before; None: not known.

    Raises:
        FrameError: there are more or fewer offsets than neighbours, or the sizes differ.

    Example:
        >>> here, after = (Frame(np.ones((2, 3, 3), np.float32), to_next=np.full((2, 3, 2), k)) for k in (1.0, 4.0))
        >>> moved = with_motion(here, [after, after, after], [1, 2, 4])
        >>> [None if near.motion is None else near.motion[0, 0].tolist() for near in moved]
        [[1.0, 1.0], [5.0, 5.0], None]
    """
    moved = list(neighbours)
    if len(offsets) != len(moved):
        raise FrameError(f"{len(moved)} neighbours and {len(offsets)} offsets are given: pass one offset for each")
    if other := next((near for near in moved if near.shape != frame.shape), None):
        raise FrameError(f"a neighbour is {other.shape} but the frame is {frame.shape}: pass frames of one size")
    places = {offset: i for i, offset in enumerate(offsets) if offset}
    for step, name in ((-1, "to_previous"), (1, "to_next")):
        here, offset, motion = frame, step, None
        while offset in places and (vectors := getattr(here, name)) is not None:
            motion = vectors if motion is None else _on(motion, vectors)
            here = moved[places[offset]] = replace(moved[places[offset]], motion=motion)
            offset += step
    return moved


def _on(motion: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """`motion`, and on by the `vectors` of the pixel nearest to where it leads: between those of two objects lies the
    motion of neither."""
    height, width = motion.shape[:2]
    motion = np.nan_to_num(motion.astype(np.float32))
    x = np.clip(np.rint(np.arange(width) + motion[..., 0]), 0, width - 1).astype(int)
    y = np.clip(np.rint(np.arange(height)[:, None] + motion[..., 1]), 0, height - 1).astype(int)
    return motion + np.nan_to_num(vectors[y, x].astype(np.float32))
