"""Two renderings of one frame with different seeds: their mean, and all that their difference tells."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .errors import FrameError
from .exr_layers import MOTION
from .frame import PLANES, VECTORS, Frame

#: `name.a.exr` and `name.b.exr` are the halves of `name.exr`.
_HALF = re.compile(r"(?P<stem>.+)\.(?P<half>[ab])(?P<suffix>\.exr)", re.IGNORECASE)
_OTHER = {"a": "b", "b": "a", "A": "B", "B": "A"}


def half_of(path: Path) -> str | None:
    """Which half a file is by its name, "a" or "b"; None for neither.

    Example:
        >>> half_of(Path("shot.0001.a.exr")), half_of(Path("shot.0001.exr"))
        ('a', None)
    """
    match = _HALF.fullmatch(path.name)
    return match["half"].lower() if match else None


def partner(path: Path) -> Path:
    """The other half of a file that is one by its name.

    Example:
        >>> partner(Path("shot.0001.a.exr")).name
        'shot.0001.b.exr'
    """
    match = _HALF.fullmatch(path.name)
    return path.with_name(f"{match['stem']}.{_OTHER[match['half']]}{match['suffix']}")


def whole_name(path: Path) -> str:
    """The name of the frame that a half belongs to; that of any other file as it is.

    Example:
        >>> whole_name(Path("in/shot.0001.a.exr")), whole_name(Path("in/first.exr"))
        ('shot.0001.exr', 'first.exr')
    """
    match = _HALF.fullmatch(path.name)
    return match["stem"] + match["suffix"] if match else path.name


def mean_of_halves(a: Frame, b: Frame, *, names: Sequence[Any] = ("a", "b")) -> Frame:
    """One frame from two independent renderings of it.

    Colour and features are means of the two, weighted by their samples per pixel where both tell; `color_a` and
    `color_b` are the two colours. Variances are those of the weighted mean of independent values, wa² va + wb² vb:
    (va + vb) / 4 for equal samples. A feature that only one has is taken from it, with its variance; a variance of the
    colour, or of a feature that both have, needs both. Half buffers of their own are left out.
    Motion vectors are those of `a`, where it has any, else of `b`.

    Args:
        a, b: host frames of one size.
        names: what to call them in errors.

    Returns:
        A frame of float32 planes; its metadata is that of `a`, with the samples of both together.

    Raises:
        FrameError: the sizes differ, or both hold the same pixels: then the seeds were the same, and the noise that
            they share could not be told from the picture.

    Example:
        >>> frames = [Frame(np.full((2, 2, 3), v, np.float32), metadata={"samples_per_pixel": n})
        ...           for v, n in ((1, 30), (2, 10))]
        >>> mean = mean_of_halves(*frames)
        >>> float(mean.color[0, 0, 0]), float(mean.color_b[0, 0, 0]), mean.metadata["samples_per_pixel"]
        (1.25, 2.0, 40)
    """
    if a.shape != b.shape:
        raise FrameError(f"{names[0]} is {a.shape} but {names[1]} is {b.shape}: two halves share height and width")
    if np.array_equal(a.color, b.color, equal_nan=True) and np.ptp(a.color) > 0:
        raise FrameError(f"{names[0]} and {names[1]} hold the same pixels: render two halves with different seeds")
    samples = [frame.metadata.get("samples_per_pixel") for frame in (a, b)]
    weights = weights_of_halves(a, b)
    planes = {"color_a": _float(a.color), "color_b": _float(b.color)}
    for plane in PLANES:
        one, other = getattr(a, plane), getattr(b, plane)
        if plane in planes or (one is None and other is None):
            continue
        mean = plane.removesuffix("_variance")
        if one is not None and other is not None:
            powers = weights if plane == mean else tuple(weight**2 for weight in weights)
            planes[plane] = weighted_sum(one, other, powers)
        elif plane == mean or (getattr(a, mean) is None) != (getattr(b, mean) is None):
            planes[plane] = _float(one if other is None else other)
    layers = dict(b.metadata.get("layers", {})) | dict(a.metadata.get("layers", {}))
    layers |= {"color_a": str(names[0]), "color_b": str(names[1])}
    metadata = dict(a.metadata) | {"layers": {plane: name for plane, name in layers.items() if plane in planes}}
    metadata.pop("samples_per_pixel", None)
    if None not in samples:
        metadata["samples_per_pixel"] = sum(samples)
    source = a if any(getattr(a, name) is not None for name in VECTORS) else b
    vectors = {name: getattr(source, name) for name in VECTORS}
    metadata |= {name: text for name, text in source.metadata.items() if name == MOTION}
    return Frame(**planes, **vectors, metadata=metadata)


def weights_of_halves(a: Frame, b: Frame) -> tuple[float, float]:
    """What each half is of their mean: by their samples per pixel where both tell, else a half."""
    samples = [frame.metadata.get("samples_per_pixel") for frame in (a, b)]
    return (0.5, 0.5) if None in samples else (samples[0] / sum(samples), samples[1] / sum(samples))


def weighted_sum(one: np.ndarray, other: np.ndarray, weights: tuple[float, float]) -> np.ndarray:
    """float32, with weights such as those of `weights_of_halves`."""
    with np.errstate(over="ignore", invalid="ignore"):  # the door counts and replaces what is not finite
        return np.float32(weights[0]) * _float(one) + np.float32(weights[1]) * _float(other)


def _float(plane: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(plane, np.float32)
