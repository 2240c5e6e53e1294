"""The exit: planes become the interleaved array that the user gets."""

from __future__ import annotations

import numpy as np

from ..engine import Engine, Planes
from .door import Strided, type_define


def leave(engine: Engine, planes: Planes, target: Strided) -> None:
    """Planes (C, H, W) to an interleaved (H, W, C) array of float16 (clamped to its range), float32 or float64."""
    height, width, row = planes.height, planes.width, target.strides[0]
    macros = type_define(engine, target.dtype, "TARGET")
    packed = planes.channels == 3 and target.strides[1:] == (3, 1) and target.dtype != np.float64
    if packed and engine.shape.width > 1:
        kernel = engine.kernel("exit.cl", "leave_packed", PACKED=None, **macros)
        size = engine.vectors(width), height
        engine.launch("exit", kernel, size, planes, height, width, target.buffer, target.offset, row)
        return
    kernel = engine.kernel("exit.cl", "leave", **macros)
    size = width, height
    engine.launch("exit", kernel, size, planes, planes.channels, height, width, target.buffer, *target.layout)
