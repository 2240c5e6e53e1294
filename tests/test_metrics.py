import math
import subprocess
import sys

import numpy as np
import oracle
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from scipy.ndimage import gaussian_filter

from mcdenoise_cl import metrics
from mcdenoise_cl.device import context_for
from mcdenoise_cl.errors import FrameError, McdenoiseError, ParameterError
from mcdenoise_cl.frame import Frame

SHAPE = (24, 31, 3)


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.fixture
def pair(rng):
    """An image and its reference, some values negative and some beyond display white."""
    reference = rng.gamma(0.7, 0.5, SHAPE)
    return reference * rng.normal(1, 0.4, SHAPE), reference


@pytest.fixture(scope="module")
def queue(device):
    return cl.CommandQueue(context_for(device), device)


def shown(image, exposure):
    return np.minimum(np.maximum(exposure * np.asarray(image, np.float64), 0), 1) ** (1 / 2.2)


@pytest.mark.parametrize("exposure", [1.0, 0.3, 4])
def test_tonemapped_errors_match_scikit_image(pair, exposure):
    from skimage.metrics import mean_squared_error, peak_signal_noise_ratio

    image, reference = (shown(x, exposure) for x in pair)
    np.testing.assert_allclose(metrics.tonemap(pair[0], exposure), image, rtol=1e-14)
    assert metrics.mse(*pair, exposure) == pytest.approx(mean_squared_error(reference, image))
    assert metrics.psnr(*pair, exposure) == pytest.approx(peak_signal_noise_ratio(reference, image, data_range=1))


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.longdouble])
def test_every_float_dtype_is_computed_in_float64(pair, dtype):
    image, reference = (x.astype(dtype) for x in pair)
    wide = image.astype(np.float64), reference.astype(np.float64)
    for metric in (metrics.mse, metrics.psnr, metrics.relmse, metrics.ssim, metrics.flip):
        assert metric(image, reference, 0.7) == metric(*wide, 0.7)
    assert metrics.tonemap(image).dtype == np.float64


def test_equal_images_are_perfect(pair):
    scores = metrics.compare(pair[1], Frame(pair[1]))
    assert scores == metrics.Scores(psnr=math.inf, mse=0, relmse=0, relmse_trimmed=0, ssim=1, flip=0)


@pytest.mark.parametrize("exposure", [1.0, 2.5])
def test_relmse_against_loops(pair, rng, exposure):
    image, reference = pair
    half_a, half_b = reference + rng.normal(0, 0.1, SHAPE), reference + rng.normal(0, 0.1, SHAPE)
    plain, halves = np.zeros(SHAPE[:2]), np.zeros(SHAPE[:2])
    for y, x in np.ndindex(SHAPE[:2]):
        p, r, a, b = (exposure * array[y, x] for array in (image, reference, half_a, half_b))
        below = (r[0] ** 2 + r[1] ** 2 + r[2] ** 2) / 3 + 0.01
        plain[y, x] = sum((p[c] - r[c]) ** 2 for c in range(3)) / 3 / below
        halves[y, x] = sum((p[c] - a[c]) * (p[c] - b[c]) for c in range(3)) / 3 / below
    np.testing.assert_allclose(metrics.relmse_map(image, reference, exposure), plain, atol=1e-12)
    np.testing.assert_allclose(metrics.relmse_map(image, reference, exposure, half_a, half_b), halves, atol=1e-12)
    assert metrics.relmse(image, reference, exposure) == pytest.approx(plain.mean())
    assert metrics.relmse(image, reference, exposure, half_a, half_b) == pytest.approx(halves.mean())
    assert halves.min() < 0, "single pixels may be negative"


def test_two_halves_cancel_the_noise_of_the_reference(rng):
    truth = rng.uniform(0.1, 1, (128, 128, 3))
    image = truth + 0.1
    exact = metrics.relmse(image, truth)
    noise = 0.2 * rng.standard_normal((2, *truth.shape))
    half_a, half_b = truth + noise
    errors = metrics.relmse_map(image, truth, 1.0, half_a, half_b)
    standard_error = errors.std() / math.sqrt(errors.size)
    assert abs(errors.mean() - exact) < 4 * standard_error
    # Without the halves, the variance of their mean, 0.02, comes on top of the true squared error, 0.01.
    assert metrics.relmse(image, (half_a + half_b) / 2) > 2 * exact
    assert standard_error < exact / 20, "the test could not tell the two apart"


