"""Mirrored borders."""

from __future__ import annotations

from ..engine import Engine, Planes


def pad(
    engine: Engine, planes: Planes, border: int, scale: float = 1.0, shift: float = 0.0, out: Planes | None = None
) -> Planes:
    """Planes with a border mirrored without repeating the edge pixel, each value mapped to scale * value + shift.

    The image may be smaller than the border. Everything that a tile can reach is filled. `out`: planes of that border
    to write to.
    """
    out = out or engine.planes(planes.channels, planes.height, planes.width, border)
    rows = out.plane // out.row
    size = (engine.vectors(out.row), rows, planes.channels)
    kernel = engine.kernel("pad.cl", "pad")
    engine.launch(
        "pad", kernel, size, planes, planes.height, planes.width, out, border, rows, out.row, float(scale), float(shift)
    )
    return out


def stack(engine: Engine, groups: list[Planes], border: int) -> Planes:
    """Several sets of planes as one, with a mirrored border."""
    first = groups[0]
    out = engine.planes(sum(group.channels for group in groups), first.height, first.width, border)
    done = 0
    for group in groups:
        pad(engine, group, border, out=out.part(done, group.channels))
        done += group.channels
    return out
