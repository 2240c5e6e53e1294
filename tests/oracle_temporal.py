"""Neighbouring frames merged into a frame, in float64 NumPy: the equations at the top of kernels/temporal.cl.

Images are (H, W, C). A guide is (H, W, channels + groups): the planes of the features `names` and after them the sums
of their variances.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import oracle
import oracle_regression

RADIUS, BLOCK, FARTHEST = 4, 8, 64
MOST, STAY, BENT, SNAP, TIE = 8.0, 0.05, 0.1, 0.15, 1e-3
TOLERANCE = {"albedo": 0.05**2, "normal": 0.1**2, "depth": 0.05**2}
TAP, PIXEL, EDGE, SPIKE = (1.0, 4.0), (1.0, 3.0), (4.0, 12.0), (16, 36)
STAKE, DARK2, CHANCE, PIXELS = 0.1, 0.01, 4.0, 49


def kept(x: np.ndarray, first: float, last: float) -> np.ndarray:
    """1 up to `first`, 0 from `last` on, a smooth step between."""
    t = np.clip((last - x) / (last - first), 0, 1)
    return t * t * (3 - 2 * t)


def channel_counts(names: Sequence[str]) -> list[int]:
    return [1 if name == "depth" else 3 for name in names]


def guide(features: Mapping[str, tuple[np.ndarray, np.ndarray | None]]) -> np.ndarray:
    planes, noises = [], []
    for name, (plane, variance) in features.items():
        plane = np.atleast_3d(plane).astype(float)
        planes.append(np.clip(plane, 0, 1) if name == "albedo" else plane)
        noise = np.zeros(plane.shape[:2]) if variance is None else np.atleast_3d(variance).astype(float).sum(-1)
        noises.append(noise[..., None])
    return np.concatenate(planes + noises, -1)


def mismatch(a: np.ndarray, b: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """How far two guides, (..., C), differ beyond their noise."""
    counts = channel_counts(names)
    sum_, first = 0.0, 0
    for group, (name, count) in enumerate(zip(names, counts, strict=True)):
        x, y = a[..., first : first + count], b[..., first : first + count]
        noise = a[..., sum(counts) + group] + b[..., sum(counts) + group]
        squares = ((x - y) ** 2).sum(-1)
        tolerance = TOLERANCE.get(name)
        if name == "depth":
            size = (abs(x) + abs(y))[..., 0] + 1e-15
            squares, noise = squares / size**2, noise / size**2
        elif name == "color":
            tolerance = 0.1**2 * ((x**2).sum(-1) + (y**2).sum(-1)) + 1e-12
        sum_ = sum_ + (squares - noise) / (noise + tolerance)
        first += count
    return sum_


def match_costs(own: np.ndarray, other: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """(blocks down, blocks across, offsets): sums of mismatches."""
    height, width = own.shape[:2]
    padded = oracle.pad(other, RADIUS)
    down, across = -(-height // BLOCK), -(-width // BLOCK)
    costs = np.zeros((down, across, (2 * RADIUS + 1) ** 2))
    for offset, (dy, dx) in enumerate(np.ndindex(2 * RADIUS + 1, 2 * RADIUS + 1)):
        each = np.minimum(mismatch(own, padded[dy : dy + height, dx : dx + width], names), MOST)
        for y, x in np.ndindex(down, across):
            costs[y, x, offset] = each[8 * y : 8 * y + 8, 8 * x : 8 * x + 8].sum()
    return costs


def smoothed(of_blocks: np.ndarray) -> np.ndarray:
    """(blocks down, blocks across, C): the sums of each and those around, weighted 1 2 1 both ways."""
    down, across = of_blocks.shape[:2]
    sums = np.zeros(of_blocks.shape)
    for y, x in np.ndindex(down, across):
        for j in range(max(y - 1, 0), min(y + 2, down)):
            for i in range(max(x - 1, 0), min(x + 2, across)):
                sums[y, x] += (1 + (j == y)) * (1 + (i == x)) * of_blocks[j, i]
    return sums


def offset_costs(costs: np.ndarray, height: int, width: int) -> np.ndarray:
    """(blocks, 9, 9): the mean costs around each block, and of moving."""
    pixels = [[min(8, n - 8 * i) for i in range(-(-n // 8))] for n in (height, width)]
    means = smoothed(costs) / smoothed(np.outer(*pixels)[..., None].astype(float))
    span = np.arange(-RADIUS, RADIUS + 1)
    return means.reshape(-1, span.size, span.size) + STAY * np.hypot(span[:, None], span)


def find_motion(costs: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(blocks down, blocks across, 2): to the right and down; and how near the choice was to another.

    Of equal costs, which mirrored borders make of small images, the first counts.
    """
    down, across = costs.shape[:2]
    side = 2 * RADIUS + 1
    motion, margin = np.zeros((down, across, 2)), np.zeros((down, across))
    for (y, x), cost in zip(np.ndindex(down, across), offset_costs(costs, height, width), strict=True):
        best = cost.min()
        second = min(cost[cost > best + 1e-12], default=np.inf)
        v, u = np.unravel_index(cost.argmin(), cost.shape)
        margin[y, x] = second - best
        for axis, (at, line) in enumerate(((u, cost[v, :]), (v, cost[:, u]))):
            part = 0.0
            if 0 < at < side - 1:
                bent = max(line[at - 1] + line[at + 1] - 2 * line[at], 0) + BENT
                part = np.clip(0.5 * (line[at - 1] - line[at + 1]) / bent, -0.5, 0.5)
                margin[y, x] = min(margin[y, x], abs(abs(part) - SNAP))
            motion[y, x, axis] = at - RADIUS + (part if abs(part) >= SNAP else 0)
    return motion, margin