def test_trimming_leaves_out_the_largest_magnitudes():
    reference = np.full((20, 50, 3), 0.5)
    image, half_a, half_b = reference + 0.1, reference.copy(), reference.copy()
    image[3, 4], image[5, 6] = 50, 90
    half_a[7, 8], half_b[7, 8] = 40, -40  # a product that is large and negative
    rest = 0.1**2 / (0.5**2 + 0.01)
    for drop, expected in ((3, rest), (2, None), (0, None)):
        errors = metrics.relmse_map(image, reference, 1.0, half_a, half_b).ravel()
        kept = sorted(errors, key=abs)[: len(errors) - drop]
        found = metrics.relmse(image, reference, 1.0, half_a, half_b, trim=drop / 1000)
        assert found == pytest.approx(np.mean(kept) if expected is None else expected)


def test_trimming_rounds_to_whole_pixels():
    image = np.arange(300.0).reshape(10, 10, 3)
    errors = metrics.relmse_map(image, np.zeros_like(image))
    # 0.29 * 100 is a little below 29 in floating point.
    assert metrics.relmse(image, np.zeros_like(image), trim=0.29) == pytest.approx(np.sort(errors.ravel())[:71].mean())


def test_trimming_keeps_at_least_one_pixel():
    assert metrics.relmse(np.ones((1, 2, 3)), np.ones((1, 2, 3)), trim=0.99) == 0


def test_trimming_a_small_image_drops_nothing(pair):
    # 0.1 % of 400 pixels is less than half a pixel.
    image, reference = (x[:20, :20] for x in pair)
    assert metrics.relmse(image, reference, trim=0.001) == metrics.relmse(image, reference)


def test_ssim_against_its_formula(pair):
    x, y = (shown(image, 0.8) for image in pair)

    def blur(array):
        return gaussian_filter(array, 1.5, truncate=3.5, axes=(0, 1))[5:-5, 5:-5]

    mx, my = blur(x), blur(y)
    vx, vy, vxy = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    expected = (2 * mx * my + 0.01**2) * (2 * vxy + 0.03**2) / ((mx**2 + my**2 + 0.01**2) * (vx + vy + 0.03**2))
    assert metrics.ssim(*pair, 0.8) == pytest.approx(expected.mean(), rel=1e-9)


def test_flip_takes_the_tonemapped_image_as_encoded(pair):
    import flip_evaluator

    image, reference = (shown(x, 0.8).astype(np.float32) for x in pair)
    expected = flip_evaluator.evaluate(reference, image, "LDR")[1]
    assert metrics.flip(*pair, 0.8) == pytest.approx(expected, abs=1e-6)


def test_flip_has_the_range_zero_to_one():
    black, white = np.zeros((64, 64, 3)), np.ones((64, 64, 3))
    assert metrics.flip(white, black) > 0.9
    assert metrics.flip(np.full_like(white, 0.5), white) < metrics.flip(black, white) <= 1


def test_compare_is_its_parts(pair, rng):
    image, reference = pair
    half = rng.normal(0, 0.2, SHAPE)
    frame = Frame(reference, color_a=reference + half, color_b=reference - half, metadata={"exposure_scale": 0.6})
    halves = 0.6, frame.color_a, frame.color_b
    assert metrics.compare(image, frame) == metrics.Scores(
        psnr=metrics.psnr(image, reference, 0.6),
        mse=metrics.mse(image, reference, 0.6),
        relmse=metrics.relmse(image, reference, *halves),
        relmse_trimmed=metrics.relmse(image, reference, *halves, trim=0.001),
        ssim=metrics.ssim(image, reference, 0.6),
        flip=metrics.flip(image, reference, 0.6),
    )
    assert metrics.compare(image, frame, exposure=2).mse == metrics.mse(image, reference, 2)


def test_exposure_is_automatic_without_metadata(pair):
    luminance = pair[1] @ [0.2126, 0.7152, 0.0722]
    expected = 0.18 / math.prod(luminance[luminance > 0] ** (1 / np.count_nonzero(luminance > 0)))
    assert metrics.auto_exposure(pair[1]) == pytest.approx(expected)
    assert metrics.compare(pair[0], Frame(pair[1])).mse == pytest.approx(metrics.mse(*pair, expected))


@pytest.mark.parametrize("dark", [1e-30, 1e-12, 1e-6, 0.0])
def test_automatic_exposure_takes_a_tiny_background_for_black(dark):
    image = np.random.default_rng(0).lognormal(0.0, 1.0, (40, 50, 3))
    image[:, 20:] = dark
    assert metrics.auto_exposure(image) == pytest.approx(oracle.auto_exposure(image))
    assert (metrics.auto_exposure(image) < 1) == (dark != 1e-6)


def test_automatic_exposure_skips_what_has_no_logarithm():
    image = np.full((4, 4, 3), 0.36)
    image[0, 0], image[1, 1], image[2, 2], image[3, 3] = 0, -1, np.nan, np.inf
    assert metrics.auto_exposure(image) == pytest.approx(0.5)
    assert metrics.auto_exposure(np.zeros((4, 4, 3))) == 1


