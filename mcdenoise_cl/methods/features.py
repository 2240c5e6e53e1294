"""What a frame tells besides its colour, brought to a form that regressions can use."""

from __future__ import annotations

import math

import pyopencl as cl

from ..engine import Engine, Planes
from ..stages.also import hold_back_also
from ..stages.exposure import inverse_geometric_mean
from ..stages.outliers import scale_outliers
from ..stages.prefilter import prefilter
from ..stages.source import ALSO
from ..stages.variance import (
    about,
    clip,
    depth_feature,
    depth_feature_variance,
    first_pixel,
    known_variance,
    scale,
    variance_from_halves,
    variance_from_image,
)
from .facts import Facts, known_noise

FEATURES = ("albedo", "normal", "depth")
FEATURE_VARIANCES = tuple(f"{name}_variance" for name in FEATURES)
COLOR_VARIANCES = ("color_variance", "color_a", "color_b")

#: An outlier that stands out by more than so many standard deviations is a small light, or texture. In the image alone
#: nothing tells a light from a firefly.
SIGNIFICANT = 3.0


def color_variance(engine: Engine, planes: dict[str, Planes], color: Planes, exposure: cl.MemoryObjectHolder) -> Planes:
    """Of the pixel mean, in exposed units: as the frame has it, else from its halves, else from the image.

    Where a frame has it but not at a pixel, which the door then gives `UNKNOWN`, that pixel's comes from the image.
    """
    if "color_variance" in planes:
        return known_variance(engine, planes["color_variance"], color, exposure)
    if "color_a" in planes:
        halves = [scale(engine, planes[name], exposure) for name in ("color_a", "color_b")]
        return variance_from_halves(engine, *halves)
    return variance_from_image(engine, color)


def hold_back_outliers(
    engine: Engine, planes: dict[str, Planes], color: Planes, variance: Planes, limit: float
) -> tuple[Planes, Planes]:
    """`scale_outliers`, in place, for a frame with these planes: what was removed, and the factor of each pixel."""
    significant = SIGNIFICANT if known_noise(planes) else math.inf
    return scale_outliers(engine, color, variance, limit, significant, by_chance="color_variance" not in planes)


def exposed_layers(
    engine: Engine, planes: dict[str, Planes], exposure: cl.MemoryObjectHolder, factor: Planes | None
) -> tuple[Planes | None, Planes | None]:
    """Further layers in exposed units, scaled where outliers of the colour were, and what that removed."""
    if ALSO not in planes:
        return None, None
    layers = scale(engine, planes[ALSO], exposure)
    return layers, hold_back_also(engine, layers, factor) if factor else None


def plain_feature(
    engine: Engine, planes: dict[str, Planes], name: str, facts: Facts | None
) -> tuple[Planes, Planes | None]:
    """A feature on a scale of order 1, as noisy as it came, and its variance; None where that is not known.

    Where a scale begins does not matter: fits and distances know differences only.
    """
    feature, variance = planes[name], planes.get(f"{name}_variance")
    if name == "albedo":
        feature = clip(engine, feature, 0.0, 1.0)
    elif name == "normal":
        # A position, say, that comes in its place may lie anywhere.
        feature = about(engine, feature, facts.first_normal if facts else first_pixel(engine, feature))
    elif name == "depth":
        inverse_scale = facts.inverse_depth if facts else inverse_geometric_mean(engine, feature)
        if variance is not None:
            variance = depth_feature_variance(engine, feature, variance, inverse_scale)
        feature = depth_feature(engine, feature, inverse_scale)
    return feature, variance


def no_variance(engine: Engine, feature: Planes) -> Planes:
    """Zeros, for a feature that is taken as exact."""
    return clip(engine, feature, 0.0, 0.0)


def features(engine: Engine, planes: dict[str, Planes], facts: Facts | None) -> list[tuple[Planes, Planes]]:
    """Each feature that is there, prefiltered if its variance is there, and the variance that is left."""
    groups = []
    for name in FEATURES:
        if name in planes:
            feature, variance = plain_feature(engine, planes, name, facts)
            exact = variance is None
            groups.append((feature, no_variance(engine, feature)) if exact else prefilter(engine, feature, variance))
    return groups


#: Rows that `features` and `hold_back_outliers` together look to each side.
REACH = 8
