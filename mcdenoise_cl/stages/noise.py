"""The noise level of an image, from the image itself."""

from __future__ import annotations

from collections.abc import Iterable

import pyopencl as cl

from ..engine import Engine, Planes
from .rows import Rows


def noise_level(engine: Engine, image: Planes) -> cl.MemoryObjectHolder:
    """Standard deviation of white noise in an image of three planes (Immerkaer 1996): one float on the device.

    Texture counts as noise, so it is an upper estimate; a constant image gives 0.
    """
    return noise_of_bands(engine, [(image, Rows(0, image.height, 0, image.height))], image.height)


def noise_of_bands(engine: Engine, bands: Iterable[tuple[Planes, Rows]], height: int) -> cl.MemoryObjectHolder:
    """`noise_level` of an image of three planes and `height` rows that comes in bands, a row more on every side."""
    sums, out, width = engine.memory(4 * 3 * height), engine.memory(4), 0
    laplacian = engine.kernel("noise.cl", "laplacian_rows")
    for image, rows in bands:
        width = image.width
        size, first = (rows.last - rows.first, 3), rows.first - rows.start
        engine.launch(
            "noise", laplacian, size, image, image.height, width, first, rows.first, height, sums, single=True
        )
    join = engine.kernel("noise.cl", "noise_from_rows")
    engine.launch("noise", join, (1,), sums, 3, height, width, out, single=True)
    return out
