"""The paper's equations in float64 NumPy: slow, obvious, and sharing nothing with the kernels.

Equation numbers are those of Yang, Chen, Hu, Yu, "Denoising Algorithm Based on Multi-feature Non-local Mean
Filtering for Monte Carlo Rendered Images", Journal of System Simulation 34(6), 2022. Images are (H, W) or
(H, W, C). Every window is mirrored at the border without repeating the edge pixel, also where it is wider than
the image. An offset (dx, dy) leads from pixel i = (y, x) to pixel j = (y + dy, x + dx).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

#: h² never falls below this, so that a noise-free frame (h = 0) gives 0 / MIN_H_SQUARED and not 0 / 0.
MIN_H_SQUARED = 1e-12

#: Of a pixel itself where its weight is the largest of the others: a pixel that nothing resembles stays.
LEAST_WEIGHT = 1e-4

# --- Borders and windows ----------------------------------------------------------------------------------


def reflect_index(i: np.ndarray | int, n: int) -> np.ndarray:
    """Mirror any index into [0, n) without repeating the edge: period 2(n - 1); always 0 for n = 1."""
    i = np.asarray(i)
    if n == 1:
        return np.zeros_like(i)
    period = 2 * (n - 1)
    i = i % period
    return np.where(i < n, i, period - i)


def pad(image: np.ndarray, radius: int) -> np.ndarray:
    """Add `radius` mirrored pixels on every side, in float64."""
    image = np.asarray(image, dtype=np.float64)
    height, width = image.shape[:2]
    rows = reflect_index(np.arange(-radius, height + radius), height)
    columns = reflect_index(np.arange(-radius, width + radius), width)
    return image[rows][:, columns]


def offsets(radius: int) -> Iterator[tuple[int, int]]:
    """All (dx, dy) of a (2r+1)² window, row by row."""
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            yield dx, dy


def shifted(padded: np.ndarray, margin: int, dx: int, dy: int) -> np.ndarray:
    """The image whose pixel i holds pixel i + (dx, dy); `padded` carries `margin` pixels on every side."""
    height, width = padded.shape[0] - 2 * margin, padded.shape[1] - 2 * margin
    return padded[margin + dy : margin + dy + height, margin + dx : margin + dx + width]


def neighbours(image: np.ndarray, radius: int) -> np.ndarray:
    """All pixels of every window, ((2r+1)², H, W[, C])."""
    padded = pad(image, radius)
    return np.stack([shifted(padded, radius, dx, dy) for dx, dy in offsets(radius)])


def box_mean(image: np.ndarray, radius: int) -> np.ndarray:
    """Mean over the (2r+1)² window, as the bars of eqs. 1-3."""
    return neighbours(image, radius).mean(axis=0)


def gaussian_taps(sigma: float, radius: int) -> np.ndarray:
    """Gaussian sampled at -radius..radius, normalised to sum 1."""
    i = np.arange(-radius, radius + 1)
    taps = np.exp(-(i**2) / (2.0 * sigma**2))
    return taps / taps.sum()


def gaussian_blur(image: np.ndarray, sigma: float) -> np.ndarray:
    """Separable Gaussian of radius ceil(3 sigma): along x, then along y."""
    radius = int(np.ceil(3.0 * sigma))
    taps = list(zip(range(-radius, radius + 1), gaussian_taps(sigma, radius), strict=True))
    padded = pad(image, radius)
    along_x = sum(tap * shifted(padded, radius, k, 0) for k, tap in taps)
    padded = pad(along_x, radius)
    return sum(tap * shifted(padded, radius, 0, k) for k, tap in taps)


# --- Colour -----------------------------------------------------------------------------------------------


def luminance(rgb: np.ndarray) -> np.ndarray:
    """Rec. 709 luminance of linear RGB, (H, W)."""
    rgb = np.asarray(rgb, dtype=np.float64)
    return 0.2126 * rgb[..., 0] + 0.7152 * rgb[..., 1] + 0.0722 * rgb[..., 2]


def srgb_encode(x: np.ndarray) -> np.ndarray:
    """The sRGB curve (IEC 61966-2-1) on values clipped to [0, 1]."""
    x = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1.0 / 2.4) - 0.055)


def auto_exposure(color: np.ndarray, key: float = 0.18) -> float:
    """key / log-average luminance over the finite pixels that are not black; 1 if there are none.

    Bins are of 8 octaves, from 2^-127 on. A pixel is black at zero, below it, and more than three bins below the
    lowest of the brightest hundredth of the others, which are sixteen at least.
    """
    with np.errstate(invalid="ignore"):
        lum = luminance(color)
    positive = lum[np.isfinite(lum) & (lum > 0.0)]
    if not positive.size:
        return 1.0
    bins = np.floor((np.log2(positive) + 127) / 8)
    brightest = np.sort(bins)[::-1]
    rank = max(positive.size // 100, 15)
    if rank < positive.size:
        positive = positive[bins >= brightest[rank] - 3]
    return float(key / np.exp(np.mean(np.log(positive))))


def tonemap(color: np.ndarray, exposure: float, curve: str = "clip") -> np.ndarray:
    """The domain of colour distances: f(exposure · c)^(1/2.2), f(x) = clip(x, 0, 1), or x / (1 + x) from x = 0 up."""
    light = np.maximum(np.asarray(color, dtype=np.float64) * exposure, 0.0)
    return (np.minimum(light, 1.0) if curve == "clip" else light / (1.0 + light)) ** (1.0 / 2.2)


def tonemap_inverse(t: np.ndarray, exposure: float, curve: str = "clip") -> np.ndarray:
    """Back to linear light; what `tonemap` clipped stays clipped."""
    tone = np.clip(np.asarray(t, dtype=np.float64), 0.0, 1.0) ** 2.2
    return (tone if curve == "clip" else tone / np.maximum(1.0 - tone, 1e-6)) / exposure


def compress(color: np.ndarray, exposure: float) -> np.ndarray:
    """x / (1 + |x|) of x = exposure · c."""
    light = np.asarray(color, dtype=np.float64) * exposure
    return light / (1.0 + np.abs(light))


def expand(compressed: np.ndarray, exposure: float) -> np.ndarray:
    """The inverse of `compress`."""
    compressed = np.asarray(compressed, dtype=np.float64)
    return compressed / np.maximum(1.0 - np.abs(compressed), 1e-6) / exposure


def averaged(color: np.ndarray, t: np.ndarray, exposure: float, curve: str, average: str, mean) -> np.ndarray:
    """`mean` taken in the domain that `average` names: linear, compressed or tonemapped."""
    if average == "tonemapped":
        return tonemap_inverse(mean(t), exposure, curve)
    if average == "compressed":
        return expand(mean(compress(color, exposure)), exposure)
    return mean(color)


def normal_to_unit(normal: np.ndarray) -> np.ndarray:
    """(n + 1) / 2: each component from [-1, 1] to [0, 1]."""
    return (np.asarray(normal, dtype=np.float64) + 1.0) / 2.0


def fill_nonfinite(plane: np.ndarray) -> tuple[np.ndarray, int]:
    """Replace pixels with any non-finite channel; return the filled plane and how many there were.

    The replacement is the mean of the good pixels in the first window of radius 1, 2, ..., 8, cut at the image
    border, that holds any; 0 if none does. Replaced pixels never serve as good ones.
    """
    plane = np.asarray(plane, dtype=np.float64)
    finite = np.isfinite(plane)
    good = finite if plane.ndim == 2 else finite.all(axis=-1)
    filled = plane.copy()
    for y, x in np.argwhere(~good):
        filled[y, x] = 0.0
        for radius in range(1, 9):
            window = np.s_[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1]
            if good[window].any():
                filled[y, x] = plane[window][good[window]].mean(axis=0)
                break
    return filled, int((~good).sum())


# --- Stage 1: gradient image of the albedo (section 2.2) ---------------------------------------------------


def sobel(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Un-normalised 3x3 Sobel gradients gx, gy: [-1 0 1] along one axis, [1 2 1] along the other."""
    padded = pad(image, 1)
    gx, gy = np.zeros(np.shape(image)), np.zeros(np.shape(image))
    for k, weight in ((-1, 1.0), (0, 2.0), (1, 1.0)):
        gx += weight * (shifted(padded, 1, 1, k) - shifted(padded, 1, -1, k))
        gy += weight * (shifted(padded, 1, k, 1) - shifted(padded, 1, k, -1))
    return gx, gy


