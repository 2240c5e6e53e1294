"""Neighbouring frames merged into a frame: where it has moved, what is the same, and their weighted mean."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from .box import box_mean
from .pad import stack
from .variance import channel_sum, clip

#: Displacements that are searched, in pixels to each side.
SEARCH_RADIUS = 4
#: Pixels a side of the blocks that are searched for.
BLOCK = 8
#: Rows that motion vectors are followed for.
FARTHEST = 64
#: Windows over which the features and the light of a pixel are compared.
MISMATCH_RADIUS, LIGHT_RADIUS = 1, 3
#: Variances that come from the image alone are smoothed over 3x3 pixels.
VARIANCE_RADIUS = 1


@dataclass(frozen=True)
class Look:
    """What frames are compared by.

    Attributes:
        guide: planes of features, and of the colour where there is no albedo, then the sums of their variances, one for
            each of `names`; a mirrored border of SEARCH_RADIUS.
        names: of "albedo", "normal", "depth" and "color".
        light: three planes of colour, outliers held back, and the sum of their variances.
        factor: what was left of each pixel, one plane.
    """

    guide: Planes
    names: tuple[str, ...]
    light: Planes
    factor: Planes


def look_at(
    engine: Engine,
    features: dict[str, tuple[Planes, Planes | None]],
    color: Planes,
    variance: Planes,
    factor: Planes,
    guessed: bool,
) -> Look:
    """A `Look`: features with their variances, or None; the colour with its variance, which may be `guessed` from the
    image alone, and what outliers were left.

    Variances stay those of each pixel: that of an edge says nothing of the pixel beside it.
    """
    noise = channel_sum(engine, variance)
    if guessed:
        noise = box_mean(engine, noise, VARIANCE_RADIUS)
    light = stack(engine, [color, noise], 0)
    # Only the albedo shows all that the colour does.
    groups = features if "albedo" in features else features | {"color": (color, variance)}
    planes, noises = [], []
    for name, (plane, spread) in groups.items():
        planes.append(clip(engine, plane, 0.0, 1.0) if name == "albedo" else plane)
        if spread is None:
            noises.append(clip(engine, plane.part(0, 1), 0.0, 0.0))
        else:
            noises.append(noise if name == "color" else channel_sum(engine, spread))
    return Look(stack(engine, planes + noises, SEARCH_RADIUS), tuple(groups), light, factor)


def match_costs(engine: Engine, own: Look, other: Look) -> Planes:
    """How much each block of 8x8 pixels differs from `other` at each offset: a plane an offset, row by row. Beside each
    row of blocks, to both sides, is a 0."""
    height, width = own.light.height, own.light.width
    down, across, offsets = -(-height // BLOCK), -(-width // BLOCK), (2 * SEARCH_RADIUS + 1) ** 2
    costs = engine.planes(offsets, down, across, 1)
    kernel = _kernel(engine, "motion.cl", "match_costs", own)
    size = 2 * SEARCH_RADIUS + 1, across, down
    engine.launch("motion", kernel, size, own.guide, other.guide, height, width, costs, single=True)
    return costs


def find_motion(engine: Engine, own: Look, other: Look) -> Planes:
    """How many pixels each block of 8x8 has moved from `own` to `other`, two planes, to the right and down; and how
    much it differs there."""
    costs = match_costs(engine, own, other)
    motion = engine.planes(3, costs.height, costs.width)
    size, arguments = (_vectors(engine, costs.width), costs.height), (costs, own.light.height, own.light.width, motion)
    engine.launch("motion", _kernel(engine, "motion.cl", "find_motion", own), size, *arguments)
    return motion


def choose_motion(engine: Engine, own: Look, other: Look, given: Planes) -> Planes:
    """Motion vectors, two planes of pixels, but in blocks where they cost more than what is found the latter."""
    height, width = own.light.height, own.light.width
    found = find_motion(engine, own, other)
    costs = engine.planes(2, found.height, found.width)
    arguments = own.guide, other.guide, given, height, width, costs
    engine.launch("motion", _kernel(engine, "motion.cl", "vector_costs", own), (found.width, found.height), *arguments)
    motion = engine.planes(2, height, width)
    arguments = found, costs, given, height, width, motion
    engine.launch("motion", _kernel(engine, "motion.cl", "choose_motion", own), (width, height), *arguments)
    return motion


@dataclass(frozen=True)
class Weights:
    """Of the four pixels of another frame that a pixel has moved between.

    Attributes:
        taps: four planes; their sum is the weight of that frame, 0 to 1.
        motion: of blocks, or of pixels, as `find_motion` gives it.
        look: of the other frame.
    """

    taps: Planes
    motion: Planes
    look: Look


def weigh(engine: Engine, own: Look, other: Look, motion: Planes, total: Planes) -> Weights:
    """Compare a frame with another one where it has moved to; `total`, one plane, grows by the weights."""
    height, width = own.light.height, own.light.width
    tests, taps = engine.planes(8, height, width), engine.planes(4, height, width)
    size, block = (_vectors(engine, width), height), _block(motion, own)
    arguments = own.guide, other.guide, own.light, other.light, motion, block, height, width, tests, taps
    engine.launch("compare", _kernel(engine, "temporal.cl", "compare", own), size, *arguments)
    mismatch = box_mean(engine, tests.part(0, 1), MISMATCH_RADIUS)
    light = box_mean(engine, tests.part(1, 7), LIGHT_RADIUS)
    arguments = mismatch, light, height, width, taps, total
    engine.launch("compare", _kernel(engine, "temporal.cl", "weigh", own), size, *arguments)
    return Weights(taps, motion, other)


def accumulate(engine: Engine, sums: Planes, other: Planes, weights: Weights, *, squared: bool, light: bool) -> None:
    """Add a plane of another frame to `sums`, in place.

    Args:
        squared: it is a variance.
        light: it is colour, of which outliers stay single pixels.
    """
    block = _block(weights.motion, weights.look)
    kernel = _kernel(engine, "temporal.cl", "accumulate", weights.look)
    height, width = sums.height, sums.width
    arguments = other, weights.look.factor, weights.taps, weights.motion, block, sums.channels, height, width
    engine.launch("merge", kernel, (_vectors(engine, width), height), *arguments, int(squared), int(light), sums)


def normalise(engine: Engine, sums: Planes, total: Planes, look: Look, *, squared: bool) -> Planes:
    """The mean that `accumulate` has summed."""
    out = engine.planes(sums.channels, sums.height, sums.width)
    size = _vectors(engine, sums.width), sums.height, sums.channels
    arguments = sums, total, sums.height, sums.width, int(squared), out
    engine.launch("merge", _kernel(engine, "temporal.cl", "normalise", look), size, *arguments)
    return out


def _block(motion: Planes, look: Look) -> int:
    return 1 if (motion.height, motion.width) == (look.light.height, look.light.width) else BLOCK


def _lanes(engine: Engine) -> int:
    """Pixels of a block move alike, so vectors are no wider."""
    return min(engine.shape.width, BLOCK)


def _vectors(engine: Engine, width: int) -> int:
    return -(-width // _lanes(engine))


def _kernel(engine: Engine, file: str, name: str, look: Look) -> cl.Kernel:
    """Each file is one program for a set of features."""
    channels = [1 if feature == "depth" else 3 for feature in look.names]
    defines = {
        "WIDTH": _lanes(engine),
        "SEARCH_RADIUS": SEARCH_RADIUS,
        "FARTHEST": FARTHEST,
        "PIXELS": (2 * LIGHT_RADIUS + 1) ** 2,
    }
    defines |= {"CHANNELS": sum(channels), "GROUPS": len(channels)}
    for group, feature in enumerate(look.names):
        defines |= {feature.upper(): sum(channels[:group]), f"{feature.upper()}_NOISE": group}
    return engine.kernel(file, name, **defines)


def copies(engine: Engine, planes: Iterable[Planes]) -> list[Planes]:
    """Planes of their own, to be summed up in."""
    return [stack(engine, [each], 0) for each in planes]
