"""The exit: planes become the interleaved array that the user gets."""

from __future__ import annotations

from ..engine import Engine, Planes
from .door import Strided, type_define


def leave(engine: Engine, planes: Planes, target: Strided) -> None:
    """Planes (C, H, W) to an interleaved (H, W, C) array of float16 (clamped to its range), float32 or float64."""
    kernel = engine.kernel("exit.cl", "leave", **type_define(engine, target.dtype, "TARGET"))
    size = (planes.width, planes.height)
    engine.launch(
        "exit", kernel, size, planes, planes.channels, planes.height, planes.width, target.buffer, *target.layout
    )
