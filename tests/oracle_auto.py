"""The methods `regression` and `auto` from end to end in float64 NumPy, composed of the equations.

The equations are those of `oracle_regression`, `oracle_choice` and `oracle_shrink`; only their order, and what is
estimated where a frame does not have it, is here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from oracle import auto_exposure, box_mean, luminance
from oracle_choice import believed, compare, estimated_error, share
from oracle_regression import (
    by_chance,
    depth_feature,
    first_order_regression,
    outliers,
    prefilter,
    second_pass,
    significance,
    spread_removed,
    variance_from_halves,
    variance_from_image,
)
from oracle_shrink import shrink_to_input


@dataclass(frozen=True)
class Prepared:
    """An exposed frame with its outliers held back; `raw` and `variance` before and after smoothing."""

    exposure: float
    color: np.ndarray
    removed: np.ndarray
    factor: np.ndarray
    raw: np.ndarray
    variance: np.ndarray
    features: np.ndarray
    noise: np.ndarray


def smooth_variance(variance: np.ndarray, color: np.ndarray) -> np.ndarray:
    """The mean of v / (l² + 1e-3) over 5x5 pixels, times l² + 1e-3; l twice the 3x3 mean of the luminance."""
    square = box_mean(box_mean(luminance(color), 1), 1)[..., None] ** 2 + 1e-3
    return box_mean(variance / square, 2) * square


def prepare(color: np.ndarray, planes: dict, outlier_limit: float | None, exposure: float | None) -> Prepared:
    """The variance is the one given, else from the halves, else from the image; features prefiltered if noisy."""
    color = np.asarray(color, dtype=np.float64)
    height, width = color.shape[:2]
    planes = {name: np.asarray(plane, dtype=np.float64) for name, plane in planes.items()}
    e = auto_exposure(color) if exposure is None else exposure
    c = e * color
    if "color_variance" in planes:
        raw = e**2 * planes["color_variance"]
    elif "color_a" in planes:
        raw = variance_from_halves(e * planes["color_a"], e * planes["color_b"])
    else:
        raw = variance_from_image(c)
    kept, factor = c, np.ones((height, width))
    if outlier_limit is not None:
        kept, factor = outliers(c, outlier_limit, raw, significance(planes), by_chance(planes))
    raw = raw * factor[..., None] ** 2

    features, noise = [np.zeros((height, width, 0))], [np.zeros((height, width, 0))]
    for name in ("albedo", "normal", "depth"):
        if name not in planes:
            continue
        plane, variance = planes[name], planes.get(f"{name}_variance")
        if name == "albedo":
            plane = np.clip(plane, 0.0, 1.0)
        elif name == "depth":
            plane, changed = depth_feature(plane, np.zeros((height, width)) if variance is None else variance)
            plane, variance = plane[..., None], None if variance is None else changed[..., None]
        plane, left = (plane, np.zeros(plane.shape)) if variance is None else prefilter(plane, variance)
        features.append(plane)
        noise.append(left)
    joined = np.concatenate(features, axis=-1), np.concatenate(noise, axis=-1)
    return Prepared(e, kept, c - kept, factor, raw, smooth_variance(raw, kept), *joined)


def denoise_regression(
    color: np.ndarray,
    planes: dict,
    *,
    search_radius: int,
    patch_radius: int,
    bandwidth: float,
    outlier_limit: float | None = 1.1,
    spread_radius: int = 50,
    exposure: float | None = None,
    **ridges: float,
) -> np.ndarray:
    """One pass of NFOR (Bitterli et al. 2016). `outlier_limit` None leaves the outliers in. All planes finite."""
    f = prepare(color, planes, outlier_limit, exposure)
    window = {"search_radius": search_radius, "patch_radius": patch_radius, "k": bandwidth}
    out, _ = first_order_regression(f.color, f.variance, f.features, f.noise, f.color, **window, **ridges)
    if outlier_limit is not None:
        out = spread_removed(out, f.removed, spread_radius)
    return out / f.exposure


def normal_numbers(height: int, width: int) -> np.ndarray:
    """A standard normal number a pixel from a hash of its coordinates, by the method of Box and Muller."""

    def scrambled(v: np.ndarray) -> np.ndarray:
        v = v ^ (v >> np.uint32(16))
        v = v * np.uint32(0x7FEB352D)
        v = v ^ (v >> np.uint32(15))
        v = v * np.uint32(0x846CA68B)
        return v ^ (v >> np.uint32(16))

    y, x = np.mgrid[:height, :width].astype(np.uint32)
    one = scrambled(np.uint32(2) * (y * np.uint32(65536) + x) + np.uint32(1))
    two = scrambled(one + np.uint32(0x9E3779B9))
    u, v = (((bits >> np.uint32(8)) + 0.5) / 2**24 for bits in (one, two))
    return np.sqrt(-2.0 * np.log(u)) * np.cos(2.0 * np.pi * v)


def luminance_deviation(variance: np.ndarray) -> np.ndarray:
    """The standard deviation of the luminance of noise that the channels share: the luminance of theirs."""
    return luminance(np.sqrt(np.maximum(variance, 0.0)))


def is_quiet(color: np.ndarray, planes: dict) -> bool:
    """Whether in most pixels with noise that of the luminance is below 0.03 of it; planes as they came."""
    if "color_variance" in planes:
        deviation = luminance_deviation(np.asarray(planes["color_variance"], dtype=np.float64))
    else:
        deviation = luminance(np.abs(np.float64(planes["color_a"]) - planes["color_b"])) / 2.0
    noisy = deviation > 0
    return 2 * np.sum(noisy & (deviation < 0.03 * luminance(np.float64(color)))) > np.sum(noisy)


def disturb(color: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The colours and a quarter of their noise, which the channels share."""
    numbers = normal_numbers(*color.shape[:2])[..., None]
    return color + 0.25 * numbers * np.sqrt(np.maximum(variance, 0.0))


