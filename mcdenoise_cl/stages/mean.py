"""The mean of each plane."""

from __future__ import annotations

import pyopencl as cl

from ..engine import Engine, Planes


def plane_means(engine: Engine, image: Planes) -> cl.MemoryObjectHolder:
    """The mean of the absolute values of each plane, one float a plane, on the device."""
    rows, out = engine.memory(4 * image.channels * image.height), engine.memory(4 * image.channels)
    kernel = engine.kernel("mean.cl", "row_means")
    engine.launch("mean", kernel, (image.height, image.channels), image, image.height, image.width, rows, single=True)
    kernel = engine.kernel("mean.cl", "plane_means")
    engine.launch("mean", kernel, (image.channels,), rows, image.height, out, single=True)
    return out
