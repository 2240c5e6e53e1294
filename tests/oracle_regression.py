"""The equations of the method `regression` in float64 NumPy: slow, obvious, and sharing nothing with the kernels.

Sources: Rousselle, Knaus, Zwicker, "Adaptive Rendering with Non-Local Means Filtering", 2012; Rousselle, Manzi,
Zwicker, "Robust Denoising using Feature and Color Information", 2013; Bitterli et al., "Nonlinearly Weighted
First-Order Regression for Denoising Monte Carlo Renderings" (NFOR), 2016. Images are (H, W, C), or (H, W) where a
function does not name its channels. Windows and offsets are those of `oracle`: mirrored, edge pixel not repeated.
"""

from __future__ import annotations

import numpy as np
from oracle import box_mean, luminance, neighbours, offsets, pad, reflect_index, shifted

#: Added to the sum of two variances, so that the distance of two noise-free pixels is finite.
VARIANCE_FLOOR = 1e-8

#: The columns and rows of the blocks that share their choice of features.
BLOCK_COLUMNS, BLOCK_ROWS = 32, 8

#: A feature serves a block where its variance is above this ...
LEAST_VARIANCE = 1e-8

#: ... and above this many times the variance of its own noise.
LEAST_SIGNAL = 2.0

# --- Outliers and variances -------------------------------------------------------------------------------


def outliers(
    color: np.ndarray, limit: float = 1.0, variance: np.ndarray | None = None, significant: float = np.inf
) -> tuple[np.ndarray, np.ndarray]:
    """Scale each pixel so that its largest channel is at most `limit` times that of its 8 neighbours.

    Returns the scaled image and the factor (H, W): 1 where l <= b, b = limit · max(m, 0), or where l - b is more than
    `significant` times the square root of the sum of the channels' variances; else b / l.
    """
    color = np.asarray(color, dtype=np.float64)
    largest = color.max(axis=-1)
    window = neighbours(largest, 1)
    bound = limit * np.maximum(np.delete(window, 4, axis=0).max(axis=0), 0.0)
    over = largest > bound
    if variance is not None and np.isfinite(significant):
        over &= ~(largest - bound > significant * np.sqrt(np.maximum(np.float64(variance).sum(axis=-1), 0.0)))
    factor = np.where(over, bound / np.where(over, largest, 1.0), 1.0)
    return factor[..., None] * color, factor


