"""SSIM between patches of the prefiltered normals (Yang 2022, eq. 7; Wang et al. 2004)."""

from __future__ import annotations

from ..engine import Engine, Planes


def patch_statistics(engine: Engine, unit: Planes, patch_radius: int) -> Planes:
    """Of the patch around each pixel: means (planes 0-2) and variances (3-5).

    Args:
        unit: three planes in [0, 1] with a mirrored border of at least `patch_radius`.
    """
    out = engine.planes(6, unit.height, unit.width)
    kernel = engine.kernel("ssim.cl", "patch_statistics", **engine.tile_defines(patch_radius), SHARED=0)
    engine.launch("ssim", kernel, (engine.vectors(unit.width), unit.height, 3), unit, unit.height, unit.width, out)
    return out


def patch_ssim(
    engine: Engine, unit: Planes, stats: Planes, dx: int, dy: int, patch_radius: int, c1: float, c2: float
) -> Planes:
    """SSIM of the patch around each pixel with the patch (dx, dy) away: one plane, mean over channels.

    Args:
        unit: three planes in [0, 1] with a border of at least max(|dx|, |dy|) + patch_radius.
        stats: `patch_statistics` of it, with the same border.
        c1, c2: the constants of eq. 7 for range 1; C3 = c2 / 2.
    """
    out = engine.planes(1, unit.height, unit.width)
    kernel = engine.kernel("ssim.cl", "patch_ssim", **engine.tile_defines(patch_radius), SHARED=0)
    size = engine.tiles(unit.height, unit.width)
    arguments = (unit, stats, unit.height, unit.width, dx, dy, float(c1), float(c2), out)
    engine.launch("ssim", kernel, size, *arguments, single=True)
    return out