def test_images_on_the_device_are_fetched(pair, queue):
    image, reference = (cl_array.to_device(queue, x) for x in pair)
    assert metrics.compare(image, Frame(reference)) == metrics.compare(pair[0], Frame(pair[1]))


@pytest.mark.parametrize("module", ["skimage", "flip_evaluator"])
def test_missing_packages(pair, monkeypatch, module):
    names = ("skimage", "skimage.metrics") if module == "skimage" else (module,)
    for name in names:
        monkeypatch.setitem(sys.modules, name, None)
    metric, score = (metrics.ssim, "ssim") if module == "skimage" else (metrics.flip, "flip")
    with pytest.raises(McdenoiseError, match=r"cannot be imported: pip install 'mcdenoise-cl\[demo\]'"):
        metric(*pair)
    scores = metrics.compare(pair[0], Frame(pair[1]))
    assert getattr(scores, score) is None
    assert scores.mse > 0


def test_small_images_have_no_ssim(pair):
    image, reference = (x[:10] for x in pair)
    with pytest.raises(FrameError, match=r"\(10, 31, 3\) but SSIM looks through an 11 x 11 window: pass a larger"):
        metrics.ssim(image, reference)
    assert metrics.compare(image, Frame(reference)).ssim is None
    assert metrics.compare(image[:1, :1], Frame(reference[:1, :1])).flip > 0


@pytest.mark.parametrize("metric", [metrics.mse, metrics.psnr, metrics.relmse, metrics.ssim, metrics.flip])
def test_unusable_images(pair, metric):
    image, reference = pair
    with pytest.raises(FrameError, match=r"reference is \(23, 31, 3\) but image is \(24, 31, 3\): pass images of the"):
        metric(image, reference[1:])
    with pytest.raises(FrameError, match=r"image has dtype uint8 but floats are needed: pass scene-linear"):
        metric(np.zeros(SHAPE, np.uint8), reference)
    with pytest.raises(FrameError, match=r"image is \(24, 31\) but \(H, W, 3\) is needed: pass one RGB image"):
        metric(image[..., 0], reference)
    with pytest.raises(FrameError, match=r"image is \(0, 31, 3\) but"):
        metric(image[:0], reference[:0])
    for exposure in (0, -1.0, math.nan, math.inf, "1", None, 1j):
        with pytest.raises(ParameterError, match=r"exposure is .* but a number above 0 is needed"):
            metric(image, reference, exposure)
    image[2, 3, 1], image[2, 3, 2], image[4, 5, 0] = np.nan, np.inf, -np.inf
    with pytest.raises(FrameError, match=r"image has 2 of 744 pixels that are not finite: repair them first"):
        metric(image, reference)
    with pytest.raises(FrameError, match=r"reference has 2 of 744 pixels"):
        metric(reference, image)


def test_compare_refuses_what_its_parts_refuse(pair):
    image, reference = pair
    with pytest.raises(FrameError, match=r"reference is \(24, 31, 3\) but image is \(24, 30, 3\)"):
        metrics.compare(image[:, 1:], Frame(reference))
    with pytest.raises(ParameterError, match=r"exposure is 'bright'"):
        metrics.compare(image, Frame(reference, metadata={"exposure_scale": "bright"}))
    image[0, 0, 0] = np.nan
    with pytest.raises(FrameError, match=r"image has 1 of 744 pixels"):
        metrics.compare(image, Frame(reference))
    with pytest.raises(FrameError, match=r"half_b has 1 of 744 pixels"):
        metrics.compare(reference, Frame(reference, color_a=reference, color_b=image))


def test_relmse_errors(pair):
    for halves, message in (
        ({"half_a": pair[0]}, "half_a is given but half_b is not"),
        ({"half_b": pair[0]}, "half_b"),
    ):
        with pytest.raises(ParameterError, match=f"{message}.*: pass both halves of the reference, or neither"):
            metrics.relmse(*pair, **halves)
    with pytest.raises(FrameError, match=r"half_b is \(1, 1, 3\) but image is \(24, 31, 3\)"):
        metrics.relmse(*pair, half_a=pair[1], half_b=np.ones((1, 1, 3)))
    for trim in (-0.1, 1, math.nan):
        with pytest.raises(ParameterError, match=rf"trim is {trim} but a fraction in \[0, 1\) is needed"):
            metrics.relmse(*pair, trim=trim)


def test_optional_packages_are_imported_on_use_only():
    code = (
        "import sys, mcdenoise_cl.metrics, mcdenoise_cl.report;"
        "print(*{'skimage', 'flip_evaluator', 'PIL', 'matplotlib'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
