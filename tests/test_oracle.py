"""Checks the oracle itself against OpenCV, scikit-image, SciPy, or loops over pixels written another way."""

from __future__ import annotations

import cv2
import numpy as np
import oracle
import pytest
import scipy.ndimage
import scipy.stats
from inputs import KINDS, SIZES, features, images, planes
from scipy.signal.windows import gaussian as gaussian_window
from skimage.color import rgb2xyz
from skimage.metrics import structural_similarity
from skimage.restoration import denoise_nl_means

SOME_IMAGES = [planes(kind, 13, 17, seed=1) for kind in KINDS]


def reflect(image: np.ndarray, margin: int) -> np.ndarray:
    return np.pad(image, [(margin, margin)] * 2 + [(0, 0)] * (image.ndim - 2), mode="reflect")


def crop(image: np.ndarray, margin: int) -> np.ndarray:
    return image[margin : image.shape[0] - margin, margin : image.shape[1] - margin]


def assert_close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Agreement within `tolerance` of the largest expected value (or of 1, if that is smaller)."""
    assert actual.shape == expected.shape
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * max(1.0, np.abs(expected).max()))


# --- Inputs -----------------------------------------------------------------------------------------------


def test_inputs_are_float32_deterministic_and_of_the_kinds_they_name():
    for channels in (None, 1, 3):
        named = dict(images(channels))
        assert len(named) == len(KINDS) * len(SIZES)
        for name, image in named.items():
            size = "x".join(str(n) for n in image.shape[:2])
            assert name.endswith("-" + size)
            assert image.shape[2:] == (() if channels is None else (channels,))
            assert image.dtype == np.float32 and image.flags.c_contiguous and np.isfinite(image).all()
    assert np.array_equal(planes("hdr", 13, 17, 3), planes("hdr", 13, 17, 3))
    assert not np.array_equal(planes("hdr", 13, 17, 3), planes("hdr", 13, 17, 3, seed=1))
    assert planes("hdr", 31, 64).max() > 100.0
    assert np.ptp(planes("constant", 31, 64)) == 0.0
    assert len(np.unique(planes("step", 31, 64))) == 2


@pytest.mark.parametrize("size", SIZES)
def test_scene_features_are_physical(size):
    for noise in (0.0, 1.0):
        scene = features(*size, noise=noise)
        assert all(plane.dtype == np.float32 and plane.shape[:2] == size for plane in scene.values())
        assert scene["albedo"].min() >= 0.0 and scene["albedo"].max() <= 1.0
        np.testing.assert_allclose(np.linalg.norm(scene["normal"], axis=-1), 1.0, atol=1e-6)
        assert scene["depth"].min() > 0.0 and scene["color"].min() >= 0.0


# --- Borders and windows ----------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_reflect_index_is_that_of_numpy_and_opencv(n):
    for radius in range(4 * n + 3):
        expected = np.pad(np.arange(n), radius, mode="reflect")
        assert np.array_equal(oracle.reflect_index(np.arange(-radius, n + radius), n), expected)
    i = np.arange(-50, 50)
    assert oracle.reflect_index(i, n).tolist() == [cv2.borderInterpolate(int(k), n, cv2.BORDER_REFLECT_101) for k in i]


@pytest.mark.parametrize("channels", [None, 3])
@pytest.mark.parametrize("size", SIZES)
def test_pad_is_numpys(size, channels):
    image = planes("uniform", *size, channels)
    for radius in (0, 1, 2, 5, 30):
        assert np.array_equal(oracle.pad(image, radius), reflect(image, radius))
    assert oracle.pad(image, 1).dtype == np.float64


@pytest.mark.parametrize("radius", [0, 1, 3, 10])
@pytest.mark.parametrize("kind", KINDS)
def test_box_mean_is_that_of_scipy_and_opencv(kind, radius):
    side = 2 * radius + 1
    for size in SIZES:
        image = planes(kind, *size, 3).astype(np.float64)
        actual = oracle.box_mean(image, radius)
        assert_close(actual, scipy.ndimage.uniform_filter(image, (side, side, 1), mode="mirror"), 1e-12)
        assert_close(actual, cv2.blur(image, (side, side), borderType=cv2.BORDER_REFLECT_101), 1e-12)
        assert_close(oracle.box_mean(image[..., 0], radius), actual[..., 0], 1e-15)


def test_gaussian_taps_are_scipys():
    for sigma, radius in ((0.5, 2), (1.0, 2), (1.4, 5), (3.0, 4)):
        window = gaussian_window(2 * radius + 1, sigma)
        assert_close(oracle.gaussian_taps(sigma, radius), window / window.sum(), 1e-15)


@pytest.mark.parametrize("sigma", [0.4, 1.0, 1.4, 3.0])
@pytest.mark.parametrize("kind", KINDS)
def test_gaussian_blur_is_that_of_scipy_and_opencv(kind, sigma):
    radius = int(np.ceil(3 * sigma))
    taps = cv2.getGaussianKernel(2 * radius + 1, sigma, cv2.CV_64F)
    for size in SIZES:
        image = planes(kind, *size).astype(np.float64)
        actual = oracle.gaussian_blur(image, sigma)
        assert_close(actual, scipy.ndimage.gaussian_filter(image, sigma, mode="mirror", radius=radius), 1e-12)
        expected = cv2.sepFilter2D(image, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_REFLECT_101)
        assert_close(actual, expected.reshape(size), 1e-12)


# --- Colour -----------------------------------------------------------------------------------------------


def test_luminance_and_srgb_curve_invert_skimages_conversion_to_xyz():
    rgb = planes("uniform", 13, 17, 3).astype(np.float64)
    rgb[0] *= 0.003  # the linear part of the curve
    # Y of XYZ is the luminance of the linearised colour; skimage's weights carry six digits.
    assert_close(oracle.luminance(rgb), rgb2xyz(oracle.srgb_encode(rgb))[..., 1], 1e-4)
    assert oracle.srgb_encode(np.array([-1.0, 0.0, 0.003, 1.0, 7.0])) == pytest.approx([0, 0, 0.03876, 1, 1])
    assert oracle.srgb_encode(np.array([0.004, 0.5])) == pytest.approx([0.050709, 0.735357], abs=1e-6)
    assert oracle.luminance(np.eye(3)) == pytest.approx([0.2126, 0.7152, 0.0722])


def test_auto_exposure_puts_the_geometric_mean_at_the_key():
    color = planes("hdr", 13, 17, 3).astype(np.float64)
    color[0, 1] = 1e-6
    color[2, 3] = 0.0
    color[4, 5] = -1.0
    color[6, 7] = np.inf
    color[8, 9, 1] = np.nan
    lum = color @ np.array([0.2126, 0.7152, 0.0722])
    usable = [value for value in lum.ravel() if np.isfinite(value) and value > 0]
    assert len(usable) == lum.size - 4
    assert oracle.auto_exposure(color) == pytest.approx(0.18 / scipy.stats.gmean(usable))
    assert oracle.auto_exposure(color, key=0.5) == pytest.approx(0.5 / scipy.stats.gmean(usable))
    assert oracle.auto_exposure(np.zeros((3, 2, 3))) == 1.0


def test_auto_exposure_takes_a_tiny_background_for_black():
    """24 octaves below the brightest still count, 33 do not; a few bright pixels make nothing black."""
    color = np.full((20, 30, 3), 1.5)
    for octaves, is_black in ((24, False), (33, True), (90, True)):
        color[:10] = 1.5 * 2.0**-octaves
        expected = 0.18 / 1.5 * (1.0 if is_black else 2.0 ** (octaves / 2))
        assert oracle.auto_exposure(color) == pytest.approx(expected)
    color[:] = 1e-12
    color[0, :15] = 1.0
    assert oracle.auto_exposure(color) == pytest.approx(0.18 / 1e-12 ** (585 / 600))
    color[0, 15] = 1.0
    assert oracle.auto_exposure(color) == pytest.approx(0.18)


def test_tonemap_clips_and_inverts():
    assert oracle.tonemap(np.array([-1.0, 0.0, 0.25, 0.5, 3.0]), 2.0) == pytest.approx([0, 0, 0.5 ** (1 / 2.2), 1, 1])
    color = planes("uniform", 3, 2, 3)
    assert_close(oracle.tonemap_inverse(oracle.tonemap(color, 0.7), 0.7), color.astype(np.float64), 1e-14)


def test_normal_to_unit():
    assert oracle.normal_to_unit(np.array([-1.0, 0.0, 0.5, 1.0])).tolist() == [0.0, 0.5, 0.75, 1.0]


@pytest.mark.parametrize("share", [0.0, 0.05, 0.6, 0.97, 1.0])
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (13, 17), (31, 64)])
def test_fill_nonfinite_is_that_of_a_distance_transform(size, share):
    rng = np.random.default_rng(5)
    plane = planes("hdr", *size, 3).astype(np.float64)
    bad = rng.random(size) < share
    bad[: size[0] // 2, : size[1] // 2] |= share > 0.5  # a hole that radius 8 cannot bridge in the largest size
    channel = rng.integers(3, size=size)
    plane[bad, channel[bad]] = rng.choice([np.nan, np.inf, -np.inf], bad.sum())
    filled, count = oracle.fill_nonfinite(plane)

    known = np.where(bad[..., None], 0.0, plane)
    expected = known.copy()
    distance = scipy.ndimage.distance_transform_cdt(bad, metric="chessboard")
    if bad.all():
        distance[:] = 99
    for radius in range(1, 9):
        ones = np.ones((2 * radius + 1,) * 2)
        here = distance == radius
        number = scipy.ndimage.correlate((~bad).astype(float), ones, mode="constant")
        total = np.stack([scipy.ndimage.correlate(known[..., c], ones, mode="constant") for c in range(3)], -1)
        expected[here] = total[here] / number[here][:, None]
    assert count == bad.sum()
    assert_close(filled, expected, 1e-14)
    scalar, scalar_count = oracle.fill_nonfinite(np.where(bad, np.nan, plane[..., 0]))
    assert scalar_count == count
    assert_close(scalar, expected[..., 0], 1e-14)
    if size == (31, 64) and share == 0.97:
        assert (filled == 0.0).any(), "no pixel is out of reach of radius 8"


# --- Canny ------------------------------------------------------------------------------------------------


def eight_bit_images():
    """8-bit images of many sizes: noise, few grey levels (ties), black and white, tiles, ramps, discs."""
    rng = np.random.default_rng(3)
    sizes = [*SIZES, (2, 2), (1, 2), (5, 5), (32, 33), (23, 40)]
    for height, width in sizes:
        y, x = np.mgrid[:height, :width]
        yield rng.integers(0, 256, (height, width))
        yield rng.integers(0, 4, (height, width))
        yield rng.integers(0, 2, (height, width)) * 255
        yield (x * 3 + y * 7) // 20 % 2 * 200
        yield np.minimum(x * 5 + y * 2, 255)
        yield np.where((x - width // 2) ** 2 + (y - height // 2) ** 2 < 30, 220, 30)


def cv2_sobel(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    image = image.astype(np.uint8)
    gradients = [cv2.Sobel(image, cv2.CV_16S, *order, borderType=cv2.BORDER_REFLECT_101) for order in ((1, 0), (0, 1))]
    return gradients[0].reshape(image.shape), gradients[1].reshape(image.shape)


def cv2_canny(gx: np.ndarray, gy: np.ndarray, low: float, high: float) -> np.ndarray:
    """The overload that takes gradients; the one that takes an image replicates the border for its Sobel."""
    edges = cv2.Canny(gx.astype(np.int16), gy.astype(np.int16), low, high, L2gradient=True)
    return edges.reshape(gx.shape) / 255.0


def test_sobel_is_opencvs():
    for image in eight_bit_images():
        for actual, expected in zip(oracle.sobel(image), cv2_sobel(image), strict=True):
            assert np.array_equal(actual, expected)


def test_canny_is_opencvs_exactly():
    edges = 0
    for image in eight_bit_images():
        gx, gy = cv2_sobel(image)
        for low, high in ((0, 0), (1, 3), (35.5, 71.25), (40, 100), (200, 201), (150, 600), (2000, 3000)):
            expected = cv2_canny(gx, gy, low, high)
            assert np.array_equal(oracle.canny(image, low, high, sigma=None), expected), (image.shape, low, high)
            edges += expected.sum()
    assert edges > 10_000


def test_canny_thresholds_are_strict():
    step = np.where(np.arange(9) < 4, 0, 25) * np.ones((7, 1))  # the Sobel magnitude is 100
    gx, gy = cv2_sobel(step)
    for low, high, count in ((50, 99, 7), (50, 100, 0), (99, 99, 7), (100, 100, 0)):
        edges = oracle.canny(step, low, high, sigma=None)
        assert edges.sum() == count
        assert np.array_equal(edges, cv2_canny(gx, gy, low, high))
    weak = step.copy()
    weak[3:, 4:] = 15  # magnitude 60: kept where it hangs on the strong part, unless low is as large
    assert oracle.canny(weak, 59, 99, sigma=None)[6].sum() == 1
    assert oracle.canny(weak, 60, 99, sigma=None)[6].sum() == 0


def test_canny_is_opencvs_on_an_image_that_opencv_splits_among_threads():
    rng = np.random.default_rng(8)
    image = cv2.GaussianBlur(rng.integers(0, 256, (260, 90)).astype(np.uint8), (0, 0), 1.5)
    expected = cv2_canny(*cv2_sobel(image), 60, 140)
    assert 0.02 < expected.mean() < 0.5
    assert np.array_equal(oracle.canny(image, 60, 140, sigma=0), expected)


@pytest.mark.parametrize("limit", [1, 3, 30, 1020])
def test_non_maximum_suppression_is_opencvs_for_any_gradients(limit):
    """Gradients of no image: every sector, sign and tie. With both thresholds 0 only the suppression is left."""
    rng = np.random.default_rng(limit)
    for size in ((1, 1), (1, 9), (7, 1), (2, 2), (40, 41)):
        gx, gy = rng.integers(-limit, limit + 1, (2, *size))
        assert np.array_equal(oracle.non_maximum_suppression(gx, gy), cv2_canny(gx, gy, 0, 0) > 0)


def test_opencvs_integer_sectors_are_exact_for_eight_bit_images():
    """OpenCV rounds tan(22.5°) to 13573 / 2^15. No 8-bit Sobel gradient (at most 1020) tells the two apart;
    the first pair of integers that does is (1393, 577), and there the oracle keeps the exact angle."""
    ax, ay = np.meshgrid(np.arange(1021), np.arange(1021))
    tan = np.tan(np.deg2rad(22.5))
    assert np.array_equal(ay < tan * ax, ay * 2**15 < ax * 13573)
    assert np.array_equal(ay > (tan + 2) * ax, ay * 2**15 > ax * (13573 + 2**16))

    gx, gy = np.full((3, 3), 1), np.zeros((3, 3), int)
    gx[1, 1], gy[1, 1] = 1393, 577
    gx[2, 2] = 3000  # the rival on the diagonal
    assert cv2_canny(gx, gy, 0, 0)[1, 1] == 1.0
    assert not oracle.non_maximum_suppression(gx, gy)[1, 1]


def test_hysteresis_keeps_the_labelled_components_that_hold_a_strong_pixel():
    rng = np.random.default_rng(4)
    for size in SIZES:
        for share in (0.2, 0.4, 0.7):
            candidates = rng.random(size) < share
            strong = candidates & (rng.random(size) < 0.05)
            labels, _ = scipy.ndimage.label(candidates, structure=np.ones((3, 3)))
            expected = candidates & np.isin(labels, labels[strong])
            assert np.array_equal(oracle.hysteresis(candidates, strong), expected.astype(np.float64))


def test_hysteresis_follows_a_path_to_its_end():
    """A serpentine through the whole image, strong at one end only: the farthest an edge can be carried."""
    candidates = np.zeros((31, 64), dtype=bool)
    candidates[::2] = True
    candidates[1::4, -1] = candidates[3::4, 0] = True
    strong = np.zeros_like(candidates)
    strong[0, 0] = True
    assert np.array_equal(oracle.hysteresis(candidates, strong), candidates)
    assert not oracle.hysteresis(candidates, ~candidates).any()


def test_canny_blurs_first_and_scales_with_its_thresholds():
    image = planes("uniform", 31, 64).astype(np.float64)
    edges = oracle.canny(image, 0.3, 0.5)
    assert 0.01 < edges.mean() < 0.5
    blurred = scipy.ndimage.gaussian_filter(image, 1.4, mode="mirror", radius=5)
    assert np.array_equal(edges, oracle.canny(blurred, 0.3, 0.5, sigma=None))
    assert np.array_equal(edges, oracle.canny(256 * image, 256 * 0.3, 256 * 0.5))
    assert not oracle.canny(planes("constant", 31, 64), 0.0, 0.0).any()


def test_albedo_guide_finds_a_step_in_the_encoded_luminance():
    albedo = np.where(np.arange(40)[None, :, None] < 20, 0.02, 0.06) * np.ones((30, 40, 3))
    step = float(oracle.srgb_encode(np.array(0.06)) - oracle.srgb_encode(np.array(0.02)))
    # At a step between two pixels the blurred slope is the middle tap of the Gaussian and its neighbour, times 4.
    taps = oracle.gaussian_taps(1.4, 5)
    magnitude = 4 * step * (taps[5] + taps[6])
    guide = oracle.albedo_guide(albedo, 0.5 * magnitude, 0.999 * magnitude, 1.4)
    expected = np.zeros((30, 40))
    expected[:, 19] = 1.0  # both sides of the step are equal: the left one stays
    assert np.array_equal(guide, expected)
    assert not oracle.albedo_guide(albedo, 0.5 * magnitude, 1.001 * magnitude, 1.4).any()
    # Equal luminance, different hue: no edge.
    albedo[:, :20] = (0.7152 * 0.5, 0.1, 0.3)
    albedo[:, 20:] = (0.0, 0.1 + 0.2126 * 0.5, 0.3)
    assert not oracle.albedo_guide(albedo, 1e-6, 1e-6, 1.4).any()


@pytest.mark.parametrize("size", SIZES)
def test_median_thresholds_take_the_bin_of_the_lower_median(size):
    for kind in KINDS:
        image = planes(kind, *size, seed=2)
        lower_median = np.clip(np.sort(image, axis=None)[(image.size - 1) // 2], 0, 1)
        centre = (min(int(lower_median * 256), 255) + 0.5) / 256
        assert oracle.median_thresholds(image) == pytest.approx((0.67 * centre, 1.33 * centre), rel=1e-14)
    assert oracle.median_thresholds(np.full((3, 2), 7.0)) == pytest.approx((0.67 * 255.5 / 256, 1.33 * 255.5 / 256))
    assert oracle.median_thresholds(np.array([[0.0, 1.0]])) == pytest.approx((0.67 * 0.5 / 256, 1.33 * 0.5 / 256))


# --- Guided filter ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [1, 2, 5])
@pytest.mark.parametrize("eps", [1e-4, 1e-2, 1.0])
def test_guided_filter_is_opencvs(radius, eps):
    """OpenCV repeats the edge pixel (BORDER_REFLECT), so it gets an image mirrored beforehand by 2r, as far as
    two box filters reach. Its eps is ours: an addend to the variance in squared image units. It works in float32
    with E[x²] - E[x]², whose rounding a small eps magnifies: hence the tolerance, and the second comparison."""
    rng = np.random.default_rng(6)
    margin = 2 * radius

    def mean(plane: np.ndarray) -> np.ndarray:
        return scipy.ndimage.uniform_filter(plane.astype(np.float64), 2 * radius + 1, mode="mirror")

    for size in SIZES:
        guides = [(rng.random(size) < 0.2).astype(np.float32), planes("uniform", *size), planes("textured", *size)]
        for guide in guides:
            image = features(*size)["normal"]
            expected = cv2.ximgproc.guidedFilter(reflect(guide, margin), reflect(image, margin), radius, eps)
            assert_close(oracle.guided_filter(guide, image, radius, eps), crop(expected, margin), 5e-4)
            i, f = guide.astype(np.float64), image[..., 1].astype(np.float64)
            a = (mean(i * f) - mean(i) * mean(f)) / (mean(i * i) - mean(i) ** 2 + eps)
            expected = mean(a) * i + mean(mean(f) - a * mean(i))
            assert_close(oracle.guided_filter(guide, image[..., 1], radius, eps), expected, 1e-10)


def test_guided_filter_without_a_guide_blurs_twice_and_with_itself_keeps_strong_edges():
    image = planes("uniform", 13, 17, 3).astype(np.float64)
    twice = oracle.box_mean(oracle.box_mean(image, 2), 2)
    assert_close(oracle.guided_filter(np.zeros((13, 17)), image, 2, 1e-3), twice, 1e-14)
    step = planes("step", 13, 17).astype(np.float64)
    assert_close(oracle.guided_filter(step, step, 2, 1e-12), step, 1e-9)


def test_guided_filter_stands_a_large_constant():
    """Subtract first: an image that sits at 10^6 is filtered as well as the same image at 0."""
    guide, image = planes("uniform", 13, 17).astype(np.float64), planes("textured", 13, 17).astype(np.float64)
    expected = oracle.guided_filter(guide, image, 2, 1e-3)
    assert_close(oracle.guided_filter(guide + 1e6, image + 1e6, 2, 1e-3) - 1e6, expected, 1e-7)


# --- Similarity and distance of patches -------------------------------------------------------------------


@pytest.mark.parametrize("k1, k2", [(0.01, 0.03), (0.2, 0.1)])
@pytest.mark.parametrize("patch_radius", [1, 2])
def test_patch_ssim_is_skimages(patch_radius, k1, k2):
    """skimage merges contrast and structure, which C3 = C2 / 2 allows, and mirrors with the edge pixel repeated;
    both patches are read from an image mirrored beforehand, so the border pixels are compared too."""
    side = 2 * patch_radius + 1
    low, high = 1.0, 0.0
    for image in (*SOME_IMAGES, planes("uniform", 3, 2), planes("uniform", 1, 9), planes("uniform", 7, 1)):
        m = np.clip(image.astype(np.float64), 0.0, 1.0)
        for dx, dy in ((0, 0), (1, 0), (0, -1), (-3, 2), (2, 3)):
            margin = patch_radius + 3
            padded = reflect(m, margin)
            here, there = crop(padded, 3), crop(np.roll(padded, (-dy, -dx), (0, 1)), 3)
            _, full = structural_similarity(
                here, there, win_size=side, data_range=1.0, K1=k1, K2=k2, use_sample_covariance=False, full=True
            )
            actual = oracle.patch_ssim(m, dx, dy, patch_radius, k1**2, k2**2)
            assert_close(actual, np.clip(crop(full, patch_radius), 1e-6, 1.0), 1e-9)
            low, high = min(low, actual.min()), max(high, actual.max())
    assert low == 1e-6 and high == 1.0, "the clamp was never reached"


def test_patch_ssim_averages_the_channels_before_it_clamps():
    m = planes("uniform", 13, 17, 3).astype(np.float64)
    m[..., 1] = m[..., 0] * 0.3 + 0.2
    margin = 2 + 4
    padded = reflect(m, margin)
    here, there = crop(padded, 4), crop(np.roll(padded, (1, -4), (0, 1)), 4)
    maps = []
    for c in range(3):
        options = {"win_size": 5, "data_range": 1.0, "use_sample_covariance": False, "full": True}
        maps.append(crop(structural_similarity(here[..., c], there[..., c], **options)[1], 2))
    assert min(channel.min() for channel in maps) < -0.1
    expected = np.clip(np.mean(maps, axis=0), 1e-6, 1.0)
    assert_close(oracle.patch_ssim(m, 4, -1, 2, 0.01**2, 0.03**2), expected, 1e-9)


def test_patch_weights_are_a_normalised_gaussian():
    window = np.outer(gaussian_window(5, 1.3), gaussian_window(5, 1.3))
    assert_close(oracle.patch_weights(2, 1.3), window / window.sum(), 1e-15)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 2), (13, 17)])
def test_patch_distance_is_a_correlation_of_the_squared_difference(size):
    t = planes("uniform", *size, 3).astype(np.float64)
    margin = 2 + 3
    padded = reflect(t, margin)
    for dx, dy in ((0, 0), (3, 0), (-1, 2), (-3, -3)):
        square = ((padded - np.roll(padded, (-dy, -dx), (0, 1))) ** 2).mean(axis=-1)
        expected = crop(scipy.ndimage.correlate(square, oracle.patch_weights(2, 1.1)), margin)
        assert_close(oracle.patch_distance(t, dx, dy, 2, 1.1), expected, 1e-14)
        assert_close(
            oracle.patch_distance(t[..., 0], dx, dy, 2, 1.1),
            oracle.patch_distance(t[..., :1], dx, dy, 2, 1.1),
            1e-15,
        )


# --- Noise level ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
def test_noise_level_is_a_convolution_with_immerkaers_mask(size):
    image = planes("hdr", *size, 3).astype(np.float64)
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    sigmas = []
    for c in range(3):
        response = scipy.ndimage.convolve(image[..., c], mask, mode="mirror")
        sigmas.append(np.sqrt(np.pi / 2) * np.abs(response).sum() / (6 * response.size))
        assert oracle.noise_level(image[..., c]) == pytest.approx(sigmas[c], rel=1e-12, abs=1e-12)
    assert oracle.noise_level(image) == pytest.approx(np.sqrt(np.mean(np.square(sigmas))), rel=1e-12, abs=1e-12)


def test_noise_level_recovers_gaussian_noise():
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:128, :128]
    ramp = 0.3 + 0.002 * x + 0.001 * y
    for sigma in (0.01, 0.05, 0.2):
        noisy = ramp[..., None] + sigma * rng.standard_normal((128, 128, 3))
        assert oracle.noise_level(noisy) == pytest.approx(sigma, rel=0.03)
        # Donoho's estimate: the median absolute diagonal Haar coefficient.
        haar = (noisy[::2, ::2] - noisy[::2, 1::2] - noisy[1::2, ::2] + noisy[1::2, 1::2]) / 2
        donoho = scipy.stats.median_abs_deviation(haar, axis=None, scale="normal")
        assert oracle.noise_level(noisy) == pytest.approx(donoho, rel=0.05)
    uneven = ramp[..., None] + np.array([0.02, 0.05, 0.1]) * rng.standard_normal((128, 128, 3))
    assert oracle.noise_level(uneven) == pytest.approx(np.sqrt((0.02**2 + 0.05**2 + 0.1**2) / 3), rel=0.03)
    # The mask ignores slopes, except where the mirrored border breaks them.
    assert oracle.noise_level(ramp) < 1e-3


# --- Non-local means --------------------------------------------------------------------------------------


def schraudolph_exp(y: np.ndarray) -> np.ndarray:
    """Schraudolph's exponential, the approximation (within some per cent) that skimage's non-local means uses."""
    high_word = np.trunc(1048576 / np.log(2) * y).astype(np.int64) + (1072693248 - 60801)
    return (high_word << 32).view(np.float64)


@pytest.mark.parametrize("channels", [None, 3])
@pytest.mark.parametrize("patch_radius", [1, 2])
def test_nlm_is_skimages(patch_radius, channels):
    """skimage's slow mode: patch sigma = patch radius / 2, distances averaged over channels and divided by h², the
    centre with weight 1. It leaves out candidates beyond the border, so it gets an image mirrored beforehand; it
    drops weights below exp(-5), so h is large; and its exp is an approximation, put in our place here."""
    image = planes("uniform", 13, 17, channels).astype(np.float64)
    search_radius, h = 3, 0.7
    margin = search_radius + patch_radius
    expected = denoise_nl_means(
        reflect(image, margin),
        patch_size=2 * patch_radius + 1,
        patch_distance=search_radius,
        h=h,
        fast_mode=False,
        channel_axis=None if channels is None else -1,
    )
    options = {
        "search_radius": search_radius,
        "patch_radius": patch_radius,
        "patch_sigma": patch_radius / 2,
        "h": h,
    }
    weights = oracle.nlm_weights(image, **options)
    assert weights.min() > np.exp(-5.0) and (weights[weights.shape[0] // 2] == 1.0).all()
    approximated = oracle.weighted_mean(image, schraudolph_exp(np.log(weights)), search_radius)
    assert_close(approximated, crop(expected, margin), 1e-9)
    assert_close(oracle.nlm(image, image, **options), oracle.weighted_mean(image, weights, search_radius), 1e-15)
    assert_close(oracle.nlm(image, image, **options), crop(expected, margin), 1e-2)


@pytest.mark.parametrize("shape", [(3, 2), (7, 1), (20, 24), (20, 24, 3)])
def test_nlm_is_opencvs_to_its_rounding(shape):
    """OpenCV's is 8-bit, with equal patch weights and candidates mirrored as ours are; it drops weights below
    0.001 and rounds the result to whole grey levels."""
    rng = np.random.default_rng(9)
    image = rng.normal(128.0, 12.0, shape)
    image[:, shape[1] // 2 :] /= 2.0
    image = np.clip(image, 0, 255).astype(np.uint8)
    for h in (8.0, 20.0, 40.0):
        expected = cv2.fastNlMeansDenoising(image, [h], None, 5, 7, cv2.NORM_L2).reshape(shape)
        actual = oracle.nlm(image, image, search_radius=3, patch_radius=2, patch_sigma=1e6, h=h)
        np.testing.assert_allclose(actual, expected, rtol=0, atol=0.6)


def brute_force(color, t, m, *, search_radius, patch_radius, patch_sigma, h, c1=0.0, c2=0.0, stabiliser=None):
    """Eqs. 4-8, one pixel and one candidate at a time; `stabiliser` None is eq. 5."""
    margin = search_radius + patch_radius
    color, t, m = (reflect(plane, margin) for plane in (color, t, m))
    side = 2 * patch_radius + 1
    kernel = np.outer(gaussian_window(side, patch_sigma), gaussian_window(side, patch_sigma))[..., None]
    out = np.zeros_like(crop(color, margin))
    for y in range(margin, color.shape[0] - margin):
        for x in range(margin, color.shape[1] - margin):
            total, z = 0.0, 0.0
            here = np.s_[y - patch_radius : y + patch_radius + 1, x - patch_radius : x + patch_radius + 1]
            for v in range(y - search_radius, y + search_radius + 1):
                for u in range(x - search_radius, x + search_radius + 1):
                    there = np.s_[v - patch_radius : v + patch_radius + 1, u - patch_radius : u + patch_radius + 1]
                    exponent = np.average((t[here] - t[there]) ** 2, weights=kernel + 0 * t[here]) / h**2
                    if stabiliser is not None:
                        ssim = 0.0
                        for c in range(m.shape[2]):
                            p, q = m[here][..., c].ravel(), m[there][..., c].ravel()
                            (vp, cov), (_, vq) = np.cov(p, q, bias=True)
                            means = (2 * p.mean() * q.mean() + c1) / (p.mean() ** 2 + q.mean() ** 2 + c1)
                            ssim += means * (2 * cov + c2) / (vp + vq + c2) / m.shape[2]
                        exponent *= stabiliser - np.log(np.clip(ssim, 1e-6, 1.0))
                    total, z = total + np.exp(-exponent) * color[v, u], z + np.exp(-exponent)
            out[y - margin, x - margin] = total / z
    return out


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (1, 9), (8, 11)])
@pytest.mark.parametrize("stabiliser", [None, 0.0, 0.1])
def test_nlm_and_ssim_nlm_are_the_brute_force_loop(size, stabiliser):
    color = planes("hdr", *size, 3).astype(np.float64)
    t = planes("uniform", *size, 3).astype(np.float64)
    m = oracle.normal_to_unit(features(*size)["normal"])
    options = {"search_radius": 2, "patch_radius": 1, "patch_sigma": 0.8, "h": 0.25}
    if stabiliser is None:
        actual = oracle.nlm(color, t, **options)
    else:
        options |= {"c1": 0.01**2, "c2": 0.03**2, "stabiliser": stabiliser}
        actual = oracle.ssim_nlm(color, t, m, **options)
    assert_close(actual, brute_force(color, t, m, **options), 1e-11)


def test_limits_of_the_weights():
    color = planes("hdr", 13, 17, 3).astype(np.float64)
    t = oracle.tonemap(color, 0.5)
    options = {"search_radius": 2, "patch_radius": 1, "patch_sigma": 1.0}
    assert_close(oracle.nlm(color, t, h=1e9, **options), oracle.box_mean(color, 2), 1e-12)
    assert_close(oracle.nlm(color, t, h=0.0, **options), color, 1e-12)
    flat = planes("constant", 13, 17, 3).astype(np.float64)
    assert_close(oracle.nlm(color, flat, h=0.0, **options), oracle.box_mean(color, 2), 1e-12)

    # On equal normals SSIM is 1: eq. 8 as printed is a box blur whatever h is, and stabilised it is eq. 5.
    options |= {"c1": 0.01**2, "c2": 0.03**2, "h": 0.1}
    assert_close(oracle.ssim_nlm(color, t, flat, stabiliser=0.0, **options), oracle.box_mean(color, 2), 1e-9)
    same = oracle.nlm(color, t, search_radius=2, patch_radius=1, patch_sigma=1.0, h=0.1 / np.sqrt(0.25))
    assert_close(oracle.ssim_nlm(color, t, flat, stabiliser=0.25, **options), same, 1e-9)


#: The domains that the outside implementations below are given: clipped tones for distances, light for averages.
PLAIN = {"curve": "clip", "average": "linear"}


# --- Whole methods ----------------------------------------------------------------------------------------


def test_denoise_ssim_nlm_is_the_chain_of_outside_implementations():
    size = (9, 12)
    scene = {name: plane.astype(np.float64) for name, plane in features(*size).items()}
    color, albedo, normal = scene["color"].copy(), scene["albedo"].copy(), scene["normal"].copy()
    color[4, 5, 1], albedo[2, 3, 0], normal[3, 7, 0] = np.nan, np.inf, -np.inf
    actual = oracle.denoise_ssim_nlm(
        color,
        albedo,
        normal,
        patch_sigma=1.5,
        guided_radius=2,
        guided_epsilon=0.01,
        stabiliser=0.1,
        h_factor=0.8,
        canny_low=0.2,
        canny_high=0.4,
        search_radius=2,
        patch_radius=1,
        **PLAIN,
    )
    for plane, y, x in ((color, 4, 5), (albedo, 2, 3), (normal, 3, 7)):
        plane[y, x] = np.nan
        plane[y, x] = np.nanmean(plane[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2], axis=(0, 1))
    lum = color @ np.array([0.2126, 0.7152, 0.0722])
    t = np.clip(0.18 / scipy.stats.gmean(lum, axis=None) * color, 0, 1) ** (1 / 2.2)
    mask = np.array([1, -2, 1])
    response = cv2.sepFilter2D(t, cv2.CV_64F, mask, mask, borderType=cv2.BORDER_REFLECT_101)
    h = 0.8 * np.sqrt(np.pi / 2) / 6 * np.sqrt((np.abs(response).mean(axis=(0, 1)) ** 2).mean())
    guide = oracle.albedo_guide(albedo, 0.2, 0.4, 1.4)
    assert 0.02 < guide.mean() < 0.5
    guided = cv2.ximgproc.guidedFilter(*(reflect(p, 4).astype(np.float32) for p in (guide, normal)), 2, 0.01)
    m = (crop(guided, 4).astype(np.float64) + 1) / 2
    options = {"search_radius": 2, "patch_radius": 1, "patch_sigma": 1.5, "h": h}
    expected = brute_force(color, t, m, c1=0.01**2, c2=0.03**2, stabiliser=0.1, **options)
    assert_close(actual, expected, 1e-4)
    assert np.abs(expected - color).max() > 0.01

    # The baseline shares the frame, the exposure and the noise level.
    color[4, 5, 0] = np.nan
    actual = oracle.denoise_nlm(color, patch_sigma=1.5, h_factor=0.8, search_radius=2, patch_radius=1, **PLAIN)
    color[4, 5] = np.nan
    color[4, 5] = np.nanmean(color[3:6, 4:7], axis=(0, 1))
    assert_close(actual, brute_force(color, t, m, **options), 1e-11)


def test_denoise_takes_given_exposure_h_and_median_thresholds():
    scene = features(31, 64)
    inputs = scene["color"], scene["albedo"], scene["normal"]
    fixed = {
        "patch_sigma": 1.0,
        "guided_radius": 2,
        "guided_epsilon": 0.01,
        "stabiliser": 0.1,
        "h_factor": 1.0,
        **PLAIN,
    }
    t = oracle.tonemap(scene["color"], 0.7)
    low, high = oracle.median_thresholds(oracle.srgb_encode(oracle.luminance(scene["albedo"])))
    guide = oracle.albedo_guide(scene["albedo"], low, high)
    assert guide.any()
    m = oracle.normal_to_unit(oracle.guided_filter(guide, scene["normal"], 2, 0.01))
    options = {"search_radius": 3, "patch_radius": 2, "patch_sigma": 1.0, "h": 0.05}
    expected = oracle.ssim_nlm(scene["color"], t, m, c1=1e-4, c2=9e-4, stabiliser=0.1, **options)
    assert_close(oracle.denoise_ssim_nlm(*inputs, exposure=0.7, h=0.05, **fixed), expected, 1e-14)
    no_guide = oracle.denoise_ssim_nlm(*inputs, exposure=0.7, h=0.05, canny_low=99.0, canny_high=99.0, **fixed)
    assert np.abs(no_guide - expected).max() > 1e-6
    actual = oracle.denoise_nlm(scene["color"], patch_sigma=1.0, h_factor=1.0, exposure=0.7, h=0.05, **PLAIN)
    assert_close(actual, oracle.nlm(scene["color"], t, **options), 1e-14)


def test_denoising_brings_the_scene_closer_to_the_truth_at_any_exposure():
    noisy, clean = features(31, 64), features(31, 64, noise=0.0)["color"]
    nlm = oracle.denoise_nlm(noisy["color"], patch_sigma=1.0, h_factor=1.0)
    ssim_nlm = oracle.denoise_ssim_nlm(
        noisy["color"],
        noisy["albedo"],
        noisy["normal"],
        patch_sigma=1.0,
        guided_radius=2,
        guided_epsilon=0.01,
        stabiliser=1.0,
        h_factor=1.0,
    )

    def error(image: np.ndarray) -> float:
        return float(np.mean((oracle.tonemap(image, 1.0) - oracle.tonemap(clean, 1.0)) ** 2))

    assert error(nlm) < 0.7 * error(noisy["color"])
    assert error(ssim_nlm) < 0.7 * error(noisy["color"])
    assert_close(oracle.denoise_nlm(64.0 * noisy["color"], patch_sigma=1.0, h_factor=1.0) / 64.0, nlm, 1e-12)


def test_constant_frame_comes_back_unchanged():
    color, normal = planes("constant", 7, 5, 3), np.full((7, 5, 3), (0.0, 0.0, 1.0))
    assert_close(oracle.denoise_nlm(color, patch_sigma=1.0, h_factor=1.0), color.astype(np.float64), 1e-14)
    actual = oracle.denoise_ssim_nlm(
        color, color, normal, patch_sigma=1.0, guided_radius=2, guided_epsilon=0.01, stabiliser=0.1, h_factor=1.0
    )
    assert_close(actual, color.astype(np.float64), 1e-14)
