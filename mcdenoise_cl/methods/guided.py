"""`guided`: a linear function of albedo, normal and depth, fitted over uniform windows; the fastest that uses features.

A guided filter (He et al. 2010) with several guides and errors that count relatively, followed by a Wiener filter of
what it left: where the residual is larger than the noise explains, that much of the pixel comes back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..engine import Engine, Planes
from ..stages.box import rows_each
from ..stages.box_fit import LIGHT_RADIUS, box_fit
from ..stages.outliers import spread_removed
from ..stages.source import ALSO
from ..stages.variance import scale_back
from .facts import Facts, exposed
from .features import (
    COLOR_VARIANCES,
    FEATURE_VARIANCES,
    FEATURES,
    REACH,
    color_variance,
    exposed_layers,
    features,
    hold_back_outliers,
    no_variance,
    plain_feature,
)
from .parameters import parameter
from .regression import survey
from .result import Result

__all__ = ["NAME", "NEEDS", "SUMMARY", "USES", "Parameters", "align", "reach", "run", "survey"]

NAME = "guided"
SUMMARY = "guided filter with albedo, normal and depth as guides: fast, at some cost in accuracy"
NEEDS: tuple[str, ...] = ()
USES = (*FEATURES, *FEATURE_VARIANCES, *COLOR_VARIANCES)


@dataclass(frozen=True)
class Parameters:
    """Chosen by measurement (bench/sweep.py)."""

    block: int = parameter(2, "one function is fitted for each block of so many pixels a side", low=1, high=8)
    radius: int = parameter(2, "it is fitted to (2 r + 1)² blocks", low=0, high=8)
    relative: float = parameter(
        2.0, "errors count by 1 / luminance to this power: 0 as they are, 2 relatively", low=0.0, high=3.0
    )
    ridge: float = parameter(0.01, "regularisation of every feature, relative to its variance in the window", low=0.0)
    noise_ridge: float = parameter(0.5, "regularisation by the variance that a feature has as noise", low=0.0)
    floor: float = parameter(3e-5, "regularisation of every feature, absolute; features are of order 1", low=1e-6)
    residual_radius: int = parameter(1, "residual and noise are compared over (2 r + 1)² blocks", low=0, high=64)
    residual_noise: float = parameter(
        1.0, "how much of the residual is noise, in units of the colour's variance; 0 leaves the colour alone", low=0.0
    )
    prefilter: bool = parameter(False, "filter noisy features first: a little more accurate, slower")
    outliers: bool = parameter(True, "scale fireflies down to their neighbours and spread what was removed")
    outlier_limit: float = parameter(1.0, "an outlier is brighter than this many times its neighbours", low=1.0)
    spread_radius: int = parameter(50, "three boxes of this radius, in pixels, spread removed light", low=0, high=1024)
    exposure: float | None = parameter(
        None,
        "factor that brings colours to order 1; none: 0.18 / log-average luminance",
        kind=float,
        low=1e-30,
        high=1e30,
    )


def reach(p: Parameters) -> int:
    """Rows that a pixel depends on to each side: its block's window, twice, and the residual's, in whole blocks."""
    stretch = 2 * p.radius + 1  # of blocks, that windows are joined from
    return REACH + LIGHT_RADIUS + p.block * (2 * p.radius + p.residual_radius + 3 + stretch)


def align(engine: Engine, p: Parameters) -> int:
    """Means begin with the first row, some of them with the first row of blocks."""
    of_blocks = rows_each(engine, p.radius), rows_each(engine, p.residual_radius)
    return math.lcm(rows_each(engine, LIGHT_RADIUS), *(p.block * rows for rows in of_blocks))


def run(engine: Engine, planes: dict[str, Planes], p: Parameters, facts: Facts | None = None) -> Result:
    """Door to exit without the door and the exit: planes in, planes out."""
    exposure, color, level = exposed(engine, planes["color"], p.exposure, facts)
    variance = color_variance(engine, planes, color, exposure)
    removed = factor = None
    if p.outliers:
        removed, factor = hold_back_outliers(engine, planes, color, variance, p.outlier_limit)
    also, also_removed = exposed_layers(engine, planes, exposure, factor)
    guides, noise = _guides(engine, planes, p.prefilter, facts)
    out, also = box_fit(
        engine,
        color,
        variance,
        guides,
        noise,
        block=p.block,
        radius=p.radius,
        residual_radius=p.residual_radius,
        relative=p.relative,
        ridge=p.ridge,
        noise_ridge=p.noise_ridge,
        floor=p.floor,
        residual_noise=p.residual_noise,
        first=facts.rows.start if facts else 0,
        also=also,
    )
    if facts is None:
        if removed is not None:
            out, also = spread_removed(engine, out, removed, p.spread_radius, also, also_removed)
        out = scale_back(engine, out, exposure, planes["color"])
        also = scale_back(engine, also, exposure, planes[ALSO]) if also else None
    return Result(
        out,
        exposure,
        level,
        removed=removed,
        kept=color,
        also=also,
        also_removed=also_removed,
        exposed=facts is not None,
    )


def _guides(
    engine: Engine, planes: dict[str, Planes], prefiltered: bool, facts: Facts | None
) -> tuple[list[Planes], list[Planes]]:
    """The features that are there as planes of order 1, and the variances of their noise; none if there are none."""
    names = [name for name in FEATURES if name in planes]
    noisy = any(f"{name}_variance" in planes for name in names)
    if not names:
        return [], []
    if prefiltered and noisy:
        guides, noises = zip(*features(engine, planes, facts), strict=True)
    else:
        guides, noises = zip(*(_plain(engine, planes, name, noisy, facts) for name in names), strict=True)
    return list(guides), list(noises) if noisy else []


def _plain(
    engine: Engine, planes: dict[str, Planes], name: str, noisy: bool, facts: Facts | None
) -> tuple[Planes, Planes | None]:
    """`plain_feature`, its variance 0 where it is not known but that of others is."""
    feature, variance = plain_feature(engine, planes, name, facts)
    return feature, no_variance(engine, feature) if variance is None and noisy else variance
