"""Features filtered by NLM with their own variances (Rousselle et al. 2013)."""

from __future__ import annotations

from ..engine import Engine, Planes
from .box import box_mean
from .group import items, patch_defines
from .pad import pad
from .variance import channel_sum, clip

SEARCH_RADIUS, PATCH_RADIUS = 2, 1
#: Pixels to a work-item of the group schedule; see prefilter_group.cl for what they cost.
GROUP_OUTPUTS = 2


def prefilter(engine: Engine, feature: Planes, variance: Planes) -> tuple[Planes, Planes]:
    """A feature of one or three planes, and the variance of its pixel mean, to the filtered feature and its variance.

    The search window is a disc of 5 pixels across, patches are 3x3; the variance is clipped to 1 (features lie in
    [-1, 1]) and smoothed over 3x3.
    """
    variance = box_mean(engine, clip(engine, variance, 0.0, 1.0), 1)
    border = SEARCH_RADIUS + PATCH_RADIUS
    height, width, channels = feature.height, feature.width, feature.channels
    padded = [pad(engine, image, border) for image in (feature, variance, channel_sum(engine, variance))]
    out, left = engine.planes(channels, height, width), engine.planes(channels, height, width)
    if engine.shape.schedule == "group":
        cut = patch_defines(engine, PATCH_RADIUS, GROUP_OUTPUTS)
        kernel = engine.kernel("prefilter_group.cl", "prefilter_group", **cut, CHANNELS=channels)
        arguments = (*padded, height, width, SEARCH_RADIUS, out, left)
        engine.launch("prefilter", kernel, items(height, width, cut), *arguments, local=engine.shape.group)
    else:
        defines = engine.tile_defines(PATCH_RADIUS) | {"SEARCH_RADIUS": SEARCH_RADIUS, "CHANNELS": channels}
        kernel = engine.kernel("prefilter.cl", "prefilter", **defines)
        engine.launch("prefilter", kernel, engine.tiles(height, width), *padded, height, width, out, left, single=True)
    return out, left