def non_maximum_suppression(gx: np.ndarray, gy: np.ndarray) -> np.ndarray:
    """Ridge pixels of the gradient magnitude, bool: OpenCV's rule of four sectors.

    The left (upper) neighbour must be smaller, the right (lower) one may be equal, so that a ridge two pixels
    wide leaves one; on the diagonals both must be smaller. Outside the image the magnitude is 0.
    """
    gx, gy = np.asarray(gx, dtype=np.float64), np.asarray(gy, dtype=np.float64)
    height, width = gx.shape
    m2 = np.pad(gx**2 + gy**2, 1)
    tan = np.tan(np.deg2rad(22.5))
    keep = np.zeros((height, width), dtype=bool)
    for y in range(height):
        for x in range(width):
            ax, ay = abs(gx[y, x]), abs(gy[y, x])
            centre = m2[y + 1, x + 1]
            if ay < tan * ax:
                keep[y, x] = centre > m2[y + 1, x] and centre >= m2[y + 1, x + 2]
            elif ay > (tan + 2.0) * ax:
                keep[y, x] = centre > m2[y, x + 1] and centre >= m2[y + 2, x + 1]
            else:
                s = -1 if gx[y, x] * gy[y, x] < 0.0 else 1
                keep[y, x] = centre > m2[y, x + 1 - s] and centre > m2[y + 2, x + 1 + s]
    return keep