def choose_motion(
    own: np.ndarray, other: np.ndarray, names: Sequence[str], given: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Motion (H, W, 2): `given`, or what is found in the blocks where that costs less; and by how much, of blocks."""
    height, width = own.shape[:2]
    costs = match_costs(own, other, names)
    found, _ = find_motion(costs, height, width)
    taps = taps_of(given, height, width)
    nearest = taps.weight.argmax(-1)[..., None]
    ys, xs = (np.take_along_axis(index, nearest, -1)[..., 0] for index in (taps.y, taps.x))
    counts = (taps.weight.max(-1) > 0).astype(float)
    each = counts * np.minimum(mismatch(own, other[ys, xs], names), MOST)
    sums, counts = (
        smoothed(
            np.stack([[image[y : y + 8, x : x + 8].sum() for x in range(0, width, 8)] for y in range(0, height, 8)])
        )
        for image in (each, counts)
    )
    least = offset_costs(costs, height, width).min((1, 2)).reshape(found.shape[:2])
    margin = sums - (least + TIE) * counts
    chosen = (margin <= 0).repeat(BLOCK, 0).repeat(BLOCK, 1)[:height, :width, None]
    return np.where(chosen, given, found.repeat(BLOCK, 0).repeat(BLOCK, 1)[:height, :width]), margin


@dataclass(frozen=True)
class Taps:
    """The four pixels around the place to which each pixel has moved: rows, columns and weights, (H, W, 4)."""

    y: np.ndarray
    x: np.ndarray
    weight: np.ndarray

    def of(self, image: np.ndarray) -> np.ndarray:
        """(H, W, 4, C)."""
        return image[self.y, self.x]


def taps_of(motion: np.ndarray, height: int, width: int) -> Taps:
    """`motion` is (H, W, 2), or of blocks."""
    if motion.shape[:2] != (height, width):
        motion = motion.repeat(BLOCK, 0).repeat(BLOCK, 1)[:height, :width]
    motion = motion.astype(np.float32).astype(float)
    y, x = np.mgrid[:height, :width]
    left, top = x + np.floor(motion[..., 0]), y + np.floor(motion[..., 1])
    right, below = motion[..., 0] % 1, motion[..., 1] % 1
    u, v = left + (right >= 0.5), top + (below >= 0.5)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (abs(motion[..., 1]) <= FARTHEST)
    ys, xs, weights = [], [], []
    for j, i in ((0, 0), (0, 1), (1, 0), (1, 1)):
        ys.append(np.clip(top + j, 0, height - 1))
        xs.append(np.clip(left + i, 0, width - 1))
        weights.append((below if j else 1 - below) * (right if i else 1 - right) * inside)
    return Taps(np.stack(ys, -1).astype(int), np.stack(xs, -1).astype(int), np.stack(weights, -1))


def relative_to_darker(light: np.ndarray, other: np.ndarray) -> np.ndarray:
    """What squared differences of light are relative to, one over it."""
    darker = np.minimum(abs(light[..., :3].mean(-1)), abs(other[..., :3].mean(-1)))
    return 1 / (darker**2 + DARK2)


def strict_mismatch(
    own: np.ndarray, taps: np.ndarray, light: np.ndarray, taps_light: np.ndarray, names: Sequence[str]
) -> np.ndarray:
    """(H, W, 4): the mismatch where the noise of the noisier of two counts the less, the more they differ in light."""
    own, light = np.broadcast_to(own[..., None, :], taps.shape), light[..., None, :]
    squares = ((light[..., :3] - taps_light[..., :3]) ** 2).sum(-1)
    doubt = 1 / (1 + STAKE * relative_to_darker(light, taps_light) * squares)[..., None]
    first = sum(channel_counts(names))
    least = np.minimum(own[..., first:], taps[..., first:])
    a, b = (
        np.concatenate([image[..., :first], doubt * image[..., first:] + (1 - doubt) * least], -1)
        for image in (own, taps)
    )
    return mismatch(a, b, names)


def weigh(
    own: np.ndarray,
    other: np.ndarray,
    light: np.ndarray,
    other_light: np.ndarray,
    motion: np.ndarray,
    names: Sequence[str],
) -> np.ndarray:
    """(H, W, 4): the weights of the four pixels. `light` is (H, W, 4): colour and the sum of its variances."""
    height, width = own.shape[:2]
    taps = taps_of(motion, height, width)
    same_thing = kept(strict_mismatch(own, taps.of(other), light, taps.of(other_light), names), *EDGE)
    weights = taps.weight * (1e-3 + kept(mismatch(own[..., None, :], taps.of(other), names), *TAP) * same_thing)
    sums = weights.sum(-1, keepdims=True)
    weights = np.divide(weights, sums, out=np.zeros_like(weights), where=sums > 0)

    def moved(image: np.ndarray, means: int) -> np.ndarray:
        """The first `means` channels are averaged, the others are variances."""
        each = taps.of(image)
        mean, variance = (weights[..., None] * each).sum(-2), (weights[..., None] ** 2 * each).sum(-2)
        return np.concatenate([mean[..., :means], variance[..., means:]], -1)

    there = sums[..., 0] > 0
    counts = channel_counts(names)
    found, seen = moved(other, sum(counts)), moved(other_light, 3)
    differs = np.where(there, np.minimum(mismatch(own, found, names), MOST), MOST)
    difference = np.where(there[..., None], light[..., :3] - seen[..., :3], 0)
    squares = (difference**2).sum(-1)
    noise = np.where(there, light[..., 3] + seen[..., 3], 0)
    same = (taps.weight * same_thing).sum(-1) * kept(squares / (noise + 1e-9), *SPIKE)
    relative = relative_to_darker(light, seen)

    def around(image: np.ndarray, radius: int = 3) -> np.ndarray:
        return oracle.box_mean(np.atleast_3d(image), radius).reshape(image.shape)

    of_noise = around(relative * noise) + 1e-9
    excess = np.maximum(around(relative * squares) / of_noise, around(squares) / (around(noise) + 1e-9)) - 1
    shift = PIXELS * (around(np.sqrt(relative)[..., None] * difference) ** 2).sum(-1) / of_noise
    least_squares = 1 / (1 + 2 * np.maximum(excess, 0) + 2 * np.maximum(shift - CHANCE, 0))
    return weights * (same * kept(around(differs, 1), *PIXEL) * least_squares)[..., None]


def gained(
    other: np.ndarray, factor: np.ndarray, weights: np.ndarray, motion: np.ndarray, *, squared: bool, light: bool
) -> np.ndarray:
    """What a plane of another frame adds; of variances (H, W, C) NaN where they are not known."""
    height, width = other.shape[:2]
    taps = taps_of(motion, height, width)
    power = 2 if squared else 1
    values = taps.of(other).astype(float)
    f = taps.of(factor)[..., None] if light else np.ones((height, width, 4, 1))
    each = (weights[..., None] * f) ** power * values if squared else weights[..., None] * f * values
    result = each.sum(-2)
    unknown = ((weights[..., None] > 0) & (values < 0)).any(-2)
    if light:
        nearest = taps.weight.argmax(-1)[..., None]
        ys, xs = (np.take_along_axis(index, nearest, -1)[..., 0] for index in (taps.y, taps.x))
        all_ = weights.sum(-1)[..., None]
        own, value = factor[ys, xs][..., None], other[ys, xs].astype(float)
        result = result + all_**power * (1 - own**power) * value
        unknown |= (all_ > 0) & (value < 0)
    return np.where(unknown, np.nan, result) if squared else result


def look(
    planes: Mapping[str, np.ndarray], exposure: float
) -> tuple[tuple[str, ...], np.ndarray, np.ndarray, np.ndarray]:
    """Names, guide, light and factor of a frame with a known variance, or halves, or neither."""
    color = planes["color"].astype(float) * exposure
    if "color_variance" in planes:
        variance = planes["color_variance"].astype(float) * exposure**2
        variance = np.where(variance < 0, oracle_regression.variance_from_image(color), variance)
    elif "color_a" in planes:
        a, b = (planes[name].astype(float) * exposure for name in ("color_a", "color_b"))
        variance = oracle_regression.variance_from_halves(a, b)
    else:
        variance = oracle_regression.variance_from_image(color)
    held, factor = oracle_regression.outliers(
        color, 1.1, variance, oracle_regression.significance(planes), oracle_regression.by_chance(planes)
    )
    variance = variance * factor[..., None] ** 2
    noise = variance.sum(-1, keepdims=True)
    if not {"color_variance", "color_a"} & set(planes):
        noise = oracle.box_mean(noise, 1)
    light = np.concatenate([held, noise], -1)
    names = [name for name in ("albedo", "normal", "depth") if name in planes]
    features = {name: (planes[name], planes.get(f"{name}_variance")) for name in names}
    if "albedo" not in features:
        features["color"] = (held, noise)
    return tuple(features), guide(features), light, factor


def merge(
    frame: Mapping[str, np.ndarray], neighbours: Sequence[Mapping[str, np.ndarray]], names: Sequence[str]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The merged planes, and the sum of the weights of all frames, (H, W)."""
    exposure = oracle.auto_exposure(frame["color"])
    features, own, light, _ = look(frame, exposure)
    total = np.ones(own.shape[:2])
    sums = {name: np.atleast_3d(frame[name]).astype(float) for name in names}
    sums = {name: np.where(plane < 0, np.nan, plane) if "variance" in name else plane for name, plane in sums.items()}
    for neighbour in neighbours:
        _, other, other_light, factor = look(neighbour, exposure)
        if (given := neighbour.get("motion")) is None:
            motion, _ = find_motion(match_costs(own, other, features), *total.shape)
        else:
            motion, _ = choose_motion(own, other, features, given)
        weights = weigh(own, other, light, other_light, motion, features)
        total = total + weights.sum(-1)
        for name in names:
            kind = {"squared": "variance" in name, "light": name.startswith("color")}
            sums[name] = sums[name] + gained(np.atleast_3d(neighbour[name]), factor, weights, motion, **kind)
    merged = {}
    for name, plane in sums.items():
        mean = plane / total[..., None] ** (2 if "variance" in name else 1)
        merged[name] = np.where(np.isnan(mean), -1, mean).reshape(np.shape(frame[name]))
    return merged, total
