"""Outliers scaled down, and the energy that this removes spread over the surroundings."""

from __future__ import annotations

from ..engine import Engine, Planes
from .box import box_mean


def scale_outliers(
    engine: Engine, color: Planes, variance: Planes, limit: float, significant: float
) -> tuple[Planes, Planes]:
    """Scale pixels brighter than `limit` times the brightest of their eight neighbours down to that, in place.

    `variance` (three planes, of the pixel mean) is scaled with its colour. A pixel that stands out by more than
    `significant` of its own standard deviations stays: it is no outlier but a small light.

    Returns:
        What was removed: three planes, 0 where nothing was; and the factor of each pixel, one plane.
    """
    height, width = color.height, color.width
    factor, removed = engine.planes(1, height, width), engine.planes(3, height, width)
    kernel = engine.kernel("outliers.cl", "outlier_factor")
    numbers = float(limit), float(significant)
    engine.launch("outliers", kernel, (width, height), color, variance, height, width, *numbers, factor)
    kernel = engine.kernel("outliers.cl", "apply_factor")
    engine.launch("outliers", kernel, (width, height), factor, color, variance, height, width, removed)
    return removed, factor


def spread_removed(engine: Engine, image: Planes, removed: Planes, radius: int) -> Planes:
    """Give the removed energy back: blurred by three box means, half of it evenly, half in proportion to brightness."""
    height, width = image.height, image.width
    size = (width, height)
    blurred = _blur(engine, removed, radius)
    even, gray = engine.planes(3, height, width), engine.planes(1, height, width)
    kernel = engine.kernel("outliers.cl", "add_evenly")
    engine.launch("outliers", kernel, size, image, blurred, height, width, even, gray)
    gray = _blur(engine, gray, radius)
    out = engine.planes(3, height, width)
    kernel = engine.kernel("outliers.cl", "add_in_proportion")
    engine.launch("outliers", kernel, size, even, blurred, gray, height, width, out)
    return out


def _blur(engine: Engine, image: Planes, radius: int) -> Planes:
    for _ in range(3):
        image = box_mean(engine, image, radius)
    return image
