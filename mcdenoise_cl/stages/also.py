"""Further layers of a frame, filtered with what was decided for its colour; see also.cl.

Layers are one set of planes, three to a layer.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from .rows import STRETCH

#: Part of the pixels in which layers must sum to the colour, for them to be all that it is made of.
ENOUGH = 0.99

#: Layers that are fitted at a time: they share weights and the moments of the features. Moments of one are what a GPU
#: has registers for.
TOGETHER = {"tile": 3, "group": 1}


def each_layer(layers: Planes | None) -> Iterator[Planes]:
    """One layer after the other, three planes each."""
    for first in range(0, layers.channels if layers else 0, 3):
        yield layers.part(first, 3)


def hold_back_also(engine: Engine, layers: Planes, factor: Planes) -> Planes:
    """Scale layers as `scale_outliers` did their colour, in place: what was removed."""
    removed = engine.planes(layers.channels, layers.height, layers.width)
    _launch(engine, "hold_back_also", layers.channels, layers, layers, factor, layers.height, layers.width, removed)
    return removed


def blend_also(engine: Engine, layers: Planes, candidate: Planes, share: Planes, stage: str = "also") -> None:
    """Mix a candidate's layers in, in place, with the share that `mix_in` found for it."""
    size = engine.vectors(layers.width), layers.height, layers.channels
    kernel = engine.kernel("also.cl", "blend_also")
    engine.launch(stage, kernel, size, layers, candidate, share, layers.height, layers.width)


def bound_also(engine: Engine, fit: Planes, color: Planes, layers: Planes, before: Planes) -> None:
    """Let a fit of three colours go no lower than light can, in place, and the layers' fit with it.

    Args:
        fit, layers: what `color` and the layers `before` were fitted by, without a bound.
    """
    height, width = fit.height, fit.width
    _launch(engine, "bound_also", 3, fit, fit, color, layers, before, layers.channels, height, width)


@dataclass(frozen=True)
class Sums:
    """In how many pixels of a frame all layers together are the colour.

    Attributes:
        counted: one integer on the device.
        enough: how many say that the layers are all that the colour is made of.
    """

    counted: cl.MemoryObjectHolder
    enough: int


def count_sums(engine: Engine, bands: Iterable[tuple[Planes, Planes]], height: int, width: int) -> Sums:
    """Look at a frame of this size that comes in bands: the layers as they are given, and the colour."""
    counted, kernel = engine.zeros(1), engine.kernel("also.cl", "count_sums")
    for layers, color in bands:
        size, numbers = (-(-layers.width // STRETCH), layers.height), (layers.channels, layers.height, layers.width)
        engine.launch("also", kernel, size, layers, color, *numbers, STRETCH, counted, single=True)
    return Sums(counted, math.ceil(ENOUGH * height * width))


def settle_also(engine: Engine, layers: Planes, color: Planes, sums: Sums) -> None:
    """Make filtered layers sum to the filtered colour, in place, if those given did, where they do but for rounding.

    A fit rounds: its sums are right to 1e-4 where features hardly tell it what to do, and to 1e-6 elsewhere.
    """
    numbers = layers.channels, layers.height, layers.width
    _launch(engine, "settle_also", 3, layers, layers, color, *numbers, sums.counted, sums.enough)


def fit_also(
    engine: Engine, fit: Callable[..., tuple[Planes, ...]], color: Planes, layers: Planes | None
) -> list[tuple[Planes, Planes | None]]:
    """Fits of a colour, and the same fits of its layers, TOGETHER at a time.

    Args:
        fit: `first_order_regression`, ready but for the last argument, what is fitted, and the options `bounded` and
            `out`.
        color: three planes, or four.
        layers: None for none.
    """
    if layers is None:
        return [(each, None) for each in fit(color)]
    fits = fit(color, bounded=False)
    found = [engine.planes(layers.channels, color.height, color.width) for _ in fits]
    most = 3 * TOGETHER[engine.shape.schedule]
    for first in range(0, layers.channels, most):
        count = min(most, layers.channels - first)
        fit(layers.part(first, count), bounded=False, out=tuple(planes.part(first, count) for planes in found))
    for each, others in zip(fits, found, strict=True):
        bound_also(engine, each, color, others, layers)
    return list(zip(fits, found, strict=True))


def _launch(engine: Engine, name: str, channels: int, like: Planes, *arguments) -> None:
    size = engine.vectors(like.width), like.height, channels
    engine.launch("also", engine.kernel("also.cl", name), size, *arguments)
