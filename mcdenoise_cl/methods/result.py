"""What a method hands back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import pyopencl as cl

from ..engine import Planes
from ..stages.terms import Terms


@dataclass(frozen=True)
class Result:
    """Denoised planes and what the method found out about the frame, still on the device.

    Attributes:
        color: three planes, scene-linear.
        exposure: one float: the factor applied before tonemapping.
        noise_level: one float: the standard deviation found in the tonemapped colours.
        removed, kept: what outliers lost, and what was left of the colours, three planes each; None if none were
            looked for.
        feature_names, terms: the feature of each plane that colours were fitted to, and which of them were used where.
        shares: what each of `auto.CANDIDATES` contributes, one plane each, their sum 1. None for a single filter.
        error: makes the plane of the estimated relative squared error, for those who ask; None where there is none.
        also: further layers of the frame, filtered as the colour was, three planes each; None without any.
        also_removed: what they lost where the colour's outliers were.
        exposed: the colours are still exposed, and lack what was removed: light goes further than a band.
    """

    color: Planes
    exposure: cl.MemoryObjectHolder
    noise_level: cl.MemoryObjectHolder
    removed: Planes | None = None
    kept: Planes | None = None
    feature_names: tuple[str, ...] = ()
    terms: Terms | None = None
    shares: Planes | None = None
    error: Callable[[], Planes] | None = None
    also: Planes | None = None
    also_removed: Planes | None = None
    exposed: bool = False
