"""What a method hands back."""

from __future__ import annotations

from dataclasses import dataclass

import pyopencl as cl

from ..engine import Planes


@dataclass(frozen=True)
class Result:
    """Denoised planes and what the method found out about the frame, still on the device.

    Attributes:
        color: three planes, scene-linear.
        exposure: one float: the factor applied before tonemapping.
        noise_level: one float: the standard deviation found in the tonemapped colours.
    """

    color: Planes
    exposure: cl.MemoryObjectHolder
    noise_level: cl.MemoryObjectHolder
