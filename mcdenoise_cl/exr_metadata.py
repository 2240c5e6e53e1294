"""Header attributes of EXR files <-> `Frame.metadata`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .errors import ExrError
from .exr_file import Part
from .exr_layers import Layer


def metadata_of(
    path: str | os.PathLike[str], parts: Sequence[Part], color: Layer, samples: int | None
) -> dict[str, Any]:
    """What a file says of its frame. `samples`: what its user says of the samples per pixel.

    Raises:
        ExrError: `samples` is no such number.
    """
    header = parts[0].header | parts[color.part].header
    metadata: dict[str, Any] = {"source": str(path)}
    if samples is not None:
        if isinstance(samples, bool) or not isinstance(samples, int | np.integer) or samples < 1:
            raise ExrError(f"samples_per_pixel is {samples!r} but a whole number from 1 on is needed")
        metadata["samples_per_pixel"] = int(samples)
    elif (count := _header_samples(header, color)) is not None:
        metadata["samples_per_pixel"] = count
    scale = _number(header.get("exposureScale"))
    if scale is not None:
        metadata["exposure_scale"] = scale
    if isinstance(header.get("scene"), str):
        metadata["scene"] = header["scene"]
    return metadata


def _header_samples(header: Mapping[str, Any], color: Layer) -> int | None:
    """This project and pbrt-v4 write `samplesPerPixel`, Cycles a text `cycles.<view layer>.samples`."""
    cycles = [key for key in header if key.startswith("cycles.") and key.endswith(".samples")]
    own = f"cycles.{color.parent}.samples"
    for key in ["samplesPerPixel", own, *(cycles if len(cycles) == 1 else [])]:
        count = _number(header.get(key))
        if count is not None and count >= 1 and count == int(count):
            return int(count)
    return None


def _number(value: Any) -> float | None:
    """A header attribute as a finite number; OpenEXR returns a `double` as an array of one."""
    try:
        number = float(value[0] if isinstance(value, np.ndarray) else value)
    except (TypeError, ValueError, IndexError):
        return None
    return number if np.isfinite(number) else None


def attributes_of(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Plain Python values, the only ones OpenEXR takes."""
    kinds = {"samples_per_pixel": ("samplesPerPixel", int), "exposure_scale": ("exposureScale", float)}
    kinds["scene"] = ("scene", str)
    return {name: kind(metadata[key]) for key, (name, kind) in kinds.items() if metadata.get(key) is not None}
