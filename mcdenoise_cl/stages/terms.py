"""The terms of a regression, and which features carry something where."""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from .pad import pad

#: Pixels of a block, which decides as one which features it uses; a multiple of every tile of a regression.
BLOCK_COLUMNS, BLOCK_ROWS = 32, 8

#: A feature is left out of a block where its variance, in and around the block, is below the first (features lie in
#: [-1, 1]), or below the second times the variance of the noise that it still has.
LEAST_VARIANCE, LEAST_SIGNAL = 1e-8, 2.0


@dataclass(frozen=True)
class Terms:
    """What colours are fitted to.

    Attributes:
        features: planes of the features, without a border.
        noise: planes of their variances, without a border.
        reach: pixels from a pixel to the end of its window.
        blocks: for each block and feature its mean and its variance, -1 where it is left out.
        used: for each feature the blocks that use it.
        across, down: how many blocks there are.
    """

    features: Planes
    noise: Planes
    reach: int
    blocks: cl.MemoryObjectHolder
    used: cl.MemoryObjectHolder
    across: int
    down: int


def choose_terms(engine: Engine, features: Planes, noise: Planes, reach: int) -> Terms:
    """Which features carry something in and around each block."""
    height, width, count = features.height, features.width, features.channels
    across, down = -(-width // BLOCK_COLUMNS), -(-height // BLOCK_ROWS)
    blocks, used = engine.memory(8 * count * across * down), engine.zeros(count)
    kernel = engine.kernel("terms.cl", "choose_terms", BLOCK_COLUMNS=BLOCK_COLUMNS, BLOCK_ROWS=BLOCK_ROWS)
    padded = pad(engine, features, reach)
    numbers = count, height, width, reach, LEAST_VARIANCE, LEAST_SIGNAL
    size = (count, across, down)
    engine.launch("terms", kernel, size, padded, noise, *numbers, blocks, used, single=True)
    return Terms(features, noise, reach, blocks, used, across, down)


def stack_terms(engine: Engine, features: Planes | None, color: Planes, reach: int) -> Planes:
    """The planes 1, features, x, y, colours with a border of `reach`: mirrored, but positions go on."""
    count = features.channels if features else 0
    out = engine.planes(3 + count + color.channels, color.height, color.width, reach)
    if features:
        pad(engine, features, reach, out=out.part(1, count))
    pad(engine, color, reach, out=out.part(3 + count, color.channels))
    kernel = engine.kernel("terms.cl", "constant_and_position")
    engine.launch("terms", kernel, (out.row, out.plane // out.row), out, count, reach)
    return out
