"""A frame through a method: whole where there is memory for it, in bands of rows where there is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl as cl

from .details import Summary, summarise
from .engine import Engine, Planes
from .methods import Method
from .methods.facts import Facts
from .methods.result import Result
from .stages.door import Strided, door
from .stages.exit import leave
from .stages.outliers import SCALE, Light
from .stages.rows import Rows, cut
from .stages.source import Source
from .stages.variance import scale_back

#: Pixels of a band, at most: kernels index what they keep of one with 32 bits.
MOST_PIXELS = 2**25

#: Bytes that a pixel takes, as a first guess: those of `auto` with features and variances; too few is found out.
BYTES = 500


@dataclass(frozen=True)
class Filtered:
    """What a frame leaves behind besides its picture.

    Attributes:
        result: that of the frame, or of its last band.
        summaries: one a band, with maps if true; made when asked for where the frame was filtered whole.
    """

    result: Result
    summaries: Callable[[bool], list[Summary]]


def budget_of(device: cl.Device, max_memory_mb: int | None) -> int | None:
    """Bytes that may be kept; None for as many as there are."""
    if max_memory_mb is not None:
        return max_memory_mb * 2**20
    return device.global_mem_size // 2 if device.type & cl.device_type.CPU else None


def least_rows(engine: Engine, method: Method, p: Any) -> int:
    """As few as a band may have: enough that some of them are its own wherever it begins."""
    return 2 * method.align(engine, p) + 2 * method.reach(p)


def first_guess(height: int, width: int, budget: int | None, least: int) -> int:
    """Rows that may be filtered at once."""
    pixels = MOST_PIXELS if budget is None else min(MOST_PIXELS, budget // BYTES)
    return min(height, max(pixels // width, least))


def fewer_rows(most: int, least: int) -> int | None:
    """What to try next; None after the least."""
    return max(most * 3 // 4, least) if most > least else None


def filter_frame(engine: Engine, method: Method, source: Source, p: Any, target: Strided) -> Filtered:
    """Filter what the source has, `source.most` rows at a time, and write it to the target.

    Raises:
        NoRoomError: there is no room for as many rows, or none for so few that a band has none of its own.
    """
    if source.most >= source.height:
        everything = Rows(0, source.height, 0, source.height)
        result = method.run(engine, source.planes(everything, count=True), p)
        leave(engine, result.color, target)
        return Filtered(result, lambda maps: [summarise(engine, result, everything, maps)])
    facts = method.survey(engine, source, p)
    light, summaries = None, []
    kept = target if target.dtype == np.float32 else _room_for(engine, source)
    for rows in cut(source.height, source.most, method.reach(p), method.align(engine, p)):
        result = method.run(engine, source.planes(rows, count=True), p, replace(facts, rows=rows))
        image = rows.wanted(result.color)
        if result.exposed and result.removed is not None:
            light = light or Light(engine, source.height, source.width, p.spread_radius)
            light.collect(image, rows.wanted(result.removed), rows.first)
            leave(engine, image, kept.rows(rows.first))
        else:
            image = _unexposed(engine, image, source, facts, rows) if result.exposed else image
            leave(engine, image, target.rows(rows.first))
        summaries.append(summarise(engine, result, rows, True))
        result = replace(result, color=None, removed=None, kept=None, terms=None, shares=None, error=None)
    if light is not None:
        light.blur()
        _give_back(engine, source, light, facts, kept, target)
    return Filtered(result, lambda maps: summaries)


def _room_for(engine: Engine, source: Source) -> Strided:
    """For a picture in float32, between its two passes."""
    buffer = engine.frame_memory(12 * source.height * source.width)
    return Strided(buffer, np.dtype("f4"), 3, 0, (3 * source.width, 3, 1))


def _give_back(engine: Engine, source: Source, light: Light, facts: Facts, kept: Strided, target: Strided) -> None:
    unused = engine.zeros(1)
    for rows in cut(source.height, source.most, 0, SCALE):
        image = rows.wanted(door(engine, kept, source.height, source.width, unused, rows=rows))
        image = light.give_back(image, rows.first)
        leave(engine, _unexposed(engine, image, source, facts, rows), target.rows(rows.first))


def _unexposed(engine: Engine, image: Planes, source: Source, facts: Facts, rows: Rows) -> Planes:
    own = Rows(rows.first, rows.last, rows.first, rows.last)
    return scale_back(engine, image, facts.exposure, source.planes(own, ["color"])["color"])
