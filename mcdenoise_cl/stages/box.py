"""Window means at a cost that does not depend on the window."""

from __future__ import annotations

from ..engine import Engine, Planes


def box_mean(engine: Engine, image: Planes, radius: int) -> Planes:
    """Mean over the (2 radius + 1)² window around each pixel, borders mirrored, of every plane."""
    return _pass(engine, _pass(engine, image, radius), radius)


def _pass(engine: Engine, image: Planes, radius: int) -> Planes:
    """Means over columns, written transposed."""
    width = engine.shape.width
    window = 2 * radius + 1
    # Rows to a work-item: enough that filling the first window is a small part of the work.
    each = max(64, 4 * window)
    each += -each % width
    out = engine.planes(image.channels, image.width, image.height)
    size = (engine.vectors(image.width), -(-image.height // each), image.channels)
    kernel = engine.kernel("box.cl", "box_transposed")
    engine.launch("box", kernel, size, image, image.height, out, radius, each, 1.0 / window)
    return out
