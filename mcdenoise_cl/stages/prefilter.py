"""Features filtered by NLM with their own variances (Rousselle et al. 2013)."""

from __future__ import annotations

from ..engine import Engine, Planes
from .box import box_mean
from .pad import pad
from .variance import channel_sum, clip

SEARCH_RADIUS, PATCH_RADIUS = 2, 1


def prefilter(engine: Engine, feature: Planes, variance: Planes) -> tuple[Planes, Planes]:
    """A feature of one or three planes, and the variance of its pixel mean, to the filtered feature and its variance.

    Search window 5x5, patches 3x3; the variance is clipped to 1 (features lie in [-1, 1]) and smoothed over 3x3.
    """
    variance = box_mean(engine, clip(engine, variance, 0.0, 1.0), 1)
    border = SEARCH_RADIUS + PATCH_RADIUS
    height, width, channels = feature.height, feature.width, feature.channels
    padded = [pad(engine, image, border) for image in (feature, variance, channel_sum(engine, variance))]
    out, left = engine.planes(channels, height, width), engine.planes(channels, height, width)
    kernel = engine.kernel("prefilter.cl", "prefilter", **engine.tile_defines(PATCH_RADIUS), CHANNELS=channels)
    size = engine.tiles(height, width)
    engine.launch("prefilter", kernel, size, *padded, height, width, SEARCH_RADIUS, out, left, single=True)
    return out, left
