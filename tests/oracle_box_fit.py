"""The guided fit over uniform windows in float64 NumPy: pixel by pixel, and sharing nothing with the kernels.

A block is a square of `block` pixels a side, smaller at the right and bottom edges. A window of radius r around a block
holds (2r+1)² blocks, mirrored at the border without repeating the edge block; a mirrored block counts again, with all
its pixels. Sources: He, Sun, Tang, "Guided Image Filtering", ECCV 2010 (windows, averaged coefficients, eq. 19 for a
guide of several channels); He and Sun, "Fast Guided Filter", 2015 (coefficients at low resolution).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from oracle import auto_exposure, box_mean, luminance, reflect_index
from oracle_regression import (
    by_chance,
    depth_feature,
    outliers,
    prefilter,
    significance,
    spread_removed,
    variance_from_halves,
    variance_from_image,
)

#: Luminances are taken from 0 to the brightest, plus the darkest.
DARKEST, BRIGHTEST = 0.02, 1e5


def relative_weight(color: np.ndarray, relative: float) -> np.ndarray:
    """(l + 0.02)^-relative, l the luminance of the mean over 5x5 pixels, (H, W)."""
    light = luminance(box_mean(np.asarray(color, dtype=np.float64), 2))
    return (np.clip(light, 0.0, BRIGHTEST) + DARKEST) ** -relative


def windows(height: int, width: int, block: int, radius: int) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Row and column of each block, and the rows and columns of all pixels in its window."""
    high, wide = -(-height // block), -(-width // block)
    y, x = np.mgrid[:height, :width]
    for by in range(high):
        for bx in range(wide):
            rows, columns = [], []
            for dy in range(-radius, radius + 1):
                for dx in range(-radius, radius + 1):
                    inside = (y // block == reflect_index(by + dy, high)) & (x // block == reflect_index(bx + dx, wide))
                    rows.append(y[inside])
                    columns.append(x[inside])
            yield by, bx, np.concatenate(rows), np.concatenate(columns)


def upsampled(blocks: np.ndarray, height: int, width: int, block: int) -> np.ndarray:
    """Values of blocks, at their centres, interpolated linearly at the centre of each pixel; mirrored at the border."""

    def matrix(pixels: int, count: int) -> np.ndarray:
        out = np.zeros((pixels, count))
        for i in range(pixels):
            at = (i + 0.5) / block - 0.5
            low = int(np.floor(at))
            out[i, reflect_index(low, count)] += 1.0 - (at - low)
            out[i, reflect_index(low + 1, count)] += at - low
        return out

    rows, columns = matrix(height, blocks.shape[0]), matrix(width, blocks.shape[1])
    return np.einsum("yi,xj,ij...->yx...", rows, columns, blocks)


def box_fit(
    color: np.ndarray,
    variance: np.ndarray,
    features: np.ndarray | None,
    noise: np.ndarray | None,
    *,
    block: int,
    radius: int,
    residual_radius: int,
    relative: float,
    ridge: float,
    noise_ridge: float,
    floor: float,
    residual_noise: float,
) -> np.ndarray:
    """Weighted least squares in the window of each block, applied to each pixel; then a share of the residual back.

    With means and covariances over the window weighted by w: beta = (C + D)^-1 cov(f, c), constant = mean c - mean f
    beta, D_aa = ridge C_aa + (1 + ridge) noise_ridge mean noise_a + floor. The share is max(0, 1 - residual_noise sum w
    variance / sum w |c - fit|²), sums over pixels and channels of the window.
    """
    c = np.asarray(color, dtype=np.float64)
    height, width = c.shape[:2]
    f = np.zeros((height, width, 0)) if features is None else np.asarray(features, dtype=np.float64)
    v = np.zeros_like(f) if noise is None else np.asarray(noise, dtype=np.float64)
    weight = relative_weight(c, relative)
    count = f.shape[-1]
    high, wide = -(-height // block), -(-width // block)

    functions = np.empty((high, wide, 1 + count, 3))
    for by, bx, rows, columns in windows(height, width, block, radius):
        w = weight[rows, columns] / weight[rows, columns].sum()
        fw, cw = f[rows, columns], c[rows, columns]
        f_mean, c_mean = w @ fw, w @ cw
        covariance = (w[:, None] * (fw - f_mean)).T @ (fw - f_mean)
        cross = (w[:, None] * (fw - f_mean)).T @ (cw - c_mean)
        extra = noise_ridge * (w @ v[rows, columns])
        diagonal = ridge * (np.diag(covariance) + extra) + extra + floor
        beta = np.linalg.solve(covariance + np.diag(diagonal), cross)
        functions[by, bx, 0] = c_mean - f_mean @ beta
        functions[by, bx, 1:] = beta
    flat = box_mean(functions.reshape(high, wide, -1), radius)
    at_pixels = upsampled(flat, height, width, block).reshape(height, width, 1 + count, 3)
    fit = at_pixels[..., 0, :] + np.einsum("yxa,yxak->yxk", f, at_pixels[..., 1:, :])

    share = np.empty((high, wide))
    squares = weight * ((c - fit) ** 2).sum(-1)
    expected = weight * np.asarray(variance, dtype=np.float64).sum(-1)
    for by, bx, rows, columns in windows(height, width, block, residual_radius):
        s, e = squares[rows, columns].sum(), expected[rows, columns].sum()
        share[by, bx] = max(s - residual_noise * e, 0.0) / s if s > 0 else 0.0
    out = fit + upsampled(share, height, width, block)[..., None] * (c - fit)
    return np.maximum(out, np.minimum(c, 0.0))


def feature_planes(planes: dict[str, np.ndarray], prefiltered: bool) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Albedo in [0, 1], normal and `depth_feature` side by side, (H, W, C), and the variances."""
    features, noises = [], []
    for name in ("albedo", "normal", "depth"):
        if name not in planes:
            continue
        feature = np.asarray(planes[name], dtype=np.float64)
        given = planes.get(f"{name}_variance")
        noise = np.zeros(feature.shape) if given is None else np.asarray(given, dtype=np.float64)
        if name == "albedo":
            feature = np.clip(feature, 0.0, 1.0)
        elif name == "depth":
            feature, noise = (plane[..., None] for plane in depth_feature(feature, noise))
        if prefiltered and given is not None:
            feature, noise = prefilter(feature, noise)
        features.append(feature)
        noises.append(noise)
    return (np.concatenate(features, -1), np.concatenate(noises, -1)) if features else (None, None)


def denoise_guided(
    color: np.ndarray,
    *,
    prefiltered: bool = False,
    outlier_limit: float | None = 1.0,
    spread_radius: int = 50,
    exposure: float | None = None,
    color_variance: np.ndarray | None = None,
    color_a: np.ndarray | None = None,
    color_b: np.ndarray | None = None,
    planes: dict[str, np.ndarray],
    **options: float,
) -> np.ndarray:
    """Expose, hold back outliers, `box_fit`, give the light back. `outlier_limit` None leaves the outliers in."""
    color = np.asarray(color, dtype=np.float64)
    e = auto_exposure(color) if exposure is None else exposure
    c = e * color
    names = []
    if color_variance is not None:
        names = ["color_variance"]
        variance = e**2 * np.asarray(color_variance, dtype=np.float64)
    elif color_a is not None and color_b is not None:
        names = ["color_a", "color_b"]
        variance = variance_from_halves(*(e * np.asarray(half, dtype=np.float64) for half in (color_a, color_b)))
    else:
        variance = variance_from_image(c)
    kept = c
    if outlier_limit is not None:
        kept, factor = outliers(c, outlier_limit, variance, significance(names), by_chance(names))
        variance = variance * factor[..., None] ** 2
    out = box_fit(kept, variance, *feature_planes(planes, prefiltered), **options)
    if outlier_limit is not None:
        out = spread_removed(out, c - kept, spread_radius)
    return out / e
