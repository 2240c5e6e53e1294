"""The equations of the method `regression` in float64 NumPy: slow, obvious, and sharing nothing with the kernels.

Sources: Rousselle, Knaus, Zwicker, "Adaptive Rendering with Non-Local Means Filtering", 2012; Rousselle, Manzi,
Zwicker, "Robust Denoising using Feature and Color Information", 2013; Bitterli et al., "Nonlinearly Weighted
First-Order Regression for Denoising Monte Carlo Renderings" (NFOR), 2016. Images are (H, W, C), or (H, W) where a
function does not name its channels. Windows and offsets are those of `oracle`: mirrored, edge pixel not repeated.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from oracle import box_mean, luminance, neighbours, offsets, pad, reflect_index, shifted
from oracle_terms import Terms, terms_of_blocks

#: Added to the sum of two variances, so that the distance of two noise-free pixels is finite.
VARIANCE_FLOOR = 1e-12

# --- Outliers and variances -------------------------------------------------------------------------------


def outliers(
    color: np.ndarray,
    limit: float = 1.0,
    variance: np.ndarray | None = None,
    significant: float = np.inf,
    by_chance: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Scale each pixel so that its largest channel is at most `limit` times that of its 8 neighbours.

    Returns the scaled image and the factor (H, W): 1 where l <= limit · m, m the brightest neighbour or 0, or where
    (l - m) / significant is more than the pixel's standard deviation; else limit · m / l. Its variance is v, the sum of
    the channels', or, by chance and if larger, l² + 1e-6 times the mean of v / (l² + 1e-6) over 3x3 pixels.

    Of a group, with a finite `significant`: limit · o / l if that is less and l > 16 limit · o, o the fourth largest of
    the other 24 of 5x5 pixels or 0, and l - o is at most min(1.5, significant) deviations.
    """
    color = np.asarray(color, dtype=np.float64)
    largest = color.max(axis=-1)
    around = np.maximum(np.delete(neighbours(largest, 1), 4, axis=0).max(axis=0), 0.0)
    v = np.zeros(largest.shape) if variance is None else np.float64(variance).sum(axis=-1)
    square = largest**2 + 1e-6
    deviation = np.sqrt(np.maximum(np.maximum(v, by_chance * square * box_mean(v / square, 1)), 0.0))
    over = (largest > limit * around) & ((largest - around) / significant <= deviation)
    factor = np.where(over, limit * around / np.where(over, largest, 1.0), 1.0)
    if np.isfinite(significant):
        others = np.maximum(np.sort(np.delete(neighbours(largest, 2), 12, axis=0), axis=0)[-4], 0.0)
        over = (largest > 16.0 * limit * others) & (largest - others <= min(1.5, significant) * deviation)
        factor = np.where(over, np.minimum(factor, limit * others / np.where(over, largest, 1.0)), factor)
    return factor[..., None] * color, factor


def significance(names: Iterable[str]) -> float:
    """`significant` of `outliers` for a frame with these planes: how much a light stands out of what surrounds it."""
    return 3.0 if "color_variance" in names or "color_a" in names else np.inf


def by_chance(names: Iterable[str]) -> bool:
    """`by_chance` of `outliers` for a frame with these planes: samples tell a variance better than halves do."""
    return "color_variance" not in names


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

    Each pixel of a patch adds (Σ_c (x - y)² - (V + min(V, U))) / (V + U + 1e-12), V and U the variances summed over
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
    """d = z / (z + s) - 1/2, s the geometric mean of the depths above 0; the variance times the squared derivative."""
    depth, variance = np.asarray(depth, dtype=np.float64), np.asarray(variance, dtype=np.float64)
    positive = depth[np.isfinite(depth) & (depth > 0.0)]
    scale = float(np.exp(np.log(positive).mean())) if positive.size else 1.0
    z = np.where(depth > 0.0, depth, 0.0)
    return z / (z + scale) - 0.5, variance * (scale / (z + scale) ** 2) ** 2


