"""`auto`: several regressions, mixed pixel by pixel by their estimated error.

Candidates, from the simplest: the input as it is; a regression over a narrow window; the same over the whole window; a
second regression of its result over a wide window, every third pixel. Cross-validation between two halves of the
samples, or two halves made up from the variance, tells which is nearer to the truth. Where there is little noise, some
is added and all is done again, which tells how much of it the mix has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from ..engine import Engine, Planes
from ..stages.also import blend_also, fit_also
from ..stages.box import box_mean
from ..stages.choice import (
    SMOOTHING_RADIUS,
    VARIANCE_RADIUS,
    Target,
    compare,
    estimated_error,
    luminance_noise,
    mix_in,
    parts_of_mix,
    variance_left,
)
from ..stages.halves import difference_from_variance, difference_of_halves
from ..stages.luminance import luminance_around
from ..stages.pad import stack
from ..stages.regression import first_order_regression
from ..stages.response import disturb, disturb_by_halves
from ..stages.shrink import BLOCK, shrink_to_input
from ..stages.source import Source
from ..stages.terms import Terms
from ..stages.variance import channel_sum, clip, scale
from . import regression
from .facts import Facts, known_noise, quiet_frame, quiet_of
from .parameters import parameter
from .regression import NEEDS, USES, Prepared, align, finish, prepare, ridges, terms_for
from .result import Result

__all__ = ["NAME", "NEEDS", "SUMMARY", "USES", "Parameters", "align", "reach", "run", "survey"]

NAME = "auto"
SUMMARY = "regressions over narrow, middle and wide windows, mixed by their estimated error"

#: In the order of `Result.shares`, from the simplest.
CANDIDATES = ("input", "narrow", "regression", "wide")


@dataclass(frozen=True)
class Parameters(regression.Parameters):
    """Those of `regression` for the first pass, whose window may be smaller where another follows, and what the second
    pass and the choice need (bench/sweep.py)."""

    search_radius: int = parameter(
        6, "the first fits use discs of 2 r + 1 pixels across, and of half that", low=0, high=10
    )
    wide_radius: int = parameter(3, "the second fit uses a disc of 2 r + 1 pixels across", low=1, high=7)
    wide_stride: int = parameter(3, "and takes every so many-th pixel", low=1, high=6)
    wide_bandwidth: float = parameter(1.8, "how far its colours may differ, in units of the noise left", low=1e-3)
    tracking: float = parameter(0.01, "part of the noise that the weights of the first pass follow", low=0.0, high=1.0)
    doubt: float = parameter(0.42, "how soon an uncertain choice becomes the usual mix", low=0.0)
    caution: float = parameter(0.1, "by how much the input must be better to be kept", low=0.0)


#: The input is kept as it is where the fit differs from it by less than about 2 KEEP² of its variance: there is next to
#: nothing to gain.
KEEP = 0.05

#: Residuals count up to so many standard deviations of the noise, whose tails are long.
LIMIT = 1.0

#: `apart` of `mix_in`: noise that the first fit has left does not make the second one twice as bright or dark. Beside a
#: light a thousand times as bright the second takes the wall for a dark part of the light, and nothing else tells: all
#: errors there are small beside those of the light.
APART = 1.0


def reach(p: Parameters) -> int:
    """Rows that a pixel depends on to each side.

    One after the other: what `regression` does, with terms for the wider of the windows; the second fit, whose noise
    is a mean; three comparisons and that of the error map, two means each, of frames whose luminance is a mean; blocks
    to shrink by, two to each side and the rest of their own.
    """
    wide = p.wide_radius * p.wide_stride
    first = regression.reach(p) + max(wide - p.search_radius, 0)
    return first + wide + 1 + VARIANCE_RADIUS + 4 * 2 * SMOOTHING_RADIUS + 1 + 3 * BLOCK


def survey(engine: Engine, source: Source, p: Parameters) -> Facts:
    """What bands need to know of the whole frame."""
    return replace(regression.survey(engine, source, p), quiet=quiet_of(engine, source))


def run(engine: Engine, planes: dict[str, Planes], p: Parameters, facts: Facts | None = None) -> Result:
    """Door to exit without the door and the exit: planes in, planes out."""
    frame = prepare(engine, planes, p, facts)
    noisy = stack(engine, [frame.color, _half_difference(engine, planes, frame, facts)], 0)
    terms = terms_for(engine, frame, max(p.search_radius, p.wide_radius * p.wide_stride), facts)
    known = bool(known_noise(planes))
    if known:
        quiet = facts.quiet if facts else quiet_frame(engine, planes)
    window = {"search_radius": p.search_radius, "patch_radius": p.patch_radius, "bandwidth": p.bandwidth}
    window |= {"with_inner": True}
    fits = partial(_ready, engine, channel_sum(engine, frame.variance), terms, p, window)
    (current, also), (narrow, also_narrow) = fit_also(engine, fits(frame.color), noisy, frame.also)
    window = {"search_radius": p.wide_radius, "patch_radius": 1, "bandwidth": p.wide_bandwidth, "stride": p.wide_stride}
    second_fit = partial(_ready, engine, variance_left(engine, current), terms, p, window)
    ((wide, also_wide),) = fit_also(engine, second_fit(current.part(0, 3)), current, also)

    def mix_layers_in(candidate: Planes | None, share: Planes) -> None:
        if also is not None:
            blend_also(engine, also, candidate, share)

    target = Target(
        noisy, box_mean(engine, luminance_noise(engine, frame.variance), 1), luminance_around(engine, current)
    )
    # The wide fit takes half where nothing is known: two estimates of like error average to a better one.
    found = compare(engine, current, wide, target, tracking=p.tracking, limit=LIMIT)
    wide_share = mix_in(engine, current, wide, found, prior=0.5, doubt=p.doubt, margin=0.0, apart=APART)
    mix_layers_in(also_wide, wide_share)
    found = compare(engine, current, narrow, target, tracking=-p.tracking, limit=LIMIT)
    narrow_share = mix_in(engine, current, narrow, found, prior=0.0, doubt=p.doubt, margin=0.0)
    mix_layers_in(also_narrow, narrow_share)
    filtered = stack(engine, [current], 0)

    if known:
        target = replace(target, noise=luminance_noise(engine, frame.raw_variance))
    found = compare(engine, current, noisy, target, tracking=0.0, limit=LIMIT, known=True)
    input_share = mix_in(engine, current, noisy, found, prior=1.0, doubt=KEEP, margin=p.caution)
    mix_layers_in(frame.also, input_share)
    if known:
        disturbed = None
        if quiet():  # the one thing that the host has to know; it was asked for before all fits
            color = _disturbed(engine, planes, frame, facts)
            mix, narrow = fits(color)(color)
            (wide,) = second_fit(mix)(mix)
            for candidate, share in ((wide, wide_share), (narrow, narrow_share), (color, input_share)):
                blend_also(engine, mix, candidate, share, "response")
            disturbed = color, mix
        layers = also, frame.also
        shrink_to_input(engine, current, noisy, frame.raw_variance, input_share, *layers, disturbed=disturbed)
    error = partial(estimated_error, engine, filtered, target, input_share)
    shares = parts_of_mix(engine, wide_share, narrow_share, input_share)
    return finish(engine, frame, current.part(0, 3), also, p, terms, facts, shares=shares, error=error)


def _ready(
    engine: Engine, variance: Planes, terms: Terms | None, p: Parameters, window: dict[str, Any], tone: Planes
) -> Callable[..., tuple[Planes, ...]]:
    """`first_order_regression` over a window, guided by `tone`: ready but for what is fitted."""
    return partial(first_order_regression, engine, tone, variance, terms, **window, **ridges(p))


def _disturbed(engine: Engine, planes: dict[str, Planes], frame: Prepared, facts: Facts | None) -> Planes:
    if "color_a" not in planes:
        return disturb(engine, frame.color, frame.raw_variance, facts.rows.start if facts else 0)
    return disturb_by_halves(
        engine, frame.color, planes["color_a"], planes["color_b"], _factor(engine, frame), frame.exposure
    )


def _factor(engine: Engine, frame: Prepared) -> Planes:
    """What each pixel was multiplied by: 1 where outliers stayed."""
    return frame.factor or clip(engine, frame.color.part(0, 1), 1.0, 1.0)


def _half_difference(engine: Engine, planes: dict[str, Planes], frame: Prepared, facts: Facts | None) -> Planes:
    if "color_a" not in planes:
        estimated = "color_variance" not in planes
        first = facts.rows.start if facts else 0
        return difference_from_variance(engine, frame.variance if estimated else frame.raw_variance, first)
    halves = [scale(engine, planes[name], frame.exposure) for name in ("color_a", "color_b")]
    return difference_of_halves(engine, *halves, _factor(engine, frame))