def hysteresis(candidates: np.ndarray, strong: np.ndarray) -> np.ndarray:
    """The candidates that a path of candidates (8 neighbours) joins to a strong candidate; 0 or 1."""
    candidates = np.asarray(candidates, dtype=bool)
    edges = candidates & np.asarray(strong, dtype=bool)
    while True:
        padded = np.pad(edges, 1)
        grown = candidates & np.any([shifted(padded, 1, dx, dy) for dx, dy in offsets(1)], axis=0)
        if (grown == edges).all():
            return edges.astype(np.float64)
        edges = grown


def canny(image: np.ndarray, low: float, high: float, sigma: float | None = 1.4) -> np.ndarray:
    """Canny edges of one channel, 0 or 1: blur, Sobel, suppression, double threshold with hysteresis.

    Thresholds are in units of the un-normalised Sobel magnitude; both comparisons are strict. `sigma` None or 0
    leaves the blur out.
    """
    gx, gy = sobel(gaussian_blur(image, sigma) if sigma else image)
    m2 = gx**2 + gy**2
    candidates = non_maximum_suppression(gx, gy) & (m2 > low**2)
    return hysteresis(candidates, candidates & (m2 > high**2))


def median_thresholds(image: np.ndarray) -> tuple[float, float]:
    """(low, high) = (0.67, 1.33) · median, the median being the centre of its bin among 256 over [0, 1]."""
    v = np.clip(np.asarray(image, dtype=np.float64), 0.0, 1.0).ravel()
    bins = np.minimum(np.floor(v * 256.0), 255.0).astype(int)
    histogram = np.bincount(bins, minlength=256)
    median_bin = int(np.argmax(2 * np.cumsum(histogram) >= v.size))
    median = (median_bin + 0.5) / 256.0
    return 0.67 * median, 1.33 * median


def albedo_guide(albedo: np.ndarray, low: float, high: float, sigma: float | None = 1.4) -> np.ndarray:
    """The guide I: Canny edges of the sRGB-encoded albedo luminance, (H, W), 0 or 1."""
    return canny(srgb_encode(luminance(albedo)), low, high, sigma)


# --- Stage 2: guided prefilter of the normals (eqs. 1-3) ---------------------------------------------------


def guided_filter(guide: np.ndarray, image: np.ndarray, radius: int, eps: float) -> np.ndarray:
    """Eqs. 1-3: guide I of one channel, image F of any number of channels, each filtered alone."""
    image = np.asarray(image, dtype=np.float64)
    if image.ndim == 3:
        channels = [guided_filter(guide, image[..., c], radius, eps) for c in range(image.shape[2])]
        return np.stack(channels, axis=-1)
    guide_window, image_window = neighbours(guide, radius), neighbours(image, radius)
    guide_mean, image_mean = guide_window.mean(axis=0), image_window.mean(axis=0)
    variance = ((guide_window - guide_mean) ** 2).mean(axis=0)
    covariance = ((guide_window - guide_mean) * (image_window - image_mean)).mean(axis=0)
    a = covariance / (variance + eps)
    b = image_mean - a * guide_mean
    return box_mean(a, radius) * guide + box_mean(b, radius)


# --- Stage 3: structural similarity of patches (eq. 7) ----------------------------------------------------


