"""Which layers of a picture sum to it, told by their pixels alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

#: Pixels of the picture that are looked at in the search, and of each layer besides; and how many of all must bear the
#: sum out at the end.
SAMPLES, OWN, ENOUGH = 512, 64, 0.99

#: Rounding, in units of what is summed: renderers sum in an order of their own, clamp and filter.
HALF, FLOAT = 4e-3, 2e-4

#: A search that has tried so many sums ends with what it has found.
MOST_TRIALS = 20_000

#: Of so many groups all pixels are looked at.
MOST_GROUPS = 64


def find_groups(color: np.ndarray, layers: Mapping[str, np.ndarray]) -> tuple[tuple[str, ...], ...]:
    """Every group of layers whose sum is the picture, in all but a hundredth of its pixels.

    Light is not negative, so a sum that is too bright anywhere can be left, and so can one that all that is left does
    not bring up to the picture: that makes the search for a group (of 2^n) short. Layers that are black, or the picture
    itself, are in none. Where a file has light split up in several ways, say `diffuse` beside `diffuse_direct` and
    `diffuse_indirect`, there are several groups.

    Args:
        color: (H, W, 3), scene-linear.
        layers: (H, W, 3) each, by name.

    Returns:
        Names in the order of `layers`, the groups in order of their size, the largest first.

    Example:
        >>> color = np.random.default_rng(0).random((8, 8, 3))
        >>> find_groups(color, {"half": 0.5 * color, "sun": 0.2 * color, "other": 0.5 * color, "normal": 1 - color})
        (('half', 'other'),)
    """
    at = np.unique(np.concatenate([_telling(color, SAMPLES), *(_telling(image, OWN) for image in layers.values())]))
    names = [name for name in layers if _could_be_part(layers[name], color, at)]
    # The brightest first: whether they are in it decides the most.
    names.sort(key=lambda name: -float(np.abs(_pixels(layers[name], at)).sum()))
    goal = _pixels(color, at)
    samples = [_pixels(layers[name], at) for name in names]
    slack = max((_rounding(layers[name]) for name in names), default=FLOAT)
    slack = max(slack, _rounding(color))
    search = _Search(samples, slack, slack * 0.01 * float(np.abs(goal).mean()), [])
    search.go(goal, 0, (), [sum(samples[i:], np.zeros_like(goal)) for i in range(len(samples) + 1)])
    order = list(layers)
    found = (_completed(color, [names[i] for i in group], names, layers, slack) for group in search.found[:MOST_GROUPS])
    groups = {tuple(sorted(group, key=order.index)) for group in found if len(group) > 1}
    return tuple(sorted(groups, key=lambda group: (-len(group), [order.index(name) for name in group])))


@dataclass
class _Search:
    samples: list[np.ndarray]
    slack: float
    least: float
    found: list[tuple[int, ...]]
    trials: int = 0

    def go(self, rest: np.ndarray, first: int, chosen: tuple[int, ...], left: list[np.ndarray]) -> None:
        """Add to `found` every way to make up `rest` of the samples from number `first` on.

        left: the sum of all samples from each number on.
        """
        self.trials += 1
        room = self.slack * (np.abs(rest) + np.abs(left[0])) + self.least
        if chosen and _most(np.abs(rest) <= room):
            self.found.append(chosen)
            return
        if first == len(self.samples) or self.trials > MOST_TRIALS or not _most(left[first] >= rest - room):
            return
        after = rest - self.samples[first]
        if _most(after >= -room):
            self.go(after, first + 1, (*chosen, first), left)
        self.go(rest, first + 1, chosen, left)


def _most(truths: np.ndarray) -> bool:
    return bool(truths.mean() >= ENOUGH)


def _rounding(image: np.ndarray) -> float:
    return HALF if image.dtype == np.float16 else FLOAT


def _telling(color: np.ndarray, count: int) -> np.ndarray:
    """Indices of pixels with light, spread over the picture."""
    sums = np.nan_to_num(np.asarray(color, np.float32), nan=0, posinf=0, neginf=0).sum(-1).ravel()
    bright = np.flatnonzero(sums > 0)
    chosen = bright if len(bright) else np.arange(sums.size)
    return chosen[np.linspace(0, len(chosen) - 1, min(count, len(chosen))).astype(int)]


def _pixels(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    pixels = image.reshape(-1, 3)[at].astype(np.float64)
    return np.nan_to_num(pixels, nan=0, posinf=0, neginf=0)


def _could_be_part(layer: np.ndarray, color: np.ndarray, at: np.ndarray) -> bool:
    """It has light, not more than there is, and is not all of it."""
    part, whole = _pixels(layer, at), _pixels(color, at)
    slack = max(_rounding(layer), _rounding(color))
    room = slack * (np.abs(part) + np.abs(whole)) + slack * 0.01 * np.abs(whole).mean()
    return (
        bool(np.any(part)) and _most(part >= -room) and _most(part <= whole + room) and not _most(part >= whole - room)
    )


def _bearing_out(color: np.ndarray, layers: Iterable[np.ndarray], slack: float) -> float:
    """In what part of the values that are finite the sum is the picture."""
    whole, total, size = np.asarray(color, np.float64), np.zeros(color.shape), np.abs(color.astype(np.float64))
    with np.errstate(invalid="ignore", over="ignore"):
        for layer in layers:
            total += layer
            size += np.abs(layer.astype(np.float64))
        finite = np.isfinite(total) & np.isfinite(whole)
        off, room = np.abs(total - whole)[finite], (slack * size)[finite]
    return float((off <= room + slack * 0.01 * np.abs(whole[finite]).mean()).mean()) if off.size else 0.0


def _completed(
    color: np.ndarray, group: Sequence[str], names: Sequence[str], layers: Mapping[str, np.ndarray], slack: float
) -> list[str]:
    """The group, and layers so small that the search found it without them; none where the sum does not hold."""
    group = list(group)
    best = _bearing_out(color, (layers[name] for name in group), slack)
    if best < ENOUGH:
        return []
    for name in names:
        if name not in group:
            found = _bearing_out(color, (layers[each] for each in (*group, name)), slack)
            if found > best:
                group, best = [*group, name], found
    return group
