"""What `stability_inputs.py` does to the healthy room of `stability_base.py`: one function a kind of damage.

A sample that goes wrong is in the colour, in one of the halves and in the variance of the colour, and so it is put into
all three.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from stability_base import HEIGHT, SPP, WIDTH, planes_of, room

from mcdenoise_cl import Frame

Made = tuple[Frame, np.ndarray | None, np.ndarray | None]
Planes = dict[str, np.ndarray]

FEATURES = ("albedo", "normal", "depth")
FEATURE_VARIANCES = tuple(f"{name}_variance" for name in FEATURES)
#: Where a bad sample shows.
SAMPLES = ("color", "color_a", "color_variance")


def damaged(change: Callable[[Planes, np.ndarray], None], mask: np.ndarray | None = None) -> Made:
    """The room after `change`, which gets its planes and its truth as copies to write to."""
    frame, truth = room()
    planes, truth = {name: plane.copy() for name, plane in frame.planes().items()}, truth.copy()
    change(planes, truth)
    return Frame(**planes, metadata={"samples_per_pixel": SPP}), truth, mask


def without(names: tuple[str, ...], made: Made) -> Made:
    """The same frame without some of its planes."""
    frame, *rest = made
    return Frame(**{name: plane for name, plane in frame.planes().items() if name not in names}), *rest


def around(place: tuple[int, int], radius: int) -> np.ndarray:
    """True within `radius` pixels of a place, in a square."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[place[0] - radius : place[0] + radius + 1, place[1] - radius : place[1] + radius + 1] = True
    return mask


def scattered(share: float, seed: int = 2) -> np.ndarray:
    """True in this part of the pixels."""
    return np.random.default_rng(seed).random((HEIGHT, WIDTH)) < share


def rows(first: int, last: int) -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[first:last] = True
    return mask


def spoilt(where: np.ndarray, value: float, names: tuple[str, ...] = SAMPLES, mask: np.ndarray | None = None) -> Made:
    """`value` in these planes at these pixels."""

    def change(planes: Planes, _: np.ndarray) -> None:
        for name in names:
            planes[name][where] = value

    return damaged(change, mask)


def sharpened() -> Made:
    """As a reconstruction filter with negative lobes leaves it: beside the lamp and the window light is below 0."""

    def lobes(image: np.ndarray) -> np.ndarray:
        padded = np.pad(image, ((1, 1), (1, 1), (0, 0)), mode="reflect")
        sides = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        return 1.4 * image - 0.1 * sides

    def change(planes: Planes, truth: np.ndarray) -> None:
        for image in (planes["color"], planes["color_a"], planes["color_b"], truth):
            image[:] = lobes(image)
        planes["color_variance"] *= 1.4**2 + 4 * 0.1**2

    return damaged(change)


def firefly(truth: np.ndarray, times: float) -> np.ndarray:
    """A sample `times` as bright as the mean of the frame, in the colour of a warm light."""
    return times * truth.mean() * np.float32([1.0, 0.9, 0.8])


def fireflies(where: np.ndarray, times: float, mask: np.ndarray | None) -> Made:
    """One sample of each of these pixels is such a firefly: an error, that the truth knows nothing of."""

    def change(planes: Planes, truth: np.ndarray) -> None:
        _strike(planes, where, firefly(truth, times))

    return damaged(change, mask)


def rare_light(share: float = 0.01, times: float = 1e3) -> Made:
    """Light that this part of the pixels has found, with one sample each; the truth has it everywhere."""

    def change(planes: Planes, truth: np.ndarray) -> None:
        sample = firefly(truth, times)
        _strike(planes, scattered(share), sample)
        truth += share * sample / SPP

    return damaged(change)


def _strike(planes: Planes, where: np.ndarray, sample: np.ndarray) -> None:
    planes["color"][where] += sample / SPP
    planes["color_a"][where] += 2 * sample / SPP
    planes["color_variance"][where] += (sample / SPP) ** 2


def lamps(where: np.ndarray, times: float, mask: np.ndarray) -> Made:
    """Pixels that every sample finds `times` as bright as the mean of the frame, with noise of 2 %."""

    def change(planes: Planes, truth: np.ndarray) -> None:
        rng = np.random.default_rng(3)
        light = times * truth.mean() * np.float32([1.0, 0.8, 0.5])
        samples = light * (1 + 0.02 * np.sqrt(SPP) * rng.standard_normal((SPP, int(where.sum()), 1)))
        truth[where] = light
        planes["color"][where] = samples.mean(0)
        planes["color_a"][where], planes["color_b"][where] = samples[::2].mean(0), samples[1::2].mean(0)
        planes["color_variance"][where] = samples.var(0, ddof=1) / SPP

    return damaged(change, mask)


