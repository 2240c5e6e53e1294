"""Guided filter (He et al. 2010; Yang 2022, eqs. 1-3)."""

from __future__ import annotations

import pyopencl as cl

from ..engine import Engine, Planes
from .box import box_mean


def references(engine: Engine, guide: Planes, image: Planes) -> cl.MemoryObjectHolder:
    """The values of the middle pixel, which `guided_filter` counts from: of the guide, then of each channel."""
    out = engine.memory(4 * (1 + image.channels))
    kernel = engine.kernel("guided.cl", "guided_references")
    engine.launch("guided", kernel, (1,), guide, image, image.channels, image.height, image.width, out, single=True)
    return out


def guided_filter(
    engine: Engine,
    guide: Planes,
    image: Planes,
    radius: int,
    epsilon: float,
    start: cl.MemoryObjectHolder | None = None,
) -> Planes:
    """Filter every plane of `image` by the one-plane `guide`.

    In each (2 radius + 1)² window the output is a linear function of the guide, a I + b with
    a = cov(I, F) / (var(I) + epsilon); a pixel gets the mean of the functions of all windows it lies in. Values are
    counted from `start`, those of `references` of the frame that the planes are a part of; None for their own.
    """
    channels, height, width = image.channels, image.height, image.width
    size = (width, height)
    start = references(engine, guide, image) if start is None else start
    products = engine.planes(2 + 2 * channels, height, width)
    kernel = engine.kernel("guided.cl", "guided_products")
    engine.launch("guided", kernel, size, guide, image, channels, height, width, start, products)
    means = box_mean(engine, products, radius)
    coefficients = engine.planes(2 * channels, height, width)
    kernel = engine.kernel("guided.cl", "guided_coefficients")
    engine.launch("guided", kernel, size, means, channels, height, width, float(epsilon), coefficients)
    del products, means
    smooth = box_mean(engine, coefficients, radius)
    out = engine.planes(channels, height, width)
    kernel = engine.kernel("guided.cl", "guided_apply")
    engine.launch("guided", kernel, size, smooth, guide, image, channels, height, width, start, out)
    return out
