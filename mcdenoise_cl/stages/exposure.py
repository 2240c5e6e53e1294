"""Exposure, and the tonemapped domain in which colours are compared."""

from __future__ import annotations

import pyopencl as cl

from ..engine import Engine, Planes

#: Middle grey: what the log-average luminance is mapped to.
KEY = 0.18


def auto_exposure(engine: Engine, color: Planes, key: float = KEY) -> cl.MemoryObjectHolder:
    """key / (geometric mean of the luminance over pixels above 0): one float on the device; 1 for a black frame."""
    height, width = color.height, color.width
    sums, counts, out = engine.memory(4 * height), engine.memory(4 * height), engine.memory(4)
    rows = engine.kernel("exposure.cl", "log_luminance_rows")
    engine.launch("exposure", rows, (height,), color, height, width, sums, counts)
    join = engine.kernel("exposure.cl", "exposure_from_rows")
    engine.launch("exposure", join, (1,), sums, counts, height, float(key), out)
    return out


def tonemap(engine: Engine, color: Planes, exposure: cl.MemoryObjectHolder) -> Planes:
    """clip(exposure * color, 0, 1)^(1/2.2)."""
    return _map(engine, "tonemap", color, exposure)


def tonemap_inverse(engine: Engine, tone: Planes, exposure: cl.MemoryObjectHolder) -> Planes:
    """tone^2.2 / exposure, for tone in [0, 1]."""
    return _map(engine, "tonemap_inverse", tone, exposure)


def _map(engine: Engine, name: str, planes: Planes, exposure: cl.MemoryObjectHolder) -> Planes:
    out = engine.planes(planes.channels, planes.height, planes.width)
    size = (engine.vectors(planes.width), planes.height, planes.channels)
    kernel = engine.kernel("exposure.cl", name)
    engine.launch("tonemap", kernel, size, planes, planes.height, planes.width, exposure, out)
    return out
