"""`regression`: first-order regression on albedo, normal and depth, weighted by NLM (Bitterli et al. 2016).

An average blurs wherever the signal has a slope; a fit follows it. The method takes what the frame has: features and
their variances, the variance of the colour or two half buffers; what is missing is left out or estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from ..stages.box import box_mean
from ..stages.exposure import auto_exposure, inverse_geometric_mean
from ..stages.noise import noise_level
from ..stages.outliers import scale_outliers, spread_removed
from ..stages.pad import pad, stack
from ..stages.prefilter import prefilter
from ..stages.regression import first_order_regression
from ..stages.variance import (
    clip,
    depth_feature,
    depth_feature_variance,
    scale,
    variance_from_halves,
    variance_from_image,
)
from .parameters import parameter
from .result import Result

NAME = "regression"
SUMMARY = "first-order regression on albedo, normal and depth, weighted by NLM"
NEEDS: tuple[str, ...] = ()
USES = (
    *("albedo", "normal", "depth", "albedo_variance", "normal_variance", "depth_variance"),
    *("color_variance", "color_a", "color_b"),
)


@dataclass(frozen=True)
class Parameters:
    """Chosen by measurement (bench/sweep.py)."""

    search_radius: int = parameter(7, "the fit uses (2 r + 1)² pixels", low=0, high=10)
    patch_radius: int = parameter(2, "patches are (2 r + 1)² pixels, and half as wide", low=0, high=8)
    bandwidth: float = parameter(0.65, "how far colours may differ, in units of their noise", low=1e-3)
    ridge: float = parameter(0.02, "regularisation of every term, relative to its spread", low=1e-5)
    noise_ridge: float = parameter(5.0, "regularisation by the noise that a feature still has", low=0.0)
    position_ridge: float = parameter(0.1, "regularisation of the slope that no feature explains", low=0.0)
    outliers: bool = parameter(True, "scale fireflies down to their neighbours and spread what was removed")
    outlier_limit: float = parameter(1.0, "an outlier is brighter than this many times its neighbours", low=1.0)
    spread_radius: int = parameter(50, "three boxes of this radius, in pixels, spread removed light", low=0, high=1024)
    exposure: float | None = parameter(
        None, "factor that brings colours to order 1; none: 0.18 / log-average luminance", kind=float, low=1e-30
    )


def run(engine: Engine, planes: dict[str, Planes], p: Parameters) -> Result:
    """Door to exit without the door and the exit: planes in, planes out."""
    exposure = engine.constant([p.exposure]) if p.exposure is not None else auto_exposure(engine, planes["color"])
    color = scale(engine, planes["color"], exposure)
    level = noise_level(engine, color)
    variance = _color_variance(engine, planes, color, exposure)
    removed = scale_outliers(engine, color, variance, p.outlier_limit) if p.outliers else None
    variance = box_mean(engine, variance, 2)
    groups = _features(engine, planes)
    features = None
    if groups:
        features = (
            stack(engine, [feature for feature, _ in groups], p.search_radius),
            stack(engine, [left for _, left in groups], 0),
        )
    border = p.search_radius + p.patch_radius
    color = pad(engine, color, border)
    out = first_order_regression(
        engine,
        color,
        pad(engine, variance, border),
        features,
        color,
        search_radius=p.search_radius,
        patch_radius=p.patch_radius,
        bandwidth=p.bandwidth,
        ridge=p.ridge,
        noise_ridge=p.noise_ridge,
        position_ridge=p.position_ridge,
    )
    if removed is not None:
        out = spread_removed(engine, out, removed, p.spread_radius)
    return Result(scale(engine, out, exposure, -1), exposure, level)


def _color_variance(
    engine: Engine, planes: dict[str, Planes], color: Planes, exposure: cl.MemoryObjectHolder
) -> Planes:
    """Of the pixel mean, in exposed units: as the frame has it, else from its halves, else from the image."""
    if "color_variance" in planes:
        return scale(engine, planes["color_variance"], exposure, 2)
    if "color_a" in planes:
        halves = [scale(engine, planes[name], exposure) for name in ("color_a", "color_b")]
        return variance_from_halves(engine, *halves)
    return variance_from_image(engine, color)


def _features(engine: Engine, planes: dict[str, Planes]) -> list[tuple[Planes, Planes]]:
    """Each feature that is there, prefiltered if its variance is there, and the variance that is left."""
    groups = []
    for name in ("albedo", "normal", "depth"):
        if name not in planes:
            continue
        feature, variance = planes[name], planes.get(f"{name}_variance")
        if name == "albedo":
            feature = clip(engine, feature, 0.0, 1.0)
        elif name == "depth":
            inverse_scale = inverse_geometric_mean(engine, feature)
            if variance is not None:
                variance = depth_feature_variance(engine, feature, variance, inverse_scale)
            feature = depth_feature(engine, feature, inverse_scale)
        if variance is None:
            groups.append((feature, clip(engine, feature, 0.0, 0.0)))  # zeros: taken as exact
        else:
            groups.append(prefilter(engine, feature, variance))
    return groups
