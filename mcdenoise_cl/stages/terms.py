"""The terms of a regression, and which features carry something where."""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from .pad import pad, stack
from .rows import Rows

#: Pixels of a block, which decides as one which features it uses; a multiple of every tile of a regression.
BLOCK_COLUMNS, BLOCK_ROWS = 32, 8

#: A feature is left out of a block where its variance, in and around the block, is below the first (features lie in
#: [-1, 1]), or below the second times the variance of the noise that it still has; a principal component of the rest
#: likewise, with the third.
LEAST_VARIANCE, LEAST_SIGNAL, LEAST_DIRECTION = 1e-8, 2.0, 0.5

#: So is a component with less than this part of the variance of all. Where features say the same, or pixels are fewer
#: than they, float32 leaves about a tenth of it.
LEAST_PART = 1e-5


@dataclass(frozen=True)
class Terms:
    """What colours are fitted to.

    Attributes:
        features: planes of the features, without a border.
        noise: planes of their variances, without a border.
        reach: pixels from a pixel to the end of its window.
        blocks: for each block the means of the features and the principal components that carry something (terms.h).
        used: for each feature the blocks that use it, of those that lie in wanted rows.
        across, down: how many blocks there are.
        counted: how many blocks lie in wanted rows.
    """

    features: Planes
    noise: Planes
    reach: int
    blocks: cl.MemoryObjectHolder
    used: cl.MemoryObjectHolder
    across: int
    down: int
    counted: int


def choose_terms(engine: Engine, features: Planes, noise: Planes, reach: int, rows: Rows | None = None) -> Terms:
    """Which features, and which of their principal components, carry something in and around each block.

    `rows`: what part of a frame the planes are, if not the whole; bands begin with whole blocks.
    """
    height, width, count = features.height, features.width, features.channels
    across, down = -(-width // BLOCK_COLUMNS), -(-height // BLOCK_ROWS)
    blocks, used = engine.memory(4 * (2 * count + 1 + count * count) * across * down), engine.zeros(count)
    defines = {"BLOCK_COLUMNS": BLOCK_COLUMNS, "BLOCK_ROWS": BLOCK_ROWS, "FEATURES": count}
    kernel = engine.kernel("terms.cl", "choose_terms", **defines)
    padded = pad(engine, features, reach)
    rows = rows or Rows(0, height, 0, height)
    counted = rows.first - rows.start, rows.last - rows.start
    numbers = height, width, reach, LEAST_VARIANCE, LEAST_SIGNAL, LEAST_DIRECTION, LEAST_PART, *counted
    size = (across, down)
    engine.launch("terms", kernel, size, padded, noise, *numbers, blocks, used, single=True)
    block_rows = -(-counted[1] // BLOCK_ROWS) - -(-counted[0] // BLOCK_ROWS)
    return Terms(features, noise, reach, blocks, used, across, down, across * block_rows)


def stack_terms(engine: Engine, features: Planes | None, color: Planes, reach: int) -> Planes:
    """The features and the colours in one stack of planes, with a mirrored border of `reach`."""
    return stack(engine, [features, color] if features else [color], reach)
