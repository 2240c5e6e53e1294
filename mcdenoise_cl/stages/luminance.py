"""The luminance around each pixel, and variances smoothed on its scale."""

from __future__ import annotations

from ..engine import Engine, Planes
from .box import box_mean


def luminance_around(engine: Engine, frame: Planes) -> Planes:
    """The mean luminance over 3x3 pixels, one plane; three colours, and whatever follows them, in."""
    out = engine.planes(1, frame.height, frame.width)
    size = (frame.width, frame.height)
    kernel = engine.kernel("luminance.cl", "luminance_plane")
    engine.launch("luminance", kernel, size, frame, frame.height, frame.width, out)
    return box_mean(engine, out, 1)


def smooth_variance(engine: Engine, variance: Planes, color: Planes, radius: int) -> Planes:
    """Variances of colours, three planes, averaged over (2 radius + 1)² pixels relative to the luminance.

    The noise of a light is a thousand times that of the wall beside it. A plain average would give the wall the light's
    noise, and a filter a licence to blur it; relative to the squared luminance (twice a 3x3 mean) they are alike.
    """
    around = box_mean(engine, luminance_around(engine, color), 1)

    def scaled(planes: Planes, up: int) -> Planes:
        out = engine.planes(3, planes.height, planes.width)
        size = (planes.width, planes.height, 3)
        kernel = engine.kernel("luminance.cl", "scale_by_luminance")
        engine.launch("luminance", kernel, size, planes, around, planes.height, planes.width, up, out)
        return out

    return scaled(box_mean(engine, scaled(variance, 0), radius), 1)
