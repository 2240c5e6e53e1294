"""Variances of the pixel mean from what a frame has, and features brought to a common scale."""

from __future__ import annotations

import pyopencl as cl

from ..engine import Engine, Planes

#: A variance below 0 is one that is not known: there is none in a frame, and the door says so where all around is lost.
UNKNOWN = -1.0


def variance_from_halves(engine: Engine, a: Planes, b: Planes) -> Planes:
    """(a - b)² / 4: an unbiased, noisy estimate of the variance of (a + b) / 2 for independent a and b."""
    return _map(engine, "variance_from_halves", a, b)


def variance_from_image(engine: Engine, image: Planes) -> Planes:
    """The squared response to Immerkaer's mask over 36: the variance of white noise; texture counts as noise."""
    return _map(engine, "variance_from_image", image)


def known_variance(engine: Engine, variance: Planes, image: Planes, factor: cl.MemoryObjectHolder) -> Planes:
    """variance * factor², and where that is below 0, which says that it is not known, `variance_from_image`."""
    return _map(engine, "known_variance", variance, image, after=(factor,))


def channel_sum(engine: Engine, planes: Planes) -> Planes:
    """The sum over the planes, one plane."""
    out = engine.planes(1, planes.height, planes.width)
    kernel = engine.kernel("variance.cl", "channel_sum")
    size = (planes.width, planes.height)
    engine.launch("variance", kernel, size, planes, planes.channels, planes.height, planes.width, out)
    return out


def scale(engine: Engine, planes: Planes, factor: cl.MemoryObjectHolder) -> Planes:
    """planes * factor."""
    return _map(engine, "scale", planes, after=(factor,))


def scale_back(engine: Engine, planes: Planes, factor: cl.MemoryObjectHolder, before: Planes) -> Planes:
    """planes / factor; `before` itself, to the last bit, where planes are what `scale` made of it."""
    return _map(engine, "scale_back", planes, before, after=(factor,))


def clip(engine: Engine, planes: Planes, low: float, high: float) -> Planes:
    """Values limited to [low, high]."""
    return _map(engine, "clip", planes, after=(float(low), float(high)))


def first_pixel(engine: Engine, planes: Planes) -> cl.MemoryObjectHolder:
    """The first pixel of every plane, one float each, on the device."""
    out = engine.memory(4 * planes.channels)
    kernel = engine.kernel("variance.cl", "first_pixel")
    engine.launch("variance", kernel, (1,), planes, planes.channels, out, single=True)
    return out


def about(engine: Engine, planes: Planes, pixel: cl.MemoryObjectHolder) -> Planes:
    """Every plane less its value of a pixel: for features, of which only differences count."""
    return _map(engine, "about", planes, after=(pixel,))


def depth_feature(engine: Engine, depth: Planes, inverse_scale: cl.MemoryObjectHolder) -> Planes:
    """z / (z + scale) - 1/2, in [-1/2, 1/2); -1/2 for z <= 0."""
    return _map(engine, "depth_feature", depth, after=(inverse_scale,))


def depth_feature_variance(
    engine: Engine, depth: Planes, variance: Planes, inverse_scale: cl.MemoryObjectHolder
) -> Planes:
    """The variance of `depth_feature`, by its derivative."""
    return _map(engine, "depth_feature_variance", depth, variance, after=(inverse_scale,))


def _map(engine: Engine, name: str, *inputs: Planes, after: tuple = ()) -> Planes:
    first = inputs[0]
    out = engine.planes(first.channels, first.height, first.width)
    size = (first.width, first.height, first.channels)
    engine.launch("variance", engine.kernel("variance.cl", name), size, *inputs, first.height, first.width, *after, out)
    return out
