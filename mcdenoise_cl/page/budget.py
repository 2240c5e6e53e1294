"""How finely light is stored, so that a page stays under a size."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ParameterError
from .planes import STEPS, Plane, packed, quantise, restore

#: Bytes of a page of a frame of 1280 x 720 pixels or fewer; larger frames may take more in proportion.
BYTES, PIXELS = 10e6, 1280 * 720
#: Room for everything but the planes.
REST = 150_000
#: Rows that a guess looks at, and every how many.
ROWS, EVERY = 16, 64


@dataclass(frozen=True)
class Packed:
    """Planes as text.

    Attributes:
        planes: as they are stored: their steps may have grown.
        texts: one a plane.
        step: that of light.
        worst, mean: largest and mean error of light from 1/128 of display white up, relative to it.
        fits: whether they fit into the budget.
    """

    planes: list[Plane]
    texts: list[str]
    step: float
    worst: float
    mean: float
    fits: bool


def bytes_for(height: int, width: int, max_mb: float | None) -> float:
    """What a page may take.

    Raises:
        ParameterError: `max_mb` is no room for any page.

    Example:
        >>> bytes_for(360, 640, None), bytes_for(2160, 3840, None), bytes_for(360, 640, 20)
        (10000000.0, 90000000.0, 20000000.0)
    """
    if max_mb is None:
        return BYTES * max(1.0, height * width / PIXELS)
    if not max_mb >= 1:
        raise ParameterError(f"max_mb is {max_mb:g} but a page needs at least 1 MB: leave it out for 10 MB at 1280x720")
    return 1e6 * max_mb


def pack(planes: Sequence[Plane], budget: float, on_progress: Callable[[int, int], None] | None = None) -> Packed:
    """All planes as text, light in the finest of `STEPS` with which they take no more than `budget` bytes.

    Where even the widest step takes more, that one is used.
    """
    progress = on_progress or (lambda done, total: None)
    fixed = {plane.name: packed(plane) for plane in planes if plane.kind != "light"}
    light = [plane for plane in planes if plane.kind == "light"]
    room = budget - REST - sum(map(len, fixed.values()))
    first = _guess(light, room)
    for step in STEPS[first:]:
        texts: dict[str, str] = {}
        for plane in light:
            progress(len(texts), len(light))
            texts[plane.name] = packed(replace(plane, step=step))
            if sum(map(len, texts.values())) > room and step != STEPS[-1]:
                break
        else:
            break
    progress(len(light), len(light))
    stored = [replace(plane, step=step) if plane.kind == "light" else plane for plane in planes]
    worst, mean = errors(plane for plane in stored if plane.kind == "light")
    texts |= fixed
    fits = sum(map(len, texts.values())) <= budget - REST
    return Packed(stored, [texts[plane.name] for plane in stored], step, worst, mean, fits)


def errors(planes) -> tuple[float, float]:
    """Largest and mean relative error of what is at least 1/128 of display white; 0 where nothing is."""
    worst = total = count = 0.0
    for plane in planes:
        values = np.asarray(plane.values, np.float64)
        how = plane.scale, plane.step, plane.dark
        seen = np.isfinite(values) & (plane.scale * np.abs(values) >= plane.dark)
        relative = np.abs(restore(quantise(values, *how), *how)[seen] / values[seen] - 1)
        worst = max(worst, float(relative.max(initial=0)))
        total, count = total + float(relative.sum()), count + relative.size
    return worst, total / max(count, 1)


def _guess(light: Sequence[Plane], room: float) -> int:
    """The first of `STEPS` worth trying, judged by some of the rows."""
    height = light[0].values.shape[0]
    rows = np.arange(height)
    if height > 4 * ROWS:
        rows = rows[rows % EVERY < ROWS]
    for index, step in enumerate(STEPS):
        size = sum(len(packed(replace(plane, values=plane.values[rows], step=step))) for plane in light)
        # Every fourth row makes for a slightly worse prediction than all of them.
        if 0.98 * size * height / len(rows) <= room:
            return index
    return len(STEPS) - 1
