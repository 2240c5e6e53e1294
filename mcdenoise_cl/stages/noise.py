"""The noise level of an image, from the image itself."""

from __future__ import annotations

import pyopencl as cl

from ..engine import Engine, Planes


def noise_level(engine: Engine, image: Planes) -> cl.MemoryObjectHolder:
    """Standard deviation of white noise in the image (Immerkaer 1996): one float on the device.

    Texture counts as noise, so it is an upper estimate; a constant image gives 0.
    """
    rows, out = engine.memory(4 * image.channels * image.height), engine.memory(4)
    laplacian = engine.kernel("noise.cl", "laplacian_rows")
    engine.launch(
        "noise", laplacian, (image.height, image.channels), image, image.channels, image.height, image.width, rows
    )
    join = engine.kernel("noise.cl", "noise_from_rows")
    engine.launch("noise", join, (1,), rows, image.channels, image.height, image.width, out)
    return out
