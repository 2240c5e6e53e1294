"""A frame through a method: whole where there is memory for it, in bands of rows where there is not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pyopencl as cl

from .details import Summary, summarise
from .engine import Engine, Planes
from .methods import Method
from .methods.facts import Facts
from .methods.result import Result
from .stages.also import Sums, count_sums, each_layer, settle_also
from .stages.door import Strided, door
from .stages.exit import leave
from .stages.outliers import SCALE, Light
from .stages.rows import Rows, cut
from .stages.source import ALSO, Source
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


def most_rows(width: int, layers: int) -> int:
    """Rows whose pixels can be counted with 32 bits, in as many planes as layers have."""
    return max(min(MOST_PIXELS, 2**30 // (3 * max(layers, 1))) // width, 1)


def fewer_rows(most: int, least: int) -> int | None:
    """What to try next; None after the least."""
    return max(most * 3 // 4, least) if most > least else None


def filter_frame(
    engine: Engine, method: Method, source: Source, p: Any, target: Strided, also: Sequence[Strided] = ()
) -> Filtered:
    """Filter what the source has, `source.most` rows at a time, and write it to the target, its layers to `also`.

    Raises:
        NoRoomError: there is no room for as many rows, or none for so few that a band has none of its own.
    """
    targets = [target, *also]
    if source.most >= source.height:
        everything = Rows(0, source.height, 0, source.height)
        planes = source.planes(everything, count=True)
        sums = _sums(engine, source, [planes])
        result = method.run(engine, planes, p)
        _leave(engine, result.color, result.also, targets, 0, sums)
        return Filtered(result, lambda maps: [summarise(engine, result, everything, maps)])
    facts = method.survey(engine, source, p)
    sums = _sums(
        engine, source, (source.planes(rows, ["color", ALSO]) for rows in cut(source.height, source.most, 0, 1))
    )
    light, summaries = None, []
    kept = [place if place.dtype == np.float32 else _room_for(engine, source) for place in targets]
    for rows in cut(source.height, source.most, method.reach(p), method.align(engine, p)):
        result = method.run(engine, source.planes(rows, count=True), p, replace(facts, rows=rows))
        image, layers = rows.wanted(result.color), rows.wanted(result.also) if result.also else None
        if result.exposed and result.removed is not None:
            light = light or Light(engine, source.height, source.width, p.spread_radius)
            lost = rows.wanted(result.also_removed) if result.also_removed else None
            light.collect(image, rows.wanted(result.removed), rows.first, lost)
            for picture, place in zip([image, *each_layer(layers)], kept, strict=True):
                leave(engine, picture, place.rows(rows.first))
        else:
            if result.exposed:
                image, layers = _unexposed(engine, image, layers, source, facts, rows)
            _leave(engine, image, layers, targets, rows.first, sums)
        summaries.append(summarise(engine, result, rows, True))
        nothing = dict.fromkeys(("color", "removed", "kept", "terms", "shares", "error", "also", "also_removed"))
        result = replace(result, **nothing)
        del image, layers
    if light is not None:
        light.blur()
        _give_back(engine, source, light, facts, kept, targets, sums)
    return Filtered(result, lambda maps: summaries)


def _sums(engine: Engine, source: Source, bands: Iterable[dict[str, Planes]]) -> Sums | None:
    """Whether the layers sum to the colour; None without any."""
    if not source.also:
        return None
    return count_sums(engine, ((planes[ALSO], planes["color"]) for planes in bands), source.height, source.width)


def _leave(
    engine: Engine,
    image: Planes,
    layers: Planes | None,
    targets: Sequence[Strided],
    first: int,
    sums: Sums | None,
) -> None:
    """Write a band of the frame, which begins with row `first`, and its layers."""
    if layers:
        settle_also(engine, layers, image, sums)
    for picture, target in zip([image, *each_layer(layers)], targets, strict=True):
        leave(engine, picture, target.rows(first))


def _room_for(engine: Engine, source: Source) -> Strided:
    """For a picture in float32, between its two passes."""
    buffer = engine.frame_memory(12 * source.height * source.width)
    return Strided(buffer, np.dtype("f4"), 3, 0, (3 * source.width, 3, 1))


def _give_back(
    engine: Engine,
    source: Source,
    light: Light,
    facts: Facts,
    kept: Sequence[Strided],
    targets: Sequence[Strided],
    sums: Sums | None,
) -> None:
    size, unused = (source.height, source.width), engine.zeros(1)
    for rows in cut(source.height, source.most, 0, SCALE):
        image, layers = light.give_back(rows.wanted(door(engine, kept[0], *size, unused, rows=rows)), rows.first), None
        if source.also:
            layers = engine.planes(3 * len(source.also), rows.stop - rows.start, source.width)
            for place, out in zip(kept[1:], each_layer(layers), strict=True):
                door(engine, place, *size, unused, rows=rows, out=out)
            layers = light.give_back_also(rows.wanted(layers), rows.first)
        image, layers = _unexposed(engine, image, layers, source, facts, rows)
        _leave(engine, image, layers, targets, rows.first, sums)


def _unexposed(
    engine: Engine, image: Planes, layers: Planes | None, source: Source, facts: Facts, rows: Rows
) -> tuple[Planes, Planes | None]:
    own = Rows(rows.first, rows.last, rows.first, rows.last)
    before = source.planes(own, ["color", *([ALSO] if layers else [])])
    image = scale_back(engine, image, facts.exposure, before["color"])
    return image, scale_back(engine, layers, facts.exposure, before[ALSO]) if layers else None
