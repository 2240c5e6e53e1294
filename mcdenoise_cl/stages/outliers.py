"""Outliers scaled down, and the energy that this removes spread over the surroundings."""

from __future__ import annotations

import math

import numpy as np

from ..engine import Engine, Planes
from .also import each_layer, hold_back_also
from .box import box_thrice
from .pad import pad

#: Pixels of a group stay if they stand out by more than so many standard deviations; one sample in many does by one.
SIGNIFICANT_IN_GROUP = 1.5

#: Light that was removed around a block counts for light that is there, so what several have too much is found step by
#: step.
ROUNDS = 3

#: Removed light is blurred in blocks of so many pixels squared, if its blur is that much wider.
SCALE, WIDER = 4, 8


def scale_outliers(
    engine: Engine, color: Planes, variance: Planes, limit: float, significant: float, by_chance: bool = True
) -> tuple[Planes, Planes]:
    """Scale pixels brighter than `limit` times the brightest of their eight neighbours down to that, in place.

    Up to four in 5x5 that are 16 `limit` times as bright as all others there are scaled down to `limit` times the
    brightest of those, if their deviation is known (`significant` finite) and they stand out by no more than 1.5.

    `variance` (three planes, of the pixel mean) is scaled with its colour. A pixel that stands out of its neighbours by
    more than `significant` standard deviations stays: it is no outlier but a small light, or texture. Its deviation is
    its own or, `by_chance` and if that is larger, the mean over 3x3 pixels relative to their brightness: two halves
    agree by chance. From many samples its own is well known, and all that tells a lamp among noise from a firefly.

    Returns:
        What was removed: three planes, 0 where nothing was; and the factor of each pixel, one plane.
    """
    height, width = color.height, color.width
    size = engine.vectors(width), height
    bright = engine.planes(2, height, width)
    engine.launch("outliers", engine.kernel("outliers.cl", "brightest"), size, color, variance, height, width, bright)
    factor, removed = engine.planes(1, height, width), engine.planes(3, height, width)
    arguments = pad(engine, bright, 2), color, variance, height, width, float(limit)
    engine.launch(
        "outliers",
        engine.kernel("outliers.cl", "hold_back"),
        size,
        *arguments,
        float(significant),
        min(SIGNIFICANT_IN_GROUP, significant) if math.isfinite(significant) else 0.0,
        float(by_chance),
        factor,
        removed,
    )
    return removed, factor


def spread_removed(
    engine: Engine,
    image: Planes,
    removed: Planes,
    radius: int,
    also: Planes | None = None,
    also_removed: Planes | None = None,
) -> tuple[Planes, Planes | None]:
    """Give the removed energy back: blurred by three box means, half of it evenly, half in proportion to brightness.

    Of a block of pixels no more than makes a twenty-fifth of the light around it: the rest is lost.
    To further layers likewise, what they lost, in proportion to the brightness of the image.
    """
    light = Light(engine, image.height, image.width, radius)
    light.collect(image, removed, 0, also_removed)
    light.blur()
    return light.give_back(image, 0), light.give_back_also(also, 0) if also else None


class Light:
    """What was removed from a frame that comes in bands, and from its layers, three planes each: `collect` all of them,
    `blur`, and give back to each."""

    def __init__(self, engine: Engine, height: int, width: int, radius: int) -> None:
        self._engine, self._height, self._width = engine, height, width
        self._scale = SCALE if radius >= WIDER * SCALE else 1
        self._radius = round(radius / self._scale)
        self._size = -(-height // self._scale), -(-width // self._scale)
        self._removed, self._bright = engine.planes(3, *self._size), engine.planes(3, *self._size)
        self._also_removed: Planes | None = None

    def collect(self, image: Planes, removed: Planes, first: int, also_removed: Planes | None = None) -> None:
        """A filtered band that begins with row `first`, a multiple of SCALE, and what it lost: three planes each.

        `also_removed`: what further layers lost.
        """
        down = -(-image.height // self._scale)
        if also_removed and self._also_removed is None:
            self._also_removed = self._engine.planes(also_removed.channels, *self._size)
        for planes, blocks in ((removed, self._removed), (image, self._bright), (also_removed, self._also_removed)):
            if planes is not None:
                size = self._engine.vectors(self._size[1]), down, planes.channels
                out = blocks.rows(first // self._scale, down)
                self._launch("block_means", size, planes, image.height, image.width, out)

    def blur(self) -> None:
        """All bands are collected."""
        kept = self._limit()
        self._removed = self._blurred(self._removed)
        self._bright = self._blurred(self._brightness(self._removed, 0.5))
        if self._also_removed is not None:
            hold_back_also(self._engine, self._also_removed, kept)
            self._also_removed = self._blurred(self._also_removed)

    def _limit(self) -> Planes:
        """Hold back what would outshine its surroundings: the part of each block's removed light that is left."""
        counted, kept = self._removed, self._engine.planes(1, *self._size)
        left = [self._engine.constant(left_in_place(n, 2 * self._radius + 1)) for n in self._size]
        for _ in range(ROUNDS):
            level = self._blurred(self._brightness(counted, 1.0))
            limited = self._engine.planes(3, *self._size)
            arguments = level, self._removed, counted, *self._size, *left, limited, kept
            self._launch("limit_removed", self._size[::-1], *arguments)
            counted = limited
        self._removed = limited
        return kept

    def _brightness(self, removed: Planes, part: float) -> Planes:
        out = self._engine.planes(1, *self._size)
        self._launch("brightness", self._size[::-1], self._bright, removed, *self._size, part, out)
        return out

    def give_back(self, image: Planes, first: int) -> Planes:
        """A filtered band, which begins with row `first`, with the light that it gets: three planes."""
        return self._give_back(image, self._removed, first)

    def give_back_also(self, layers: Planes, first: int) -> Planes:
        """The filtered layers of a band with the light that they get."""
        return self._give_back(layers, self._also_removed, first)

    def _give_back(self, layers: Planes, own: Planes, first: int) -> Planes:
        out = self._engine.planes(layers.channels, layers.height, layers.width)
        size = self._engine.vectors(self._size[1]), layers.height
        numbers = self._height, self._width, first, layers.height
        for layer, lost, target in zip(each_layer(layers), each_layer(own), each_layer(out), strict=True):
            self._launch("give_back", size, layer, lost, self._removed, self._bright, *numbers, target)
        return out

    def _blurred(self, planes: Planes) -> Planes:
        return box_thrice(self._engine, planes, self._radius)

    def _launch(self, name: str, size: tuple[int, ...], *arguments) -> None:
        engine = self._engine
        engine.launch("outliers", engine.kernel("spread.cl", name, SCALE=self._scale), size, *arguments)


def left_in_place(n: int, box: int) -> np.ndarray:
    """What three boxes, each so many blocks wide, leave in its place of the light of each of n blocks in a row, (n,).

    A quadratic spline and what its mirror images add. The first and the last block, which are not repeated, are images
    of their own.
    """
    if n == 1:
        return np.ones(1)
    period = 2 * (n - 1)
    images = 3 * box // (2 * period) + 1
    repeated = period * np.arange(-images, images + 1)
    mirrored = repeated - 2 * np.arange(1, n - 1)[:, None]
    left = np.full(n, _spline(repeated / box).sum())
    left[1:-1] += _spline(mirrored / box).sum(axis=1)
    return left / box


def _spline(t: np.ndarray) -> np.ndarray:
    t = np.abs(t)
    return np.where(t < 0.5, 0.75 - t**2, np.where(t < 1.5, 0.5 * (1.5 - t) ** 2, 0.0))
