"""Exposure, and the tonemapped domain in which colours are compared."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import pyopencl as cl

from ..engine import Engine, Planes

#: Middle grey: what the log-average luminance is mapped to.
KEY = 0.18
#: Bins of 8 octaves of luminance; each has a column of sums and counts, as has everything (exposure.cl).
BINS = 32
COLUMNS = BINS + 1
#: A pixel more bins than this below the brightest ones is black: 24 to 32 octaves, 2e7 to 4e9 times as dark.
RANGE = 3
#: Names of the curves, in the order of exposure.cl.
CURVES = ("clip", "reinhard")


def auto_exposure(engine: Engine, color: Planes, key: float = KEY) -> cl.MemoryObjectHolder:
    """key / (geometric mean of the luminance over pixels that are not black): one float on the device.

    Black is what is not above 0, or more than 24 to 32 octaves below the level that the brightest 1 % of the others
    reach. 1 for a black frame.
    """
    return exposure_of_bands(engine, [(color, 0)], color.height, key)


def exposure_of_bands(
    engine: Engine, bands: Iterable[tuple[Planes, int]], height: int, key: float = KEY, bins: int = RANGE
) -> cl.MemoryObjectHolder:
    """`auto_exposure` of a frame of `height` rows that comes in bands: planes, and the row where they begin.

    Args:
        bins: of 8 octaves each, that count below the one of the brightest 1 %.
    """
    row_sums, row_counts = engine.memory(4 * COLUMNS * height), engine.memory(4 * COLUMNS * height)
    sums, counts, out = engine.memory(4 * COLUMNS), engine.memory(4 * COLUMNS), engine.memory(4)
    rows = engine.kernel("exposure.cl", "log_luminance_rows")
    for color, first in bands:
        size = color.height, color.width
        engine.launch("exposure", rows, size[:1], color, *size, first, row_sums, row_counts, single=True)
    add = engine.kernel("exposure.cl", "add_rows")
    engine.launch("exposure", add, (COLUMNS,), row_sums, row_counts, height, sums, counts, single=True)
    mean = engine.kernel("exposure.cl", "exposure_from_bins")
    engine.launch("exposure", mean, (1,), sums, counts, float(key), bins, out, single=True)
    return out


def inverse_geometric_mean(engine: Engine, plane: Planes) -> cl.MemoryObjectHolder:
    """1 / (geometric mean of the values above 0) of one plane: one float on the device; 1 if there is none."""
    return inverse_geometric_mean_of_bands(engine, [(plane, 0)], plane.height)


def inverse_geometric_mean_of_bands(
    engine: Engine, bands: Iterable[tuple[Planes, int]], height: int
) -> cl.MemoryObjectHolder:
    """`inverse_geometric_mean` of a plane that comes in bands."""
    grey = ((replace(plane, channels=1, plane=0), first) for plane, first in bands)
    return exposure_of_bands(engine, grey, height, 1.0, bins=BINS)


def tonemap(engine: Engine, color: Planes, exposure: cl.MemoryObjectHolder, curve: str = "clip") -> Planes:
    """(f(exposure * color))^(1/2.2), with f(x) = clip(x, 0, 1), or x / (1 + x) for the curve "reinhard"."""
    return _map(engine, "tonemap", color, after=(exposure, CURVES.index(curve)))


def tonemap_inverse(engine: Engine, tone: Planes, exposure: cl.MemoryObjectHolder, curve: str = "clip") -> Planes:
    """The colour that `tonemap` maps to `tone`, for tone in [0, 1]."""
    return _map(engine, "tonemap_inverse", tone, after=(exposure, CURVES.index(curve)))


def compress(engine: Engine, color: Planes, exposure: cl.MemoryObjectHolder) -> Planes:
    """x / (1 + |x|) of x = exposure * color: for averages that a firefly cannot dominate."""
    return _map(engine, "compress", color, after=(exposure,))


def expand(engine: Engine, compressed: Planes, exposure: cl.MemoryObjectHolder, color: Planes) -> Planes:
    """The inverse of `compress`, for values in (-1, 1); where nothing changed, `color` to the last bit."""
    return _map(engine, "expand", compressed, color, after=(exposure,))


def compress_also(engine: Engine, layer: Planes, color: Planes, exposure: cl.MemoryObjectHolder) -> Planes:
    """The part of a compressed colour that a layer of it is: exposure * layer / (1 + |exposure * color|)."""
    return _map(engine, "compress_also", layer, color, after=(exposure,))


def expand_also(
    engine: Engine, part: Planes, layer: Planes, color: Planes, averaged: Planes, exposure: cl.MemoryObjectHolder
) -> Planes:
    """What `expand` does to `averaged`, done to a layer's part of it; where nothing changed, the layer itself."""
    return _map(engine, "expand_also", part, layer, color, averaged, after=(exposure,))


def scale_as(engine: Engine, layer: Planes, before: Planes, after: Planes) -> Planes:
    """layer * after / before; 0 where `before` is not above 0."""
    return _map(engine, "scale_as", layer, before, after)


def _map(engine: Engine, name: str, *inputs: Planes, after: tuple = ()) -> Planes:
    first = inputs[0]
    out = engine.planes(first.channels, first.height, first.width)
    size = (engine.vectors(first.width), first.height, first.channels)
    kernel = engine.kernel("exposure.cl", name)
    engine.launch("tonemap", kernel, size, *inputs, first.height, first.width, *after, out)
    return out
