"""Window means at a cost that does not depend on the window."""

from __future__ import annotations

from ..engine import Engine, Planes

#: Rows that a work-group transposes at a time: 64 bytes, the piece of memory that GPUs write.
GROUP_BLOCK = 16
#: The largest radius of windows that a CPU sums as they are.
LARGEST_DIRECT = 4
#: Pixels of an image for which steps cost more than work-items that have a column each.
SMALL = 2**20


def box_mean(engine: Engine, image: Planes, radius: int) -> Planes:
    """Mean over the (2 radius + 1)² window around each pixel, borders mirrored, of every plane."""
    if radius > LARGEST_DIRECT or engine.shape.schedule == "group":
        return _pass(engine, _pass(engine, image, radius), radius)
    height, width, channels = image.height, image.width, image.channels
    out = engine.planes(channels, height, width)
    columns, rows = engine.shape.tile
    kernel = engine.kernel("box_direct.cl", "box_direct", COLUMNS=columns, ROWS=rows, RADIUS=radius)
    size = (*engine.tiles(height, width), channels)
    engine.launch("box", kernel, size, image, height, width, out, 1.0 / (2 * radius + 1), single=True)
    return out


def box_thrice(engine: Engine, image: Planes, radius: int) -> Planes:
    """`box_mean` of `box_mean` of `box_mean`; a CPU takes a small image three times down, then three times across."""
    if engine.shape.schedule == "group" or image.height * image.width > SMALL:
        for _ in range(3):
            image = box_mean(engine, image, radius)
        return image
    for _ in range(2):
        height, width, channels = image.height, image.width, image.channels
        once, twice = (engine.planes(channels, height, width) for _ in range(2))
        out = engine.planes(channels, width, height)
        kernel = engine.kernel("box.cl", "box_thrice_transposed")
        numbers = radius, 1.0 / (2 * radius + 1)
        size = engine.vectors(width), channels
        engine.launch("box", kernel, size, image, height, once, twice, out, *numbers, single=True)
        image = out
    return image


def _pass(engine: Engine, image: Planes, radius: int) -> Planes:
    """Means over columns, written transposed."""
    height, width, channels = image.height, image.width, image.channels
    window = 2 * radius + 1
    out = engine.planes(channels, width, height)
    if engine.shape.schedule == "group":
        each = rows_each(engine, radius)
        kernel = engine.kernel("box_group.cl", "box_transposed_group", **engine.group_defines(), BLOCK=GROUP_BLOCK)
        size, local = (width, -(-height // each), channels), (*engine.shape.group, 1)
        engine.launch("box", kernel, size, image, height, width, out, radius, each, 1.0 / window, local=local)
    else:
        each = rows_each(engine, radius)
        kernel = engine.kernel("box.cl", "box_transposed")
        size = (engine.vectors(width), -(-height // each), channels)
        engine.launch("box", kernel, size, image, height, out, radius, each, 1.0 / window, single=True)
    return out


def rows_each(engine: Engine, radius: int) -> int:
    """Rows to a work-item, in whole blocks: enough that filling the first window is a small part of the work.

    To the last bit a mean hangs on where its work-item began.
    """
    rows = max(64, 4 * (2 * radius + 1))
    return rows + -rows % (GROUP_BLOCK if engine.shape.schedule == "group" else engine.shape.width)
