"""`nlm`: non-local means on the colours alone (Buades et al. 2005; Yang 2022, eqs. 4-6), the paper's baseline."""

from __future__ import annotations

from dataclasses import dataclass

from ..engine import ROWS, Engine, Planes
from ..stages.also import each_layer
from ..stages.exposure import (
    CURVES,
    auto_exposure,
    compress,
    compress_also,
    expand,
    expand_also,
    scale_as,
    tonemap,
    tonemap_inverse,
)
from ..stages.nlm import CENTERS, SsimTerm
from ..stages.nlm import nlm as nlm_stage
from ..stages.noise import noise_level
from ..stages.pad import pad, stack
from ..stages.source import ALSO, Source
from .facts import Facts, exposure_of, noise_of
from .parameters import parameter
from .result import Result

NAME = "nlm"
SUMMARY = "non-local means on the colours alone: the paper's baseline"
NEEDS: tuple[str, ...] = ()
USES: tuple[str, ...] = ()


@dataclass(frozen=True)
class Parameters:
    """Window sizes of Yang 2022, table 1; the rest by measurement (bench/sweep.py)."""

    search_radius: int = parameter(3, "search window is (2 r + 1)² pixels", low=0, high=64)
    patch_radius: int = parameter(2, "patches are (2 r + 1)² pixels", low=0, high=16)
    patch_sigma: float | None = parameter(
        None, "Gaussian over the patch, standard deviation in pixels; none: half of patch_radius", kind=float, low=0.0
    )
    h_factor: float = parameter(1.5, "strength: h is this many times the frame's own noise level", low=0.0)
    h: float | None = parameter(
        None, "strength as a fixed number, in tonemapped units; none: h_factor times the noise", kind=float, low=0.0
    )
    center: str = parameter(
        "largest", "weight of the pixel itself: one, as eq. 5 has it, or the largest of the others", choices=CENTERS
    )
    exposure: float | None = parameter(
        None, "factor before tonemapping; none: 0.18 / log-average luminance", kind=float, low=1e-30, high=1e30
    )
    curve: str = parameter("reinhard", "tonemapping before colours are compared", choices=CURVES)
    average: str = parameter(
        "compressed",
        "what is averaged: light, light compressed by x / (1 + x), or tonemapped values",
        choices=("linear", "compressed", "tonemapped"),
    )


def survey(engine: Engine, source: Source, p: Parameters) -> Facts:
    """What bands need to know of the whole frame."""
    exposure = exposure_of(engine, source, p.exposure)
    return Facts(exposure, noise_of(engine, source, lambda color: tonemap(engine, color, exposure, p.curve)))


def reach(p: Parameters) -> int:
    """Rows that a pixel depends on to each side."""
    return p.search_radius + p.patch_radius


def align(engine: Engine, p: Parameters) -> int:
    """Bands begin with whole tiles."""
    return ROWS


def run(engine: Engine, planes: dict[str, Planes], p: Parameters, facts: Facts | None = None) -> Result:
    """Door to exit without the door and the exit: planes in, planes out."""
    return filter_colors(engine, planes, p, None, facts)


def filter_colors(
    engine: Engine, planes: dict[str, Planes], p: Parameters, ssim: SsimTerm | None, facts: Facts | None
) -> Result:
    """Tonemap, estimate the noise, and average with the weights of eq. 5, or of eq. 8 where `ssim` is given."""
    color = planes["color"]
    if facts is not None:
        exposure = facts.exposure
    else:
        exposure = engine.constant([p.exposure]) if p.exposure is not None else auto_exposure(engine, color)
    tone = tonemap(engine, color, exposure, p.curve)
    level = facts.noise_level if facts else noise_level(engine, tone)
    border = p.search_radius + p.patch_radius
    padded = pad(engine, tone, border)

    def average(light: Planes) -> Planes:
        return nlm_stage(
            engine,
            padded,
            padded if light is tone else pad(engine, light, p.search_radius),
            search_radius=p.search_radius,
            patch_radius=p.patch_radius,
            patch_sigma=p.patch_radius / 2 if p.patch_sigma is None else p.patch_sigma,
            noise_level=level if p.h is None else engine.constant([1.0]),
            h_factor=p.h_factor if p.h is None else p.h,
            center=p.center,
            ssim=ssim,
        )

    if p.average == "tonemapped":
        averaged = average(tone)
        out = tonemap_inverse(engine, averaged, exposure, p.curve)
    elif p.average == "compressed":
        averaged = average(compress(engine, color, exposure))
        out = expand(engine, averaged, exposure, color)
    else:
        out = averaged = average(color)
    layers = []
    for layer in each_layer(planes.get(ALSO)):
        if p.average == "tonemapped":
            part = average(scale_as(engine, layer, color, tone))
            layers.append(scale_as(engine, part, averaged, out))
        elif p.average == "compressed":
            part = average(compress_also(engine, layer, color, exposure))
            layers.append(expand_also(engine, part, layer, color, averaged, exposure))
        else:
            layers.append(average(layer))
    return Result(out, exposure, level, also=stack(engine, layers, 0) if layers else None)
