"""Mirrored borders."""

from __future__ import annotations

from ..engine import Engine, Planes


def pad(engine: Engine, planes: Planes, border: int, scale: float = 1.0, shift: float = 0.0) -> Planes:
    """Planes with a border mirrored without repeating the edge pixel, each value mapped to scale * value + shift.

    The image may be smaller than the border. Everything that a tile can reach is filled.
    """
    out = engine.planes(planes.channels, planes.height, planes.width, border)
    rows = out.plane // out.row
    size = (out.row, rows, planes.channels)
    kernel = engine.kernel("pad.cl", "pad")
    engine.launch(
        "pad", kernel, size, planes, planes.height, planes.width, out, border, rows, out.row, float(scale), float(shift)
    )
    return out