def filament() -> np.ndarray:
    """A wire, one pixel thick, on the plain wall."""
    where = np.zeros((HEIGHT, WIDTH), bool)
    x = np.arange(45, 75)
    where[np.round(52 + 3 * np.sin(x / 2)).astype(int), x] = True
    return where


def constant(values: dict[str, tuple[float, ...] | float]) -> Made:
    """Features that are the same everywhere, and known to be."""

    def change(planes: Planes, _: np.ndarray) -> None:
        for name, value in values.items():
            planes[name][:] = value
            planes[f"{name}_variance"][:] = 0

    return damaged(change)


def one_plane(stripe: int) -> Made:
    """A wall with stripes of so many pixels and the edge of a shadow, and one normal: every SSIM is 1."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    albedo = (0.5 + 0.3 * (x // stripe % 2))[..., None] * np.float32([1, 0.9, 0.8])
    truth = (albedo * np.where(x + y > 140, 0.3, 1.0)[..., None]).astype(np.float32)
    samples = truth * np.random.default_rng(6).gamma(4.0, 1 / 4.0, (SPP, HEIGHT, WIDTH, 1))
    color, color_variance = planes_of(samples.astype(np.float32))
    normal = np.zeros_like(truth) + np.float32([0, 0, 1])
    return Frame(color, albedo=albedo.astype(np.float32), normal=normal, color_variance=color_variance), truth, None


def opposite_normals() -> Made:
    """Normals that turn round every three pixels: patches three pixels apart are opposites, and SSIM is below 0."""

    def change(planes: Planes, _: np.ndarray) -> None:
        stripes = np.where(np.arange(WIDTH) // 3 % 2, 1, -1)[:, None]
        planes["normal"][:] = stripes * np.float32([1, 1, 1]) / np.sqrt(3)
        planes["normal_variance"][:] = 0

    return damaged(change)


def without_noise() -> Made:
    """The truth with no variance anywhere: every difference between patches is real."""

    def change(planes: Planes, truth: np.ndarray) -> None:
        for name in ("color", "color_a", "color_b"):
            planes[name][:] = truth
        planes["color_variance"][:] = 0

    return damaged(change)


def scaled(name: str, factor: float | np.ndarray) -> Made:
    """A feature times something, and its variance times the square of it."""

    def change(planes: Planes, _: np.ndarray) -> None:
        planes[name] *= np.float32(factor)
        planes[f"{name}_variance"] *= np.float32(factor) ** 2

    return damaged(change)


def depth_of_the_sky(value: float) -> Made:
    """What a renderer may write where a ray meets nothing."""

    def change(planes: Planes, _: np.ndarray) -> None:
        planes["depth"][(planes["normal"] == 0).all(-1)] = value

    return damaged(change)


def noise_alone(known: bool) -> Made:
    """Features that hold nothing but noise, with variances that say so or none."""

    def change(planes: Planes, _: np.ndarray) -> None:
        rng = np.random.default_rng(4)
        for name, low, high in (("albedo", 0, 1), ("normal", -1, 1), ("depth", 1, 5)):
            planes[name][:] = rng.uniform(low, high, planes[name].shape)
            planes[f"{name}_variance"][:] = (high - low) ** 2 / 12

    return damaged(change) if known else without(FEATURE_VARIANCES, damaged(change))


def swapped() -> Made:
    """Albedo where the normal belongs and the other way round."""

    def change(planes: Planes, _: np.ndarray) -> None:
        for end in ("", "_variance"):
            planes[f"albedo{end}"], planes[f"normal{end}"] = planes[f"normal{end}"], planes[f"albedo{end}"]

    return damaged(change)


def of_another_frame() -> Made:
    """Features mirrored left to right: sharp, of low variance, and wrong."""

    def change(planes: Planes, _: np.ndarray) -> None:
        for name in (*FEATURES, *FEATURE_VARIANCES):
            planes[name] = np.ascontiguousarray(planes[name][:, ::-1])

    return damaged(change)


def healthy() -> Made:
    """Nothing is wrong."""
    return damaged(lambda *_: None)
