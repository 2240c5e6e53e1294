"""Non-local means, with colour distances alone or with the SSIM of the normals (Yang 2022, eqs. 4-6 and 8)."""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl as cl

from ..device import DEVICE_VARIABLE, most_turns
from ..engine import Engine, Planes
from ..errors import DeviceError
from .canny import gaussian_taps
from .group import copy_defines, items, patch_defines

#: What the weight of the pixel itself can be: 1, since its patch is equal to itself, or the largest of the other
#: weights (Buades et al. 2005), without which an outlier that resembles nothing stays as it is.
CENTERS = ("one", "largest")

#: Pixels to a work-item of the group schedule, without and with SSIM; see nlm_group.cl for what they cost.
GROUP_OUTPUTS = (4, 2)

#: Offsets up to this long to each side share their weights with their opposites in the tile schedule: a tile and what
#: longer ones would add to it are no less than two tiles.
LONGEST_SHARED = 8


@dataclass(frozen=True)
class SsimTerm:
    """What eq. 8 adds to the weights.

    Attributes:
        unit: prefiltered normals in [0, 1], border of at least search_radius + patch_radius.
        stats: their patch statistics, the same border.
        c1, c2: constants of eq. 7.
        stabiliser: added to ln(1/SSIM), so that no weight ignores the colours; 0 is eq. 8 as printed.
    """

    unit: Planes
    stats: Planes
    c1: float
    c2: float
    stabiliser: float


def nlm(
    engine: Engine,
    tone: Planes,
    color: Planes,
    *,
    search_radius: int,
    patch_radius: int,
    patch_sigma: float,
    noise_level: cl.MemoryObjectHolder,
    h_factor: float,
    center: str = "one",
    ssim: SsimTerm | None = None,
) -> Planes:
    """Average `color` over the search window with weights from patches of `tone`.

    Args:
        tone: three planes in which patches are compared, border of at least search_radius + patch_radius.
        color: three planes to average, border of at least search_radius.
        patch_sigma: standard deviation of the Gaussian over the patch, in pixels.
        noise_level: one float on the device; h = h_factor * noise_level.
        center: one of CENTERS.
        ssim: the term of eq. 8, or None for eq. 5.

    Returns:
        Three planes without a border.

    Raises:
        DeviceError: the device may end the loops over such windows early.
    """
    height, width = tone.height, tone.width
    gaussian = engine.constant(gaussian_taps(patch_sigma, patch_radius))
    arguments = [
        tone,
        color,
        height,
        width,
        search_radius,
        gaussian,
        noise_level,
        float(h_factor),
        CENTERS.index(center),
    ]
    if ssim is not None:
        arguments += [ssim.unit, ssim.stats, float(ssim.c1), float(ssim.c2), float(ssim.stabiliser)]
    out = engine.planes(3, height, width)
    stage, term = ("nlm", {}) if ssim is None else ("ssim-nlm", {"WITH_SSIM": None})
    if engine.shape.schedule == "group":
        cut = patch_defines(engine, patch_radius, GROUP_OUTPUTS[ssim is not None])
        _check_turns(engine, cut, search_radius, 1 if ssim is None else 4)
        kernel = engine.kernel("nlm_group.cl", "nlm_group", **cut, **copy_defines(engine, cut, search_radius), **term)
        engine.launch(stage, kernel, items(height, width, cut), *arguments, out, local=engine.shape.group)
    else:
        cut = engine.tile_defines(patch_radius) | {"SHARED": min(search_radius, LONGEST_SHARED)}
        kernel = engine.kernel("nlm.cl", "nlm", **cut, **term)
        engine.launch(stage, kernel, engine.tiles(height, width), *arguments, out, single=True)
    return out


def _check_turns(engine: Engine, cut: dict[str, int], search_radius: int, sums: int) -> None:
    """What nlm_group.cl does in loops that no compiler unrolls: for each offset, `sums` sums over the lines of a patch,
    each of which takes a turn more to end."""
    lines, most = cut["OUTPUTS"] + 2 * cut["PATCH_RADIUS"], most_turns(engine.device)
    if most is not None and (2 * search_radius + 1) ** 2 * (1 + sums * (lines + 1)) > most:
        raise DeviceError(
            f"{engine.device.name.strip()} ends long loops early, so that a search_radius of {search_radius} with a "
            f"patch_radius of {cut['PATCH_RADIUS']} may come out wrong: choose smaller ones, or another device with "
            f"device=..., --device or {DEVICE_VARIABLE}"
        )
