"""The equations of the method `regression` in float64 NumPy: slow, obvious, and sharing nothing with the kernels.

Sources: Rousselle, Knaus, Zwicker, "Adaptive Rendering with Non-Local Means Filtering", 2012; Rousselle, Manzi,
Zwicker, "Robust Denoising using Feature and Color Information", 2013; Bitterli et al., "Nonlinearly Weighted
First-Order Regression for Denoising Monte Carlo Renderings" (NFOR), 2016. Images are (H, W, C), or (H, W) where a
function does not name its channels. Windows and offsets are those of `oracle`: mirrored, edge pixel not repeated.
"""

from __future__ import annotations

import numpy as np
from oracle import auto_exposure, box_mean, neighbours, offsets, pad, reflect_index, shifted

#: Added to the sum of two variances, so that the distance of two noise-free pixels is finite.
VARIANCE_FLOOR = 1e-8

#: On the diagonal of the normal equations, per unit of weight: a term that is constant in the window drops out.
LEAST_RIDGE = 1e-8

# --- Outliers and variances -------------------------------------------------------------------------------


def outliers(color: np.ndarray, limit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Scale each pixel so that its largest channel is at most `limit` times that of its 8 neighbours.

    Returns the scaled image and the factor (H, W): 1 where l <= limit · max(m, 0), else limit · max(m, 0) / l.
    """
    color = np.asarray(color, dtype=np.float64)
    largest = color.max(axis=-1)
    window = neighbours(largest, 1)
    bound = limit * np.maximum(np.delete(window, 4, axis=0).max(axis=0), 0.0)
    over = largest > bound
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


def _channel_mean(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else image.mean(axis=-1)


def variance_distance(color: np.ndarray, variance: np.ndarray, dx: int, dy: int, patch_radius: int) -> np.ndarray:
    """Rousselle et al. (2012), d² between the patches around i and i + (dx, dy) less what noise explains, (H, W).

    Each pixel of a patch adds ((x - y)² - (v + min(v, u))) / (v + u + 1e-8); mean over channels and patch, then
    at least 0. Both images are mirrored before, so a patch over the border reads mirrored pixels.
    """
    margin = patch_radius + max(abs(dx), abs(dy))
    padded, padded_variance = pad(color, margin), pad(variance, margin)
    terms = []
    for px, py in offsets(patch_radius):
        x, y = shifted(padded, margin, px, py), shifted(padded, margin, px + dx, py + dy)
        v, u = shifted(padded_variance, margin, px, py), shifted(padded_variance, margin, px + dx, py + dy)
        terms.append(_channel_mean(((x - y) ** 2 - (v + np.minimum(v, u))) / (v + u + VARIANCE_FLOOR)))
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
    feature: np.ndarray, variance: np.ndarray, search_radius: int = 3, patch_radius: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Non-local means of a feature on its own variance (Rousselle et al. 2013), and the variance that is left.

    v is the 3x3 mean of min(variance, 1); filtered = Σ w f / Σ w, its variance Σ w² v / (Σ w)², f and v those of
    the neighbours.
    """
    feature = np.asarray(feature, dtype=np.float64)
    v = box_mean(np.minimum(variance, 1.0), 1)
    distances = [variance_distance(feature, v, dx, dy, patch_radius) for dx, dy in offsets(search_radius)]
    weights = np.exp(-np.stack(distances))
    if feature.ndim == 3:
        weights = weights[..., None]
    z = weights.sum(axis=0)
    filtered = (weights * neighbours(feature, search_radius)).sum(axis=0) / z
    return filtered, (weights**2 * neighbours(v, search_radius)).sum(axis=0) / z**2


# --- Regression -------------------------------------------------------------------------------------------


def first_order_regression(
    color_guide: np.ndarray,
    guide_variance: np.ndarray,
    features: np.ndarray | None,
    feature_variance: np.ndarray | None,
    color: np.ndarray,
    *,
    search_radius: int,
    patch_radius: int,
    k: float,
    ridge: float,
    noise_ridge: float,
    position_ridge: float,
) -> np.ndarray:
    """NFOR (Bitterli et al. 2016): fit `color` over the window, linear in features and position, read it at i.

    Weights exp(-d / k²), d the `variance_distance` of the guide, mean over patch_radius and patch_radius // 2;
    terms (1, f_j - f_i, dx / S, dy / S). `features`
    and `feature_variance` are (H, W, F), F any number; None is none. Ridges on the diagonal of M = Σ w t tᵀ, then
    M z = e0 and the result is zᵀ Σ w t colorᵀ.
    """
    color = np.asarray(color, dtype=np.float64)
    height, width, channels = color.shape
    features = np.zeros((height, width, 0)) if features is None else np.asarray(features, dtype=np.float64)
    if feature_variance is None:
        feature_variance = np.zeros(features.shape)
    count = features.shape[-1]
    size = 1 + count + 2
    span = max(search_radius, 1)
    padded_features, padded_color = pad(features, search_radius), pad(color, search_radius)

    m = np.zeros((height, width, size, size))
    r = np.zeros((height, width, size, channels))
    for dx, dy in offsets(search_radius):
        w = np.mean(
            [
                np.exp(-variance_distance(color_guide, guide_variance, dx, dy, radius) / k**2)
                for radius in (patch_radius, patch_radius // 2)
            ],
            axis=0,
        )
        t = np.empty((height, width, size))
        t[..., 0] = 1.0
        t[..., 1 : 1 + count] = shifted(padded_features, search_radius, dx, dy) - features
        t[..., -2] = dx / span
        t[..., -1] = dy / span
        m += w[..., None, None] * t[..., :, None] * t[..., None, :]
        r += w[..., None, None] * t[..., :, None] * shifted(padded_color, search_radius, dx, dy)[..., None, :]

    total = m[..., 0, 0].copy()
    for q in range(1, size):
        own = noise_ridge * feature_variance[..., q - 1] if q <= count else position_ridge
        m[..., q, q] += ridge * m[..., q, q] + total * (own + LEAST_RIDGE)
    first = np.zeros((height, width, size, 1))
    first[..., 0, 0] = 1.0
    z = np.linalg.solve(m, first)
    # A fit may overshoot below 0, where light cannot be; only a pixel that is negative itself may stay so.
    return np.maximum((z * r).sum(axis=-2), np.minimum(color, 0.0))


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


# --- The whole method -------------------------------------------------------------------------------------


def denoise_regression(
    color: np.ndarray,
    *,
    search_radius: int,
    patch_radius: int,
    k: float,
    ridge: float,
    noise_ridge: float,
    position_ridge: float,
    albedo: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    depth: np.ndarray | None = None,
    color_variance: np.ndarray | None = None,
    albedo_variance: np.ndarray | None = None,
    normal_variance: np.ndarray | None = None,
    depth_variance: np.ndarray | None = None,
    color_a: np.ndarray | None = None,
    color_b: np.ndarray | None = None,
    outlier_limit: float | None = 1.0,
    spread_radius: int = 50,
    exposure: float | None = None,
) -> np.ndarray:
    """Expose, hold back outliers, prefilter the features, `first_order_regression`, give the light back.

    After NFOR (Bitterli et al. 2016), one pass. The color variance is the one given, else from the two halves,
    else from the image itself. `outlier_limit` None leaves the outliers in. All planes finite.
    """
    color = np.asarray(color, dtype=np.float64)
    height, width = color.shape[:2]
    e = auto_exposure(color) if exposure is None else exposure
    c = e * color
    if color_variance is not None:
        variance = e**2 * np.asarray(color_variance, dtype=np.float64)
    elif color_a is not None and color_b is not None:
        variance = variance_from_halves(
            e * np.asarray(color_a, dtype=np.float64), e * np.asarray(color_b, dtype=np.float64)
        )
    else:
        variance = variance_from_image(c)
    kept = c
    if outlier_limit is not None:
        kept, factor = outliers(c, outlier_limit)
        variance = variance * factor[..., None] ** 2
    variance = box_mean(variance, 2)

    groups = []
    if albedo is not None:
        groups.append((np.clip(np.asarray(albedo, dtype=np.float64), 0.0, 1.0), albedo_variance))
    if normal is not None:
        groups.append((np.asarray(normal, dtype=np.float64), normal_variance))
    if depth is not None:
        d, v = depth_feature(depth, np.zeros((height, width)) if depth_variance is None else depth_variance)
        groups.append((d[..., None], None if depth_variance is None else v[..., None]))
    features, feature_variance = [np.zeros((height, width, 0))], [np.zeros((height, width, 0))]
    for plane, noise in groups:
        plane, left = (plane, np.zeros(plane.shape)) if noise is None else prefilter(plane, noise)
        features.append(plane)
        feature_variance.append(left)

    out = first_order_regression(
        kept,
        variance,
        np.concatenate(features, axis=-1),
        np.concatenate(feature_variance, axis=-1),
        kept,
        search_radius=search_radius,
        patch_radius=patch_radius,
        k=k,
        ridge=ridge,
        noise_ridge=noise_ridge,
        position_ridge=position_ridge,
    )
    if outlier_limit is not None:
        out = spread_removed(out, c - kept, spread_radius)
    return out / e
