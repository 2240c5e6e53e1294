"""What a method has to know of a whole frame before it can filter a band of its rows."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from ..stages.exposure import KEY, auto_exposure, exposure_of_bands, inverse_geometric_mean_of_bands
from ..stages.noise import noise_level, noise_of_bands
from ..stages.response import look_for_noise
from ..stages.rows import Rows, cut
from ..stages.source import Source
from ..stages.variance import first_pixel, scale


@dataclass(frozen=True)
class Facts:
    """Found by a method's `survey`. Each holds for the whole frame.

    Attributes:
        exposure: as in `Result`.
        noise_level: as in `Result`.
        inverse_depth: 1 / the geometric mean of the depth; None without depth.
        first_normal: the normal of the first pixel; None without normals.
        edges, references: the guide of the normals, one plane of the whole frame, and what `guided_filter` counts
            from; only for methods that have one.
        quiet: says whether there is little noise; None where none is known.
        rows: those that are filtered.
    """

    exposure: cl.MemoryObjectHolder
    noise_level: cl.MemoryObjectHolder
    inverse_depth: cl.MemoryObjectHolder | None = None
    first_normal: cl.MemoryObjectHolder | None = None
    edges: Planes | None = None
    references: cl.MemoryObjectHolder | None = None
    quiet: Callable[[], bool] | None = None
    rows: Rows | None = None


def exposed(
    engine: Engine, color: Planes, given: float | None, facts: Facts | None
) -> tuple[cl.MemoryObjectHolder, Planes, cl.MemoryObjectHolder]:
    """The exposure, the colours with it, and their noise level; both numbers are those of the whole frame."""
    if facts is None:
        exposure = engine.constant([given]) if given is not None else auto_exposure(engine, color)
        color = scale(engine, color, exposure)
        return exposure, color, noise_level(engine, color)
    return facts.exposure, scale(engine, color, facts.exposure), facts.noise_level


def exposure_of(engine: Engine, source: Source, given: float | None) -> cl.MemoryObjectHolder:
    """The exposure that was given, or that of the frame's colours."""
    if given is not None:
        return engine.constant([given])
    bands = ((color, rows.first) for color, rows in source.sweep("color"))
    return exposure_of_bands(engine, bands, source.height, KEY)


def noise_of(engine: Engine, source: Source, mapped: Callable[[Planes], Planes]) -> cl.MemoryObjectHolder:
    """The noise level of the frame's colours, mapped."""
    bands = ((mapped(color), rows) for color, rows in source.sweep("color", 1))
    return noise_of_bands(engine, bands, source.height)


def inverse_depth_of(engine: Engine, source: Source) -> cl.MemoryObjectHolder | None:
    """What depth is scaled by."""
    if "depth" not in source.arrays:
        return None
    bands = ((depth, rows.first) for depth, rows in source.sweep("depth"))
    return inverse_geometric_mean_of_bands(engine, bands, source.height)


def known_noise(present: Container[str]) -> tuple[str, ...]:
    """The planes that tell the noise of the colour; none where it is not known."""
    if "color_variance" in present:
        return ("color_variance",)
    return ("color_a", "color_b") if "color_a" in present else ()


def quiet_frame(engine: Engine, planes: dict[str, Planes]) -> Callable[[], bool]:
    """Whether there is little noise in these planes of a frame, which tell how much there is."""
    whole = Rows(0, planes["color"].height, 0, planes["color"].height)
    return look_for_noise(engine, [(planes["color"], [planes[name] for name in known_noise(planes)], whole)])


def quiet_of(engine: Engine, source: Source) -> Callable[[], bool] | None:
    """The same of a frame that is let in band by band; None where nothing tells."""

    def bands() -> Iterator[tuple[Planes, list[Planes], Rows]]:
        for rows in cut(source.height, source.most, 0, 1):
            color, *noise = source.planes(rows, ["color", *names]).values()
            yield color, noise, rows

    names = known_noise(source.arrays)
    return look_for_noise(engine, bands()) if names else None


def first_normal_of(engine: Engine, source: Source) -> cl.MemoryObjectHolder | None:
    """What normals are counted from."""
    if "normal" not in source.arrays:
        return None
    return first_pixel(engine, source.planes(Rows(0, 1, 0, 1), ["normal"])["normal"])
