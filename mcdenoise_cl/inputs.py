"""What is given to a denoiser, checked before any work."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from .errors import FrameError
from .frame import PLANES, Frame
from .methods import Method


def as_frame(frame_or_color: Any, planes: dict[str, Any]) -> Frame:
    """A Frame from a Frame, or from a colour array and keyword planes."""
    unknown = [name for name in planes if name not in PLANES or name == "color"]
    if unknown:
        raise FrameError(f"{unknown[0]} is not a plane of a frame: the planes are {', '.join(PLANES)}")
    if not isinstance(frame_or_color, Frame):
        return Frame(frame_or_color, **planes)
    if any(plane is not None for plane in planes.values()):
        raise FrameError("a Frame is given and planes beside it: put every plane into the Frame")
    return frame_or_color


def check_frame(frame: Frame, size: tuple[int, int], method: Method, out: Any) -> None:
    """Refuse a frame of another size or without a plane that the method needs, and an `out` that does not fit.

    Raises:
        FrameError: one of these.
    """
    if frame.shape != size:
        raise FrameError(
            f"the frame is {frame.shape} but this Denoiser was made for {size}: make another for this size"
        )
    present = frame.planes()
    for name in method.needs:
        if name not in present:
            raise FrameError(f"method {method.name!r} needs {name}, which is missing: pass it, or use 'nlm'")
    if out is None:
        return
    # Frame knows what an image array must be; `out` is one more of them.
    candidate = Frame(out)
    if candidate.shape != frame.shape or candidate.on_device != frame.on_device:
        raise FrameError(
            f"out is {'device' if candidate.on_device else 'host'} memory of shape {tuple(out.shape)} but "
            f"{'device' if frame.on_device else 'host'} memory of shape {tuple(frame.color.shape)} is needed"
        )
    if not frame.on_device and not out.flags.writeable:
        raise FrameError("out is read-only: pass an array that can be written")


def check_neighbours(neighbours: Iterable[Frame], frame: Frame, names: Iterable[str]) -> list[Frame]:
    """The neighbours of a frame; `names` are the planes that they must have.

    Raises:
        FrameError: one that is no frame, the frame itself, of another size or side, or lacks a plane.
    """
    near, names = list(neighbours), list(names)
    for i, neighbour in enumerate(near):
        if not isinstance(neighbour, Frame):
            raise FrameError(f"neighbours[{i}] is a {type(neighbour).__name__} but a Frame is needed")
        if neighbour is frame:
            raise FrameError(f"neighbours[{i}] is the frame itself, which adds nothing: leave it out")
        if neighbour.shape != frame.shape:
            raise FrameError(
                f"neighbours[{i}] is {neighbour.shape} but the frame is {frame.shape}: all frames of a sequence "
                "share height and width"
            )
        if neighbour.on_device != frame.on_device:
            sides = ("device", "host") if neighbour.on_device else ("host", "device")
            raise FrameError(
                f"neighbours[{i}] is in {sides[0]} memory but the frame is in {sides[1]} memory: pass every frame "
                "on the same side"
            )
        missing = [name for name in names if name not in neighbour.planes()]
        if missing:
            raise FrameError(
                f"neighbours[{i}] has no {missing[0]} but the frame has: pass it, or leave it out of the frame"
            )
    return near
