"""A frame and its neighbours in a sequence become one frame of less noise, which any method then filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from .engine import Engine, Planes
from .methods.facts import exposure_of
from .methods.features import COLOR_VARIANCES, FEATURE_VARIANCES, FEATURES, color_variance, hold_back_outliers
from .stages.box import rows_each
from .stages.door import Strided
from .stages.exit import leave
from .stages.mean import plane_means
from .stages.rows import cut
from .stages.source import Source
from .stages.temporal import (
    BLOCK,
    FARTHEST,
    LIGHT_RADIUS,
    SEARCH_RADIUS,
    VARIANCE_RADIUS,
    Look,
    accumulate,
    choose_motion,
    copies,
    find_motion,
    look_at,
    normalise,
    weigh,
)
from .stages.variance import clip, scale

#: What frames are compared by, besides the colour.
COMPARED = (*FEATURES, *FEATURE_VARIANCES, *COLOR_VARIANCES)
#: The name of the motion vectors beside the planes of a neighbour.
MOTION = "motion"
#: An outlier is brighter than so many times its neighbours, as for `regression`.
OUTLIER_LIMIT = 1.1
#: Rows to each side that a row depends on: a pixel's window, the blocks around that of its last row, the search, and
#: the variances there with the outliers around. And with motion vectors.
REACH = LIGHT_RADIUS + 2 * BLOCK + SEARCH_RADIUS + VARIANCE_RADIUS + 2
FAR_REACH = FARTHEST + REACH


@dataclass(frozen=True)
class Merged:
    """A frame with its neighbours merged into it.

    Attributes:
        arrays: its planes, float32 on the device, by name.
        counts: of each band its rows, and the mean number of frames that were merged there, one float on the device.
    """

    arrays: dict[str, Strided]
    counts: list[tuple[int, cl.MemoryObjectHolder]]

    def mean(self, engine: Engine) -> float:
        """How many frames a pixel is the mean of, on average; waits for it."""
        values = []
        for rows, buffer in self.counts:
            value = np.empty(1, np.float32)
            cl.enqueue_copy(engine.queue, value, buffer, is_blocking=True)
            values.append((rows, float(value[0])))
        return sum(rows * value for rows, value in values) / sum(rows for rows, _ in values)


def reach_of(neighbours: Sequence[Mapping[str, Strided]]) -> int:
    """Rows to each side that a row of the merged frame depends on."""
    return FAR_REACH if any(MOTION in arrays for arrays in neighbours) else REACH


def align_of(engine: Engine) -> int:
    """Bands begin at multiples of so many rows: those of means, which are multiples of blocks'."""
    return rows_each(engine, LIGHT_RADIUS)


def least_rows_to_merge(engine: Engine) -> int:
    """As few as a band may have."""
    return 2 * align_of(engine) + 2 * FAR_REACH


def merge(engine: Engine, source: Source, neighbours: Sequence[Source], names: Sequence[str]) -> Merged:
    """Merge the neighbours into a frame, `source.most` rows at a time.

    Args:
        source: the frame, with what it is to be compared by; of these planes the bad pixels are counted.
        neighbours: frames of the same size and planes, and their motion vectors where they are known.
        names: the planes to be merged.
    """
    targets = {name: _room_for(engine, source, name) for name in names}
    exposure = exposure_of(engine, source, None)
    counts = []
    reach = reach_of([each.arrays for each in neighbours])
    for rows in cut(source.height, source.most, reach, align_of(engine)):
        planes = source.planes(rows, count=True)
        own = _look(engine, planes, exposure)
        sums = dict(zip(names, copies(engine, (planes[name] for name in names)), strict=True))
        total = clip(engine, own.factor, 1.0, 1.0)
        for neighbour in neighbours:
            theirs = neighbour.planes(rows)
            given = theirs.pop(MOTION, None)
            other = _look(engine, theirs, exposure)
            found = find_motion(engine, own, other) if given is None else choose_motion(engine, own, other, given)
            weights = weigh(engine, own, other, found, total)
            for name in names:
                kind = {"squared": name.endswith("_variance"), "light": name.startswith("color")}
                accumulate(engine, sums[name], theirs[name], weights, **kind)
        for name in names:
            image = normalise(engine, sums[name], total, own, squared=name.endswith("_variance"))
            leave(engine, rows.wanted(image), targets[name].rows(rows.first))
        counts.append((rows.last - rows.first, plane_means(engine, rows.wanted(total))))
    return Merged(targets, counts)


def _look(engine: Engine, planes: dict[str, Planes], exposure: cl.MemoryObjectHolder) -> Look:
    color = scale(engine, planes["color"], exposure)
    variance = color_variance(engine, planes, color, exposure)
    _, factor = hold_back_outliers(engine, planes, color, variance, OUTLIER_LIMIT)
    features = {name: (planes[name], planes.get(f"{name}_variance")) for name in FEATURES if name in planes}
    guessed = not any(name in planes for name in COLOR_VARIANCES)
    return look_at(engine, features, color, variance, factor, guessed)


def _room_for(engine: Engine, source: Source, name: str) -> Strided:
    channels = source.arrays[name].channels
    buffer = engine.frame_memory(4 * channels * source.height * source.width)
    strides = channels * source.width, channels, 1 if channels > 1 else 0
    return Strided(buffer, np.dtype("f4"), channels, 0, strides)
