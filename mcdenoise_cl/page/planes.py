"""Images, features and maps as the whole numbers that a page holds, and how far those are from what they stand for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .codec import as_text, encode

#: Part of display white below which light is stored in even steps instead of even ratios.
DARK = 2.0**-7
#: Multiples of display white above which light is cut.
BRIGHTEST = 1e9
#: Steps that light is stored in, from the finest; half a step is the largest error.
STEPS = tuple(0.005 * 2 ** (n / 2) for n in range(13))
#: What an image holds that is no number, in the order of their codes.
MARKS = ("", "NaN", "+Inf", "-Inf")


@dataclass(frozen=True)
class Plane:
    """One thing to look at.

    Attributes:
        name: for people; unique on a page.
        kind: "light", "reflectance", "normal", "depth", "error" or "labels": how page/paint.js shows it.
        values: (H, W, 3) or (H, W), as it came.
        scale: factor to units in which 1 is display white; 1 for what is no light.
        step: of the logarithm of values, or of the values where it is a map of labels or a normal.
        dark: values below it are stored in even steps; 0 where all are.
        labels: names of the values of a map of labels.
        facts: what else the page is told.
    """

    name: str
    kind: str
    values: Any
    scale: float = 1.0
    step: float = 0.01
    dark: float = DARK
    labels: Sequence[str] = ()
    facts: dict[str, Any] = field(default_factory=dict)


def quantise(values: np.ndarray, scale: float, step: float, dark: float) -> np.ndarray:
    """Whole numbers q for values v: sign(v) round(log(1 + |s v| / dark) / step), or round(s v / step) for dark = 0.

    What is not finite becomes 0.

    Example:
        >>> quantise(np.array([0.0, 1.0, -1.0, np.nan]), scale=1.0, step=0.01, dark=2.0**-7).tolist()
        [0, 486, -486, 0]
    """
    values = np.nan_to_num(np.asarray(values, np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    if dark == 0:
        return np.rint(scale * values / step).astype(np.int32)
    with np.errstate(over="ignore"):
        size = np.minimum(scale * np.abs(values), BRIGHTEST)
    return (np.sign(values) * np.rint(np.log1p(size / dark) / step)).astype(np.int32)


def restore(numbers: np.ndarray, scale: float, step: float, dark: float) -> np.ndarray:
    """The values that `quantise` made numbers of, float64.

    v is off by no more than (exp(step / 2) - 1) (|v| + dark / scale).

    Example:
        >>> restore(np.array([0, 486, -486]), scale=1.0, step=0.01, dark=2.0**-7).round(3).tolist()
        [0.0, 1.0, -1.0]
    """
    numbers = np.asarray(numbers, np.float64)
    if dark == 0:
        return numbers * step / scale
    return np.sign(numbers) * np.expm1(np.abs(numbers) * step) * dark / scale


def marks(values: np.ndarray) -> np.ndarray | None:
    """(H, W) of indices into `MARKS`, by the worst channel; None where all is finite.

    Example:
        >>> marks(np.array([[[0.0, np.inf, 1.0], [np.nan, np.inf, 1.0]]])).tolist()
        [[2, 1]]
    """
    values = np.atleast_3d(values)
    if np.isfinite(values).all():
        return None
    found = np.where(np.isposinf(values).any(2), 2, np.where(np.isneginf(values).any(2), 3, 0))
    return np.where(np.isnan(values).any(2), 1, found).astype(np.int32)


def packed(plane: Plane) -> str:
    """The plane as text: its numbers channel by channel, green first and the others less green; then its marks."""
    values = np.asarray(plane.values)
    numbers = quantise(values, plane.scale, plane.step, plane.dark)
    channels = [numbers]
    if numbers.ndim == 3:
        green = numbers[..., 1]
        channels = [green, numbers[..., 0] - green, numbers[..., 2] - green]
    lost = marks(values)
    return " ".join(as_text(encode(channel)) for channel in (channels if lost is None else [*channels, lost]))
