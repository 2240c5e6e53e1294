"""Outliers scaled down, and the energy that this removes spread over the surroundings."""

from __future__ import annotations

from ..engine import Engine, Planes
from .box import box_mean
from .pad import pad

#: Removed light is blurred in blocks of so many pixels squared, if its blur is that much wider.
SCALE, WIDER = 4, 8


def scale_outliers(
    engine: Engine, color: Planes, variance: Planes, limit: float, significant: float
) -> tuple[Planes, Planes]:
    """Scale pixels brighter than `limit` times the brightest of their eight neighbours down to that, in place.

    `variance` (three planes, of the pixel mean) is scaled with its colour. A pixel that stands out of its neighbours by
    more than `significant` standard deviations stays: it is no outlier but a small light, or texture. Its deviation is
    its own or, if that is larger, the mean over 3x3 pixels relative to their brightness: two halves agree by chance.

    Returns:
        What was removed: three planes, 0 where nothing was; and the factor of each pixel, one plane.
    """
    height, width = color.height, color.width
    size = engine.vectors(width), height
    bright = engine.planes(2, height, width)
    engine.launch("outliers", engine.kernel("outliers.cl", "brightest"), size, color, variance, height, width, bright)
    factor, removed = engine.planes(1, height, width), engine.planes(3, height, width)
    arguments = pad(engine, bright, 1), color, variance, height, width, float(limit), float(significant)
    engine.launch("outliers", engine.kernel("outliers.cl", "hold_back"), size, *arguments, factor, removed)
    return removed, factor


def spread_removed(engine: Engine, image: Planes, removed: Planes, radius: int) -> Planes:
    """Give the removed energy back: blurred by three box means, half of it evenly, half in proportion to brightness."""
    height, width = image.height, image.width
    scale = SCALE if radius >= WIDER * SCALE else 1
    down, across = -(-height // scale), -(-width // scale)

    def launch(name: str, size: tuple[int, ...], *arguments) -> None:
        engine.launch("outliers", engine.kernel("spread.cl", name, SCALE=scale), size, *arguments)

    def blur(planes: Planes) -> Planes:
        for _ in range(3):
            planes = box_mean(engine, planes, round(radius / scale))
        return planes

    blocks, bright = engine.planes(3, down, across), engine.planes(1, down, across)
    launch("block_means", (across, down, 3), removed, height, width, blocks)
    blocks = blur(blocks)
    launch("brightness", (across, down), image, blocks, height, width, bright)
    out = engine.planes(3, height, width)
    launch("give_back", (across, height), image, blocks, blur(bright), height, width, out)
    return out