def patch_ssim(m: np.ndarray, dx: int, dy: int, patch_radius: int, c1: float, c2: float) -> np.ndarray:
    """Eq. 7 between the patches around i and i + (dx, dy): mean over channels, clamped to [1e-6, 1].

    Luminance, contrast and structure as Wang et al. (2004) define them, C3 = C2 / 2, every pixel of a patch
    with the same weight, variances divided by the number of pixels.
    """
    margin = patch_radius + max(abs(dx), abs(dy))
    padded = pad(m, margin)
    x = np.stack([shifted(padded, margin, px, py) for px, py in offsets(patch_radius)])
    y = np.stack([shifted(padded, margin, px + dx, py + dy) for px, py in offsets(patch_radius)])
    mean_x, mean_y = x.mean(axis=0), y.mean(axis=0)
    variance_x, variance_y = ((x - mean_x) ** 2).mean(axis=0), ((y - mean_y) ** 2).mean(axis=0)
    covariance = ((x - mean_x) * (y - mean_y)).mean(axis=0)
    sigma_x, sigma_y = np.sqrt(variance_x), np.sqrt(variance_y)
    c3 = c2 / 2.0
    luminance_term = (2.0 * mean_x * mean_y + c1) / (mean_x**2 + mean_y**2 + c1)
    contrast_term = (2.0 * sigma_x * sigma_y + c2) / (variance_x + variance_y + c2)
    structure_term = (covariance + c3) / (sigma_x * sigma_y + c3)
    return np.clip(_channel_mean(luminance_term * contrast_term * structure_term), 1e-6, 1.0)