def prefilter(
    feature: np.ndarray, variance: np.ndarray, search_radius: int = 2, patch_radius: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Non-local means of a feature on its own variance (Rousselle et al. 2013), and the variance that is left.

    v is the 3x3 mean of min(variance, 1); filtered = Σ w f / Σ w, its variance Σ w² v / (Σ w)², f and v those of
    the neighbours at (dx, dy), dx² + dy² <= search_radius².
    """
    feature = np.asarray(feature, dtype=np.float64)
    v = box_mean(np.minimum(variance, 1.0), 1)
    padded, padded_v = pad(feature, search_radius), pad(v, search_radius)
    total = np.zeros((*feature.shape[:2], *[1] * (feature.ndim - 2)))
    filtered, left = np.zeros(feature.shape), np.zeros(feature.shape)
    for dx, dy in offsets(search_radius):
        if dx**2 + dy**2 > search_radius**2:
            continue
        w = np.maximum(0.0, 1.0 - variance_distance(feature, v, dx, dy, patch_radius) / 4.0) ** 4
        w = w.reshape(total.shape)
        total += w
        filtered += w * shifted(padded, search_radius, dx, dy)
        left += w**2 * shifted(padded_v, search_radius, dx, dy)
    return filtered / total, left / total**2


# --- Regression -------------------------------------------------------------------------------------------


def regression_weight(
    guide: np.ndarray, variance: np.ndarray, dx: int, dy: int, *, patch_radius: int, k: float
) -> np.ndarray:
    """w = mean of max(0, 1 - d / (4 k²))⁴ over two `variance_distance` d: of patch_radius and of its half, (H, W).

    Near exp(-d / k²) (Rousselle et al. 2012) where d is small, and 0 from d = 4 k² on.
    """
    distances = [variance_distance(guide, variance, dx, dy, radius) for radius in (patch_radius, patch_radius // 2)]
    return np.mean([np.maximum(0.0, 1.0 - d / (4.0 * k**2)) ** 4 for d in distances], axis=0)


def disc(radius: int) -> list[tuple[int, int]]:
    """The (dx, dy) of `offsets` with dx² + dy² <= r (r + 1): a circle half a pixel wider than its radius."""
    return [(dx, dy) for dx, dy in offsets(radius) if dx**2 + dy**2 <= radius * (radius + 1)]


def penalty(
    m: np.ndarray, terms: Terms, at: np.ndarray, noise: np.ndarray, ridge: float, noise_ridge: float
) -> np.ndarray:
    """What is added to the components' block of M, (H, W, F, F); `at` their values at the pixel, W = M_00.

    Σ_q v_kq v_lq (ridge S_q + W noise_ridge n_q), S_q = max(0, Σ_kl v_kq v_lq M_kl) what the components hold of feature
    q's own second moment; and on the diagonal W (5e-5 (λ_k + t_k²) + 1e-9).
    """
    v, weight = terms.direction, m[..., :1, 0]
    own = np.maximum(np.einsum("...kq,...kl,...lq->...q", v, m[..., 1:-2, 1:-2], v), 0.0)
    damped = np.einsum("...kq,...q,...lq->...kl", v, ridge * own + noise_ridge * weight * noise, v)
    least = weight * (5e-5 * (terms.variance + at**2) + 1e-9)
    return damped + least[..., None] * np.eye(least.shape[-1])


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
    terms_reach: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """NFOR (Bitterli et al. 2016): fit `color` over the window, linear in features and position, read it at i.

    M = Σ w t tᵀ, R = Σ w t colorᵀ over the offsets (dx, dy) · stride of the `disc` of radius S, w the
    `regression_weight` of the guide; terms t = (1, v_k · (f_j - f_i), dx / S, dy / S), v_k the components that the
    block uses for a reach of `terms_reach`, by default the window's. To M are added `penalty` and, for the
    positions, ridge M_aa + M_00 (position_ridge + 1e-9); the first row of M⁻¹ R is the fit at the pixel.
    Returns that fit, and the inner one: of the disc of radius S // 2 alone, in the same terms.
    `features` and `feature_variance` are (H, W, F), F any number; None is none. `color` has 3 columns or 4, the
    fourth a half difference: of either sign, where a colour may only be negative if the pixel itself is.
    """
    color = np.asarray(color, dtype=np.float64)
    height, width, columns = color.shape
    features = np.zeros((height, width, 0)) if features is None else np.asarray(features, dtype=np.float64)
    if feature_variance is None:
        feature_variance = np.zeros(features.shape)
    reach, span = search_radius * stride, max(search_radius, 1)
    terms = terms_of_blocks(features, feature_variance, reach if terms_reach is None else terms_reach)
    padded_features, padded_color = pad(features, reach), pad(color, reach)

    size = 1 + features.shape[-1] + 2
    m, inner_m = np.zeros((2, height, width, size, size))
    r, inner_r = np.zeros((2, height, width, size, columns))
    for dx, dy in disc(search_radius):
        j = dx * stride, dy * stride
        w = regression_weight(color_guide, guide_variance, *j, patch_radius=patch_radius, k=k)[..., None, None]
        t = np.ones((height, width, size))
        # A term that is 0 over the window has the coefficient 0: the fit without it.
        change = shifted(padded_features, reach, *j) - features
        t[..., 1:-2] = np.einsum("...kq,...q->...k", terms.direction, change)
        t[..., -2:] = dx / span, dy / span
        square = w * t[..., :, None] * t[..., None, :]
        product = w * t[..., :, None] * shifted(padded_color, reach, *j)[..., None, :]
        m, r = m + square, r + product
        if (dx, dy) in disc(search_radius // 2):
            inner_m, inner_r = inner_m + square, inner_r + product

    at = np.einsum("...kq,...q->...k", terms.direction, features - terms.mean)
    fits = []
    for moments, products in ((m, r), (inner_m, inner_r)):
        more = np.zeros(moments.shape)
        more[..., 1:-2, 1:-2] = penalty(moments, terms, at, feature_variance, ridge, noise_ridge)
        for a in (-2, -1):
            more[..., a, a] = ridge * moments[..., a, a] + moments[..., 0, 0] * (position_ridge + 1e-9)
        fits.append(np.linalg.solve(moments + more, products)[..., 0, :])
    for fit in fits:
        # A fit may overshoot below 0, where light cannot be; only a pixel that is negative itself may stay so.
        fit[..., :3] = np.maximum(fit[..., :3], np.minimum(color[..., :3], 0.0))
    return tuple(fits)


def second_pass(
    first: np.ndarray,
    features: np.ndarray | None,
    feature_variance: np.ndarray | None,
    frame: np.ndarray | None = None,
    **options,
) -> np.ndarray:
    """`first_order_regression`, with these options, of what one gave: `first`, colour F and half difference d.

    The guide is F; its variance, summed over the channels, d² min(Σ_c F_c² / max(Y(F)², 1e-12), 1 / 0.0722²), Y the
    luminance: all channels as noisy as the luminance, in proportion, which is largest for blue. Mean of that over
    7x7 pixels. Of another `frame`, three colours, that is filtered so, the guide is itself and its variance that of F.
    """
    guide, d = np.asarray(first[..., :3], dtype=np.float64), np.asarray(first[..., 3], dtype=np.float64)
    colored = np.minimum((guide**2).sum(axis=-1) / np.maximum(luminance(guide) ** 2, 1e-12), 1.0 / 0.0722**2)
    variance = box_mean(d**2 * colored, 3)
    frame = first if frame is None else frame
    return first_order_regression(frame[..., :3], variance[..., None], features, feature_variance, frame, **options)[0]


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


def block_mean(image: np.ndarray, side: int) -> np.ndarray:
    """Means of the blocks of `side`² pixels, of those there are at the right and the bottom edge."""
    height, width = image.shape[:2]
    rows, columns = range(0, height, side), range(0, width, side)
    return np.array([[image[y : y + side, x : x + side].mean(axis=(0, 1)) for x in columns] for y in rows])


def between_blocks(blocks: np.ndarray, height: int, width: int, side: int) -> np.ndarray:
    """Linear between the centres of blocks, constant beyond the outermost; the centres are those of whole blocks."""
    for axis, n in ((0, height), (1, width)):
        count = blocks.shape[axis]
        at = np.clip((np.arange(n) + 0.5) / side - 0.5, 0.0, count - 1.0)
        low = np.minimum(np.floor(at).astype(int), max(count - 2, 0))
        part = (at - low).reshape(-1, *[1] * (blocks.ndim - 1))
        along = np.moveaxis(blocks, axis, 0)
        blocks = np.moveaxis((1.0 - part) * along[low] + part * along[np.minimum(low + 1, count - 1)], 0, axis)
    return blocks


def left_in_place(n: int, box: int) -> np.ndarray:
    """What the cube of a mean over `box` of n mirrored values leaves of each in its place, nearly.

    Σ_k s(2 k (n - 1) / box) + s((2 k (n - 1) - 2 i) / box), over box, for i = 0 .. n - 1, over all whole k, without the
    second s at both ends; s the quadratic spline: 3/4 - t² up to |t| = 1/2, (3/2 - |t|)² / 2 up to 3/2, then 0. 1 if n
    is 1.
    """
    if n == 1:
        return np.ones(1)

    def spline(t: np.ndarray) -> np.ndarray:
        t = abs(t)
        return np.where(t < 0.5, 0.75 - t**2, np.maximum(1.5 - t, 0.0) ** 2 / 2.0)

    k, i = np.arange(-2 * box, 2 * box + 1), np.arange(n)[:, None]
    images = np.where((i > 0) & (i < n - 1), spline((2.0 * k * (n - 1) - 2.0 * i) / box), 0.0)
    return (spline(2.0 * k * (n - 1) / box) + images).sum(axis=1) / box


def spread_removed(image: np.ndarray, removed: np.ndarray, radius: int) -> np.ndarray:
    """Give back the light of the outliers over a wide neighbourhood: half as it is, half in proportion to the image.

    From a radius of 32 on, on the means of blocks of side 4, else of side 1: R = B³ r and
    brightness = B³ mean(image + R / 2), B the mean over (2r+1)² blocks, r the radius over the side, rounded; both
    linear between blocks. The result is (image + R / 2) (1 + (mean R / 2) / max(brightness, mean R, 1e-9)).

    r is what was removed, f_3 of it: f_k = min(1, max(0, L_k - f_(k-1) a) / 24 a), a = w mean removed, w the product of
    `left_in_place` down and across, L_k = B³ mean(image + f_(k-1) removed), f_0 = 1: so what a block gives to its own
    place becomes 0.04 of what is there.
    """
    side = 4 if radius >= 32 else 1
    height, width = image.shape[:2]
    r = round(radius / side)

    def spread(blocks: np.ndarray) -> np.ndarray:
        return wide_box_mean(wide_box_mean(wide_box_mean(blocks, r), r), r)

    removed, image_blocks = block_mean(np.float64(removed), side), block_mean(np.float64(image).mean(axis=-1), side)
    down, across = image_blocks.shape
    alone = removed.mean(axis=-1) * np.outer(left_in_place(down, 2 * r + 1), left_in_place(across, 2 * r + 1))
    part = np.ones((down, across))
    for _ in range(3):
        most = np.maximum(spread(image_blocks + part * removed.mean(axis=-1)) - part * alone, 0.0) / 24.0
        part = np.where(alone > most, most / np.where(alone > most, alone, 1.0), 1.0)
    light = spread(part[..., None] * removed)
    level = spread(image_blocks + light.mean(axis=-1) / 2.0)
    light, level = (between_blocks(blocks, height, width, side) for blocks in (light, level))
    share = light.mean(axis=-1)
    gain = 1.0 + share / 2.0 / np.maximum(np.maximum(level, share), 1e-9)
    return (image + light / 2.0) * gain[..., None]
