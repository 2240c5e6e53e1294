"""Mixing filtered frames by their estimated error.

A frame is four planes here: three colours, and the half difference that its filter left of the input's (see
`halves`): what cross-validation needs to judge each half by the other.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..engine import Engine, Planes
from .box import box_mean

#: Estimates are box means of this radius, taken twice; the variance left in a frame is one of the other.
SMOOTHING_RADIUS, VARIANCE_RADIUS = 4, 3


@dataclass(frozen=True)
class Target:
    """What frames are judged by.

    Attributes:
        frame: the input: three colours and its half difference.
        noise: variance of the luminance of its pixels.
        surroundings: mean luminance around each pixel, of a filtered frame.
    """

    frame: Planes
    noise: Planes
    surroundings: Planes


def luminance_noise(engine: Engine, variance: Planes) -> Planes:
    """The variance of the luminance, of noise that the channels share: one plane of three."""
    return _one_plane(engine, "luminance_variance", variance)


def variance_left(engine: Engine, frame: Planes) -> Planes:
    """The sum over the channels of the variance that a filtered frame has left, one plane, smoothed over 7x7."""
    return box_mean(engine, _one_plane(engine, "variance_left", frame), VARIANCE_RADIUS)


def compare(
    engine: Engine,
    current: Planes,
    candidate: Planes,
    target: Target,
    *,
    tracking: float,
    limit: float,
    known: bool = False,
) -> Planes:
    """How much nearer to the truth a candidate is than the middle of the two; its square; their squared distance.

    Args:
        tracking: part of the input's noise that `current` follows more than `candidate` does.
        limit: residuals count up to this many standard deviations.
        known: the noise of each pixel is known, and with it the spread of what is found, which need not be looked for.

    Returns:
        Three smoothed planes, relative to the squared luminance of the surroundings.
    """
    found = engine.planes(3, current.height, current.width)
    inputs = current, candidate, target.frame, target.noise, target.surroundings
    _launch(engine, "compare", found, *inputs, after=(float(tracking), float(limit), int(known)))
    return _smooth(engine, found)


def mix_in(
    engine: Engine,
    current: Planes,
    candidate: Planes,
    found: Planes,
    *,
    prior: float,
    doubt: float,
    margin: float,
    apart: float = 1e30,
) -> Planes:
    """Make `current`, in place, the mix with the least estimated error.

    Args:
        found: what `compare` returned for the two.
        prior: the candidate's share where nothing is known.
        doubt: how soon a share goes there: standard deviations of g per unit of q.
        margin: standard deviations of g by which the candidate must be better.
        apart: luminances that differ by more than so many times the smaller one are doubted, from twice that on the
            candidate gets nothing.

    Returns:
        The candidate's share, one plane.
    """
    share = engine.planes(1, current.height, current.width)
    numbers = float(prior), float(doubt), float(margin), float(apart)
    kernel, size = engine.kernel("choice.cl", "mix_in"), (engine.vectors(share.width), share.height)
    engine.launch("choice", kernel, size, current, candidate, found, share.height, share.width, *numbers, share)
    return share


def parts_of_mix(engine: Engine, wide: Planes, narrow: Planes, original: Planes) -> Planes:
    """Four planes, what each frame contributes where shares were mixed in in this order: input, narrow, first, wide."""
    out = engine.planes(4, wide.height, wide.width)
    _launch(engine, "parts_of_mix", out, wide, narrow, original)
    return out


def estimated_error(engine: Engine, frame: Planes, target: Target, share: Planes) -> Planes:
    """The relative squared error of a mix of a filtered frame with the input: one plane.

    Args:
        frame: the filtered frame, before the input was mixed in.
        share: the input's share in the mix.
    """
    found = compare(engine, frame, target.frame, target, tracking=0.0, limit=1e30)
    squares = []
    for each in (target.frame, frame):
        square = engine.planes(1, share.height, share.width)
        _launch(engine, "relative_square", square, each, target.surroundings)
        squares.append(_smooth(engine, square))
    out = engine.planes(1, share.height, share.width)
    _launch(engine, "estimated_error", out, found, *squares, share)
    return out


def _smooth(engine: Engine, planes: Planes) -> Planes:
    return box_mean(engine, box_mean(engine, planes, SMOOTHING_RADIUS), SMOOTHING_RADIUS)


def _one_plane(engine: Engine, name: str, image: Planes) -> Planes:
    out = engine.planes(1, image.height, image.width)
    _launch(engine, name, out, image)
    return out


def _launch(engine: Engine, name: str, out: Planes, *inputs: Planes, after: tuple = ()) -> None:
    size = (out.width, out.height)
    engine.launch("choice", engine.kernel("choice.cl", name), size, *inputs, out.height, out.width, *after, out)
