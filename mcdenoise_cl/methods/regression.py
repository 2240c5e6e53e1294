"""`regression`: first-order regression on albedo, normal and depth, weighted by NLM (Bitterli et al. 2016).

An average blurs wherever the signal has a slope; a fit follows it. The method takes what the frame has: features and
their variances, the variance of the colour or two half buffers; what is missing is left out or estimated.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import pyopencl as cl

from ..engine import Engine, Planes
from ..stages.also import fit_also
from ..stages.box import rows_each
from ..stages.luminance import smooth_variance
from ..stages.outliers import spread_removed
from ..stages.pad import stack
from ..stages.regression import first_order_regression
from ..stages.source import ALSO, Source
from ..stages.terms import BLOCK_ROWS, Terms, choose_terms
from ..stages.variance import channel_sum, scale, scale_back
from .facts import Facts, exposed, exposure_of, first_normal_of, inverse_depth_of, noise_of
from .features import (
    COLOR_VARIANCES,
    FEATURE_VARIANCES,
    FEATURES,
    REACH,
    color_variance,
    exposed_layers,
    features,
    hold_back_outliers,
)
from .parameters import parameter
from .result import Result

NAME = "regression"
SUMMARY = "first-order regression on albedo, normal and depth, weighted by NLM"
NEEDS: tuple[str, ...] = ()
USES = (*FEATURES, *FEATURE_VARIANCES, *COLOR_VARIANCES)


@dataclass(frozen=True)
class Parameters:
    """Chosen by measurement (bench/sweep.py)."""

    search_radius: int = parameter(7, "the fit uses a disc of 2 r + 1 pixels across", low=0, high=10)
    patch_radius: int = parameter(2, "patches are (2 r + 1)² pixels, and half as wide", low=0, high=8)
    bandwidth: float = parameter(0.72, "how far colours may differ, in units of their noise", low=1e-3)
    ridge: float = parameter(0.02, "regularisation of every term, relative to its spread", low=1e-5)
    noise_ridge: float = parameter(5.0, "regularisation by the noise that a feature still has", low=0.0)
    position_ridge: float = parameter(0.1, "regularisation of the slope that no feature explains", low=0.0)
    outliers: bool = parameter(True, "scale fireflies down to their neighbours and spread what was removed")
    outlier_limit: float = parameter(1.1, "an outlier is brighter than this many times its neighbours", low=1.0)
    spread_radius: int = parameter(50, "three boxes of this radius, in pixels, spread removed light", low=0, high=1024)
    exposure: float | None = parameter(
        None,
        "factor that brings colours to order 1; none: 0.18 / log-average luminance",
        kind=float,
        low=1e-30,
        high=1e30,
    )


@dataclass(frozen=True)
class Prepared:
    """A frame ready to be fitted, in exposed units.

    Attributes:
        exposure, level: as in `Result`.
        given: the colour as it came, before exposure.
        color: three planes, outliers scaled down.
        raw_variance, variance: of the pixel mean, three planes, before and after smoothing over 5x5, relative
            to the luminance.
        removed, factor: what was taken from outliers, and what each pixel was multiplied by; None if they stayed.
        features, noise: stacked planes of the features and of the variance they have left; None without any.
        names: the feature that each plane belongs to.
        also_given, also, also_removed: further layers of the colour as they came, exposed and scaled as it was, and
            what they lost by that; None without any, or where outliers stayed.
    """

    exposure: cl.MemoryObjectHolder
    level: cl.MemoryObjectHolder
    given: Planes
    color: Planes
    raw_variance: Planes
    variance: Planes
    removed: Planes | None
    factor: Planes | None
    features: Planes | None
    noise: Planes | None
    names: tuple[str, ...]
    also_given: Planes | None
    also: Planes | None
    also_removed: Planes | None


def prepare(engine: Engine, planes: dict[str, Planes], p: Parameters, facts: Facts | None = None) -> Prepared:
    """Expose, hold back outliers, prefilter the features."""
    exposure, color, level = exposed(engine, planes["color"], p.exposure, facts)
    variance = color_variance(engine, planes, color, exposure)
    removed = factor = None
    if p.outliers:
        removed, factor = hold_back_outliers(engine, planes, color, variance, p.outlier_limit)
    also, also_removed = exposed_layers(engine, planes, exposure, factor)
    groups = features(engine, planes, facts)
    both = [stack(engine, list(each), 0) for each in zip(*groups, strict=True)] or [None, None]
    names = [name for name in FEATURES if name in planes]
    names = [name for name, (feature, _) in zip(names, groups, strict=True) for _ in range(feature.channels)]
    smooth = smooth_variance(engine, variance, color, 2)
    return Prepared(
        exposure,
        level,
        planes["color"],
        color,
        variance,
        smooth,
        removed,
        factor,
        *both,
        tuple(names),
        planes.get(ALSO),
        also,
        also_removed,
    )


def survey(engine: Engine, source: Source, p: Parameters) -> Facts:
    """What bands need to know of the whole frame."""
    exposure = exposure_of(engine, source, p.exposure)
    level = noise_of(engine, source, lambda color: scale(engine, color, exposure))
    return Facts(exposure, level, inverse_depth_of(engine, source), first_normal_of(engine, source))


def reach(p: Parameters) -> int:
    """Rows that a pixel depends on to each side: those that it takes to prepare it, a block of terms, the window."""
    return REACH + BLOCK_ROWS + 2 * p.search_radius + p.patch_radius


def align(engine: Engine, p: Parameters) -> int:
    """Means begin with the first row; tiles and blocks of terms are smaller."""
    return rows_each(engine, 0)


def terms_for(engine: Engine, frame: Prepared, reach: int, facts: Facts | None = None) -> Terms | None:
    """The features that carry something within `reach`."""
    if frame.features is None:
        return None
    return choose_terms(engine, frame.features, frame.noise, reach, facts.rows if facts else None)


def ridges(p: Parameters) -> dict[str, Any]:
    """What `first_order_regression` takes of the parameters for any window."""
    return {"ridge": p.ridge, "noise_ridge": p.noise_ridge, "position_ridge": p.position_ridge}


def run(engine: Engine, planes: dict[str, Planes], p: Parameters, facts: Facts | None = None) -> Result:
    """Door to exit without the door and the exit: planes in, planes out."""
    frame = prepare(engine, planes, p, facts)
    terms = terms_for(engine, frame, p.search_radius, facts)
    fit = partial(
        first_order_regression,
        engine,
        frame.color,
        channel_sum(engine, frame.variance),
        terms,
        search_radius=p.search_radius,
        patch_radius=p.patch_radius,
        bandwidth=p.bandwidth,
        **ridges(p),
    )
    ((out, also),) = fit_also(engine, fit, frame.color, frame.also)
    return finish(engine, frame, out, also, p, terms, facts)


def finish(
    engine: Engine,
    frame: Prepared,
    out: Planes,
    also: Planes | None,
    p: Parameters,
    terms: Terms | None,
    facts: Facts | None = None,
    **found: Any,
) -> Result:
    """Give the light of the outliers back, undo the exposure, and hand on what was found.

    Light goes further than a band: there both are left to those who have all of them.
    """
    if facts is None:
        if frame.removed is not None:
            out, also = spread_removed(engine, out, frame.removed, p.spread_radius, also, frame.also_removed)
        out = scale_back(engine, out, frame.exposure, frame.given)
        also = scale_back(engine, also, frame.exposure, frame.also_given) if also else None
    return Result(
        out,
        frame.exposure,
        frame.level,
        removed=frame.removed,
        kept=frame.color,
        feature_names=frame.names,
        terms=terms,
        also=also,
        also_removed=frame.also_removed,
        exposed=facts is not None,
        **found,
    )