def _channel_mean(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else image.mean(axis=-1)


# --- Stage 4: colour distance (eq. 6) ---------------------------------------------------------------------


def noise_level(tonemapped: np.ndarray) -> float:
    """Immerkaer (1996): noise sigma from the Laplacian difference mask, root mean square over channels."""
    tonemapped = np.asarray(tonemapped, dtype=np.float64)
    padded = pad(tonemapped, 1)
    row = {-1: 1.0, 0: -2.0, 1: 1.0}
    response = sum(row[dx] * row[dy] * shifted(padded, 1, dx, dy) for dx, dy in offsets(1))
    sigma = np.sqrt(np.pi / 2.0) / 6.0 * np.abs(response).mean(axis=(0, 1))
    return float(np.sqrt(np.mean(sigma**2)))


def patch_weights(patch_radius: int, sigma: float) -> np.ndarray:
    """The Gaussian of eq. 6 over a patch, normalised to sum 1."""
    taps = gaussian_taps(sigma, patch_radius)
    return np.outer(taps, taps)


def patch_distance(t: np.ndarray, dx: int, dy: int, patch_radius: int, patch_sigma: float) -> np.ndarray:
    """Eq. 6, d(i, i + (dx, dy)): Gaussian-weighted mean squared difference of the patches, mean over channels."""
    margin = patch_radius + max(abs(dx), abs(dy))
    padded = pad(t, margin)
    weights = patch_weights(patch_radius, patch_sigma)
    distance = np.zeros(np.shape(t)[:2])
    for px, py in offsets(patch_radius):
        difference = shifted(padded, margin, px, py) - shifted(padded, margin, px + dx, py + dy)
        distance += weights[py + patch_radius, px + patch_radius] * _channel_mean(difference**2)
    return distance


# --- Stages 5 and 6: weights and reconstruction (eqs. 4, 5, 8) --------------------------------------------


def nlm_weights(t: np.ndarray, *, search_radius: int, patch_radius: int, patch_sigma: float, h: float) -> np.ndarray:
    """Eq. 5 before the division by Z: exp(-d / h²), ((2s+1)², H, W) in the order of `offsets(search_radius)`."""
    h_squared = max(h**2, MIN_H_SQUARED)
    distances = [patch_distance(t, dx, dy, patch_radius, patch_sigma) for dx, dy in offsets(search_radius)]
    return np.exp(-np.stack(distances) / h_squared)


def ssim_nlm_weights(
    t: np.ndarray,
    m: np.ndarray,
    *,
    search_radius: int,
    patch_radius: int,
    patch_sigma: float,
    h: float,
    c1: float,
    c2: float,
    stabiliser: float,
) -> np.ndarray:
    """Eq. 8 before the division by Z: exp(-(stabiliser + ln(1 / SSIM)) · d / h²); stabiliser 0 as printed."""
    h_squared = max(h**2, MIN_H_SQUARED)
    weights = []
    for dx, dy in offsets(search_radius):
        d = patch_distance(t, dx, dy, patch_radius, patch_sigma)
        ssim = patch_ssim(m, dx, dy, patch_radius, c1, c2)
        weights.append(np.exp(-(stabiliser + np.log(1.0 / ssim)) * d / h_squared))
    return np.stack(weights)


def weighted_mean(color: np.ndarray, weights: np.ndarray, search_radius: int, center: str = "one") -> np.ndarray:
    """Eq. 4: f(i) = sum_j w(i, j) c(j) / Z(i), Z the sum of the weights.

    With center "largest", w(i, i) is the largest of the other weights (Buades et al. 2005), and at least
    LEAST_WEIGHT, instead of 1.
    """
    if center == "largest":
        weights = weights.copy()
        middle = len(weights) // 2
        others = np.delete(weights, middle, axis=0)
        weights[middle] = np.maximum(others.max(axis=0, initial=0.0), LEAST_WEIGHT)
    candidates = neighbours(color, search_radius)
    z = weights.sum(axis=0)
    if candidates.ndim == 4:
        weights, z = weights[..., None], z[..., None]
    return (weights * candidates).sum(axis=0) / z


def nlm(
    color: np.ndarray,
    t: np.ndarray,
    *,
    search_radius: int,
    patch_radius: int,
    patch_sigma: float,
    h: float,
    center: str = "one",
) -> np.ndarray:
    """Eqs. 4-6: non-local means of `color`, with distances taken on `t`."""
    weights = nlm_weights(t, search_radius=search_radius, patch_radius=patch_radius, patch_sigma=patch_sigma, h=h)
    return weighted_mean(color, weights, search_radius, center)


def ssim_nlm(
    color: np.ndarray,
    t: np.ndarray,
    m: np.ndarray,
    *,
    search_radius: int,
    patch_radius: int,
    patch_sigma: float,
    h: float,
    c1: float,
    c2: float,
    stabiliser: float,
    center: str = "one",
) -> np.ndarray:
    """Eqs. 4 and 6-8: non-local means of `color`, distances on `t`, similarity of the normals `m` in [0, 1]."""
    weights = ssim_nlm_weights(
        t,
        m,
        search_radius=search_radius,
        patch_radius=patch_radius,
        patch_sigma=patch_sigma,
        h=h,
        c1=c1,
        c2=c2,
        stabiliser=stabiliser,
    )
    return weighted_mean(color, weights, search_radius, center)


# --- Whole methods ----------------------------------------------------------------------------------------


def denoise_nlm(
    color: np.ndarray,
    *,
    patch_sigma: float,
    h_factor: float,
    h: float | None = None,
    search_radius: int = 3,
    patch_radius: int = 2,
    exposure: float | None = None,
    curve: str = "reinhard",
    average: str = "compressed",
    center: str = "one",
) -> np.ndarray:
    """The baseline: fill, expose, tonemap, then `nlm`; h = h_factor · noise level if not given."""
    color, _ = fill_nonfinite(color)
    exposure = auto_exposure(color) if exposure is None else exposure
    t = tonemap(color, exposure, curve)
    windows = {
        "search_radius": search_radius,
        "patch_radius": patch_radius,
        "patch_sigma": patch_sigma,
        "center": center,
    }
    strength = h_factor * noise_level(t) if h is None else h
    return averaged(color, t, exposure, curve, average, lambda c: nlm(c, t, **windows, h=strength))


def denoise_ssim_nlm(
    color: np.ndarray,
    albedo: np.ndarray,
    normal: np.ndarray,
    *,
    patch_sigma: float,
    guided_radius: int,
    guided_epsilon: float,
    stabiliser: float,
    h_factor: float,
    h: float | None = None,
    canny_low: float | None = None,
    canny_high: float | None = None,
    canny_sigma: float | None = 1.4,
    search_radius: int = 3,
    patch_radius: int = 2,
    ssim_c1: float = 0.01**2,
    ssim_c2: float = 0.03**2,
    exposure: float | None = None,
    curve: str = "reinhard",
    average: str = "compressed",
    center: str = "one",
) -> np.ndarray:
    """The paper's method, stages 1 to 6; a Canny threshold not given comes from the median of the grey albedo."""
    color, _ = fill_nonfinite(color)
    albedo, _ = fill_nonfinite(albedo)
    normal, _ = fill_nonfinite(normal)
    exposure = auto_exposure(color) if exposure is None else exposure
    t = tonemap(color, exposure, curve)
    low, high = median_thresholds(srgb_encode(luminance(albedo)))
    low, high = low if canny_low is None else canny_low, high if canny_high is None else canny_high
    guide = albedo_guide(albedo, low, high, canny_sigma)
    m = normal_to_unit(guided_filter(guide, normal, guided_radius, guided_epsilon))
    options = {"search_radius": search_radius, "patch_radius": patch_radius, "patch_sigma": patch_sigma}
    options |= {"center": center, "c1": ssim_c1, "c2": ssim_c2, "stabiliser": stabiliser}
    strength = h_factor * noise_level(t) if h is None else h
    return averaged(color, t, exposure, curve, average, lambda c: ssim_nlm(c, t, m, **options, h=strength))