def variance_from_halves(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(a - b)² / 4: the variance of the mean of two independent halves (Rousselle et al. 2012)."""
    return (np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64)) ** 2 / 4.0


def variance_from_image(color: np.ndarray) -> np.ndarray:
    """(c * M)² / 36, M the Laplacian difference mask of Immerkaer (1996), whose squares sum to 36; not smoothed."""
    padded = pad(color, 1)
    mask = [[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]
    response = sum(mask[dy + 1][dx + 1] * shifted(padded, 1, dx, dy) for dx, dy in offsets(1))
    return response**2 / 36.0


# --- Variance-aware distance ------------------------------------------------------------------------------


def _channel_sum(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else image.sum(axis=-1)


def variance_distance(color: np.ndarray, variance: np.ndarray, dx: int, dy: int, patch_radius: int) -> np.ndarray:
    """Rousselle et al. (2012), d² between the patches around i and i + (dx, dy) less what noise explains, (H, W).

    Each pixel of a patch adds (Σ_c (x - y)² - (V + min(V, U))) / (V + U + 1e-8), V and U the variances summed over
    the channels (a variance of one channel is that sum); mean over the patch, then at least 0. Both images are
    mirrored before, so a patch over the border reads mirrored pixels.
    """
    margin = patch_radius + max(abs(dx), abs(dy))
    padded, padded_variance = pad(color, margin), pad(_channel_sum(np.asarray(variance, dtype=np.float64)), margin)
    terms = []
    for px, py in offsets(patch_radius):
        x, y = shifted(padded, margin, px, py), shifted(padded, margin, px + dx, py + dy)
        v, u = shifted(padded_variance, margin, px, py), shifted(padded_variance, margin, px + dx, py + dy)
        terms.append((_channel_sum((x - y) ** 2) - (v + np.minimum(v, u))) / (v + u + VARIANCE_FLOOR))
    return np.maximum(np.mean(terms, axis=0), 0.0)


# --- Features ---------------------------------------------------------------------------------------------


def depth_feature(depth: np.ndarray, variance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d = z / (z + s), s the geometric mean of the depths above 0; the variance times the squared derivative."""
    depth, variance = np.asarray(depth, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    positive = depth[np.isfinite(depth) & (depth > 0.0)]
    scale = float(np.exp(np.log(positive).mean())) if positive.size else 1.0
    z = np.where(depth > 0.0, depth, 0.0)
    return z / (z + scale), variance * (scale / (z + scale) ** 2) ** 2


def prefilter(
    feature: np.ndarray, variance: np.ndarray, search_radius: int = 2, patch_radius: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Non-local means of a feature on its own variance (Rousselle et al. 2013), and the variance that is left.

    v is the 3x3 mean of min(variance, 1); filtered = Σ w f / Σ w, its variance Σ w² v / (Σ w)², f and v those of
    the neighbours.
    """
    feature = np.asarray(feature, dtype=np.float64)
    v = box_mean(np.minimum(variance, 1.0), 1)
    distances = [variance_distance(feature, v, dx, dy, patch_radius) for dx, dy in offsets(search_radius)]
    weights = np.maximum(0.0, 1.0 - np.stack(distances) / 4.0) ** 4
    if feature.ndim == 3:
        weights = weights[..., None]
    z = weights.sum(axis=0)
    filtered = (weights * neighbours(feature, search_radius)).sum(axis=0) / z
    return filtered, (weights**2 * neighbours(v, search_radius)).sum(axis=0) / z**2


# --- Regression -------------------------------------------------------------------------------------------


def regression_weight(
    guide: np.ndarray, variance: np.ndarray, dx: int, dy: int, *, patch_radius: int, k: float
) -> np.ndarray:
    """w = mean of max(0, 1 - d / (4 k²))⁴ over two `variance_distance` d: of patch_radius and of its half, (H, W).

    Near exp(-d / k²) (Rousselle et al. 2012) where d is small, and 0 from d = 4 k² on.
    """
    distances = [variance_distance(guide, variance, dx, dy, radius) for radius in (patch_radius, patch_radius // 2)]
    return np.mean([np.maximum(0.0, 1.0 - d / (4.0 * k**2)) ** 4 for d in distances], axis=0)


def terms_of_blocks(features: np.ndarray, noise: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which features carry something: (mean μ, variance s, used) of the block of every pixel, each (H, W, F).

    μ and s are those of the block and `reach` pixels around it in the mirrored image, a block at the right or the
    lower border whole; n is the mean of `noise` over the pixels of the block. Used where s > 1e-8 and s > 2 n.
    """
    features, noise = np.asarray(features, dtype=np.float64), np.asarray(noise, dtype=np.float64)
    height, width = features.shape[:2]
    mean, variance, left = np.empty((3, *features.shape))
    for y0 in range(0, height, BLOCK_ROWS):
        for x0 in range(0, width, BLOCK_COLUMNS):
            rows = reflect_index(np.arange(y0 - reach, y0 + BLOCK_ROWS + reach), height)
            columns = reflect_index(np.arange(x0 - reach, x0 + BLOCK_COLUMNS + reach), width)
            region = features[rows][:, columns]
            block = np.s_[y0 : y0 + BLOCK_ROWS, x0 : x0 + BLOCK_COLUMNS]
            mean[block] = region.mean(axis=(0, 1))
            variance[block] = region.var(axis=(0, 1))
            left[block] = noise[block].mean(axis=(0, 1))
    return mean, variance, (variance > LEAST_VARIANCE) & (variance > LEAST_SIGNAL * left)


def ridge_fit(m: np.ndarray, r: np.ndarray, ridge: float, rho: np.ndarray) -> np.ndarray:
    """The first row of M⁻¹ R, the fit at the pixel itself; M_aa becomes M_aa (1 + ridge) + M_00 ρ_a for a > 0."""
    m = m.copy()
    for a in range(1, m.shape[-1]):
        m[..., a, a] += ridge * m[..., a, a] + m[..., 0, 0] * rho[..., a - 1]
    return np.linalg.solve(m, r)[..., 0, :]


def first_order_regression(
    color_guide: np.ndarray,
    guide_variance: np.ndarray,
    features: np.ndarray | None,
    feature_variance: np.ndarray | None,
    color: np.ndarray,
    *,
    search_radius: int,
    patch_radius: int,
    stride: int = 1,
    k: float,
    ridge: float,
    noise_ridge: float,
    position_ridge: float,
) -> tuple[np.ndarray, np.ndarray]:
    """NFOR (Bitterli et al. 2016): fit `color` over the window, linear in features and position, read it at i.

    M = Σ w t tᵀ, R = Σ w t colorᵀ over the offsets (dx, dy) · stride, |dx|, |dy| <= S; w the `regression_weight` of
    the guide; terms t = (1, f_j - f_i, dx / S, dy / S), features that their block does not use left out. The ridge ρ
    is noise_ridge · v + 5e-5 (s + (f_i - μ)²) + 1e-9 for a feature of variance v, position_ridge + 1e-9 for the
    positions.
    Returns that fit, and the inner one: of the offsets |dx|, |dy| <= S // 2 alone, in the same terms.
    `features` and `feature_variance` are (H, W, F), F any number; None is none. `color` has 3 columns or 4, the
    fourth a half difference: of either sign, where a colour may only be negative if the pixel itself is.
    """
    color = np.asarray(color, dtype=np.float64)
    height, width, columns = color.shape
    features = np.zeros((height, width, 0)) if features is None else np.asarray(features, dtype=np.float64)
    if feature_variance is None:
        feature_variance = np.zeros(features.shape)
    reach, span = search_radius * stride, max(search_radius, 1)
    mean, variance, used = terms_of_blocks(features, feature_variance, reach)
    padded_features, padded_color = pad(features, reach), pad(color, reach)

    size = 1 + features.shape[-1] + 2
    m, inner_m = np.zeros((2, height, width, size, size))
    r, inner_r = np.zeros((2, height, width, size, columns))
    for dx, dy in offsets(search_radius):
        j = dx * stride, dy * stride
        w = regression_weight(color_guide, guide_variance, *j, patch_radius=patch_radius, k=k)[..., None, None]
        t = np.ones((height, width, size))
        # A term that is 0 over the window has the coefficient 0: the fit without it.
        t[..., 1:-2] = np.where(used, shifted(padded_features, reach, *j) - features, 0.0)
        t[..., -2:] = dx / span, dy / span
        square = w * t[..., :, None] * t[..., None, :]
        product = w * t[..., :, None] * shifted(padded_color, reach, *j)[..., None, :]
        m, r = m + square, r + product
        if max(abs(dx), abs(dy)) <= search_radius // 2:
            inner_m, inner_r = inner_m + square, inner_r + product

    rho = np.full((height, width, size - 1), position_ridge + 1e-9)
    rho[..., :-2] = noise_ridge * feature_variance + 5e-5 * (variance + (features - mean) ** 2) + 1e-9
    fits = ridge_fit(m, r, ridge, rho), ridge_fit(inner_m, inner_r, ridge, rho)
    for fit in fits:
        # A fit may overshoot below 0, where light cannot be; only a pixel that is negative itself may stay so.
        fit[..., :3] = np.maximum(fit[..., :3], np.minimum(color[..., :3], 0.0))
    return fits


def second_pass(
    first: np.ndarray, features: np.ndarray | None, feature_variance: np.ndarray | None, **options
) -> np.ndarray:
    """`first_order_regression`, with these options, of what one gave: `first`, colour F and half difference d.

    The guide is F; its variance, summed over the channels, d² min(Σ_c F_c² / max(Y(F)², 1e-12), 1 / 0.0722²), Y the
    luminance: all channels as noisy as the luminance, in proportion, which is largest for blue. Mean of that over
    7x7 pixels.
    """
    guide, d = np.asarray(first[..., :3], dtype=np.float64), np.asarray(first[..., 3], dtype=np.float64)
    colored = np.minimum((guide**2).sum(axis=-1) / np.maximum(luminance(guide) ** 2, 1e-12), 1.0 / 0.0722**2)
    variance = box_mean(d**2 * colored, 3)
    return first_order_regression(guide, variance[..., None], features, feature_variance, first, **options)[0]


# --- The energy of the outliers ---------------------------------------------------------------------------


def wide_box_mean(image: np.ndarray, radius: int) -> np.ndarray:
    """`box_mean` for windows too wide to be stacked: the mean along the rows of the means along the columns."""
    image = np.asarray(image, dtype=np.float64)
    for axis in (0, 1):
        n = image.shape[axis]
        average = np.zeros((n, n))
        for i in range(n):
            np.add.at(average[i], reflect_index(np.arange(i - radius, i + radius + 1), n), 1.0 / (2 * radius + 1))
        image = np.moveaxis(np.tensordot(average, image, axes=(1, axis)), 0, axis)
    return image


def spread_removed(image: np.ndarray, removed: np.ndarray, radius: int) -> np.ndarray:
    """Give back the light of the outliers over a wide neighbourhood: half as it is, half in proportion to the image.

    R = B³ removed, B the mean over (2r+1)²; one = image + R / 2;
    the result is one · (1 + (mean R / 2) / max(B³ mean one, mean R, 1e-9)).
    """

    def spread(plane: np.ndarray) -> np.ndarray:
        return wide_box_mean(wide_box_mean(wide_box_mean(plane, radius), radius), radius)

    light = spread(removed)
    one = image + light / 2.0
    level = spread(one.mean(axis=-1))
    share = light.mean(axis=-1)
    gain = 1.0 + share / 2.0 / np.maximum(np.maximum(level, share), 1e-9)
    return one * gain[..., None]