def disturb_by_halves(color: np.ndarray, a: np.ndarray, b: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """The colours and a quarter of half the difference of two halves, which the factor brings to their scale."""
    return color + 0.25 * factor[..., None] * (np.float64(a) - b) / 2.0


def half_difference(f: Prepared, planes: dict) -> np.ndarray:
    """Half the difference of two halves in luminance; made up of the variance where there are none."""
    if "color_a" in planes:
        a, b = (np.asarray(planes[name], dtype=np.float64) for name in ("color_a", "color_b"))
        return f.factor * f.exposure * luminance(a - b) / 2.0
    variance = f.raw if "color_variance" in planes else f.variance
    return normal_numbers(*f.factor.shape) * luminance_deviation(variance)


def denoise_auto(
    color: np.ndarray,
    planes: dict,
    *,
    search_radius: int,
    patch_radius: int,
    bandwidth: float,
    wide_radius: int,
    wide_stride: int,
    wide_bandwidth: float,
    tracking: float,
    doubt: float,
    caution: float,
    keep: float,
    limit: float,
    apart: float,
    smoothing_radius: int,
    outlier_limit: float | None = 1.1,
    spread_radius: int = 50,
    exposure: float | None = None,
    **ridges: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(image, shares (4, H, W) of input, narrow, regression and wide, estimated error)."""
    f = prepare(color, planes, outlier_limit, exposure)
    noisy = np.concatenate([f.color, half_difference(f, planes)[..., None]], axis=-1)
    # Both passes have the same terms.
    ridges["terms_reach"] = max(search_radius, wide_radius * wide_stride)

    def first_fits(tone: np.ndarray, fitted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        window = {"search_radius": search_radius, "patch_radius": patch_radius, "k": bandwidth}
        return first_order_regression(tone, f.variance, f.features, f.noise, fitted, **window, **ridges)

    first, narrow = first_fits(f.color, noisy)
    window = {"stride": wide_stride, "search_radius": wide_radius, "patch_radius": 1, "k": wide_bandwidth}
    wide = second_pass(first, f.features, f.noise, **window, **ridges)

    noise = box_mean(luminance_deviation(f.variance) ** 2, 1)
    scale = box_mean(luminance(first[..., :3]), 1) ** 2 + 1e-3

    def in_brief(image: np.ndarray) -> np.ndarray:
        return np.stack([luminance(image[..., :3]), image[..., 3]], axis=-1)

    def compared(current: np.ndarray, candidate: np.ndarray, target: np.ndarray, tracked: float):
        pair = in_brief(current), in_brief(candidate)
        return compare(*pair, in_brief(target), noise, scale, tracking=tracked, limit=limit)

    g, q = compared(first, wide, noisy, tracking)
    w = share(g, q, radius=smoothing_radius, prior=0.5, doubt=doubt, margin=0.0)
    w = w * believed(in_brief(first), in_brief(wide), apart)
    current = first + w[..., None] * (wide - first)
    g, q = compared(current, narrow, noisy, -tracking)
    n = share(g, q, radius=smoothing_radius, prior=0.0, doubt=doubt, margin=0.0)
    filtered = current + n[..., None] * (narrow - current)
    if "color_variance" in planes or "color_a" in planes:
        noise = luminance_deviation(f.raw) ** 2
    g, q = compared(filtered, noisy, noisy, 0.0)
    known = 2.0 * q * noise / scale
    i = share(g, q, radius=smoothing_radius, prior=1.0, doubt=keep, margin=caution, square=known)
    mixed = filtered + i[..., None] * (noisy - filtered)
    if "color_variance" in planes or "color_a" in planes:
        disturbed = None
        if is_quiet(color, planes):
            again = disturb(f.color, f.raw)
            if "color_a" in planes:
                again = disturb_by_halves(f.color, planes["color_a"], planes["color_b"], f.exposure * f.factor)
            mix, inner = first_fits(again, again)
            second = second_pass(first, f.features, f.noise, mix, **window, **ridges)
            for candidate, part in ((second, w), (inner, n), (again, i)):
                mix = mix + part[..., None] * (candidate - mix)
            disturbed = again, mix
        mixed, i = shrink_to_input(mixed, noisy, f.raw, i, disturbed)
    error = estimated_error(in_brief(filtered), in_brief(noisy), i, scale, radius=smoothing_radius)
    parts = np.stack([i, (1 - i) * n, (1 - i) * (1 - n) * (1 - w), (1 - i) * (1 - n) * w])
    image = mixed[..., :3]
    if outlier_limit is not None:
        image = spread_removed(image, f.removed, spread_radius)
    return image / f.exposure, parts, error
