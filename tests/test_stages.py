"""Each stage on the device against the equations in float64, on every kind of image and size."""

import cv2
import inputs
import numpy as np
import oracle
import pyopencl as cl
import pytest
from transfer import scalars, to_array, to_planes

from mcdenoise_cl.stages import box, canny, door, exit, exposure, guided, noise, pad
from mcdenoise_cl.stages.mean import plane_means

CASES = [pytest.param(image, id=name) for name, image in inputs.images(3)]
GRAY = [pytest.param(image, id=name) for name, image in inputs.images()]


def close(actual, expected, scale=None, tolerance=1e-5):
    """Equal to `tolerance` of the expected image's range of values."""
    scale = np.abs(expected).max() if scale is None else scale
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * max(scale, 1e-30))


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_door_and_exit_carry_every_dtype(engine, image, dtype):
    with np.errstate(over="ignore"):
        image = np.minimum(image, 60000).astype(dtype)
    bad = engine.zeros(1)
    source, alive = door.upload(engine, image)
    planes = door.door(engine, source, *image.shape[:2], bad)
    np.testing.assert_array_equal(to_array(engine, planes), image.astype("f4"))
    assert scalars(engine, bad, dtype=np.int32)[0] == 0
    target = door.Strided(engine.memory(alive.nbytes), alive.dtype, 3, 0, (3 * image.shape[1], 3, 1))
    exit.leave(engine, planes, target)
    back = np.empty_like(alive)
    cl.enqueue_copy(engine.queue, back, target.buffer, is_blocking=True)
    np.testing.assert_array_equal(back, alive)


def test_door_and_exit_keep_every_half(engine):
    """All 63488 numbers of 16 bits that are finite, to the bit, in rows whose last vector is not full."""
    bits = np.arange(2**16, dtype=np.uint16)
    numbers = bits[(bits & 0x7C00) != 0x7C00].view(np.float16)
    image = np.resize(numbers, (numbers.size // 87 + 1, 29, 3))
    source, _alive = door.upload(engine, image)
    planes = door.door(engine, source, *image.shape[:2], engine.zeros(1))
    np.testing.assert_array_equal(to_array(engine, planes), image)
    target = door.Strided(engine.memory(image.nbytes), image.dtype, 3, 0, (87, 3, 1))
    exit.leave(engine, planes, target)
    np.testing.assert_array_equal(scalars(engine, target.buffer, image.size, np.uint16), image.ravel().view(np.uint16))


@pytest.mark.parametrize("dtype", ["f2", "f4"])
def test_exit_bounds_what_a_type_cannot_hold(engine, dtype):
    most = np.finfo(dtype).max
    image = np.full((3, 41, 3), 0.1, np.float32)
    image[1, ::7], image[2, 1::5] = np.inf, -np.inf
    target = door.Strided(engine.memory(image.nbytes), np.dtype(dtype), 3, 0, (123, 3, 1))
    exit.leave(engine, to_planes(engine, image), target)
    found = scalars(engine, target.buffer, image.size, np.dtype(dtype)).reshape(image.shape)
    np.testing.assert_array_equal(found, np.clip(image, -most, most).astype(dtype))


@pytest.mark.parametrize("image", GRAY)
@pytest.mark.parametrize("dtype", ["f2", "f4"])
def test_door_of_one_channel(engine, image, dtype):
    with np.errstate(over="ignore"):
        image = np.minimum(image, 60000).astype(dtype)
    source, _alive = door.upload(engine, image)
    planes = door.door(engine, source, *image.shape, engine.zeros(1))
    assert planes.channels == 1
    np.testing.assert_array_equal(to_array(engine, planes), image)


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize("share", [0.02, 0.3, 1.0])
def test_door_fills_pixels_that_are_not_finite(engine, image, share):
    rng = np.random.default_rng(7)
    image = image.copy()
    hit = rng.random(image.shape) < share
    image[hit] = rng.choice([np.nan, np.inf, -np.inf], hit.sum())
    if share < 1:
        image[: image.shape[0] // 2, : image.shape[1] // 3] = np.nan  # a block wider than the first window
    expected, count = oracle.fill_nonfinite(image)
    bad = engine.zeros(3)
    source, _alive = door.upload(engine, image)
    planes = door.door(engine, source, *image.shape[:2], bad, 1)
    close(to_array(engine, planes), expected)
    assert list(scalars(engine, bad, 3, np.int32)) == [0, count, 0]


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize("border", [0, 1, 5, 40])
def test_pad_mirrors(engine, image, border):
    padded = pad.pad(engine, to_planes(engine, image), border, 0.5, 0.25)
    full = np.empty(3 * padded.plane, np.float32)
    cl.enqueue_copy(engine.queue, full, padded.buffer, is_blocking=True)
    full = padded.view(full)
    height, width = image.shape[:2]
    rows, columns = np.arange(full.shape[1]) - border, np.arange(full.shape[2]) - border
    expected = image[oracle.reflect_index(rows, height)][:, oracle.reflect_index(columns, width)]
    close(full.transpose(1, 2, 0), 0.5 * expected.astype(np.float64) + 0.25, tolerance=1e-6)


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize("curve", exposure.CURVES)
def test_exposure_and_tonemap(engine, image, curve):
    image = image - 0.3  # negative values too, as reconstruction filters leave them
    planes = to_planes(engine, image)
    factor = exposure.auto_exposure(engine, planes)
    expected = oracle.auto_exposure(image)
    assert scalars(engine, factor)[0] == pytest.approx(expected, rel=1e-5)
    tone = exposure.tonemap(engine, planes, factor, curve)
    close(to_array(engine, tone), oracle.tonemap(image, expected, curve), scale=1.0)
    # The way back alone, from values that both sides share: near 1 the inverse magnifies any difference.
    values = np.linspace(0, 0.95, 60, dtype=np.float32).reshape(4, 5, 3)
    back = exposure.tonemap_inverse(engine, to_planes(engine, values), factor, curve)
    close(to_array(engine, back), oracle.tonemap_inverse(values, expected, curve))


@pytest.mark.parametrize("image", CASES)
def test_compress_and_expand(engine, image):
    image = image - 0.3
    planes, factor = to_planes(engine, image), engine.constant([0.7])
    small = exposure.compress(engine, planes, factor)
    close(to_array(engine, small), oracle.compress(image, 0.7), scale=1.0, tolerance=1e-6)
    # A pixel left alone comes back to the last bit; a changed one as the inverse says.
    np.testing.assert_array_equal(to_array(engine, exposure.expand(engine, small, factor, planes)), image)
    changed = (0.9 * oracle.compress(image, 0.7)).astype(np.float32)
    back = to_array(engine, exposure.expand(engine, to_planes(engine, changed), factor, planes))
    expected = oracle.expand(changed, 0.7)
    np.testing.assert_allclose(back, expected, rtol=0, atol=2e-6 * (1 + np.abs(image).max()) * np.abs(image).max())


def test_exposure_of_a_black_frame_is_one(engine):
    assert scalars(engine, exposure.auto_exposure(engine, to_planes(engine, np.zeros((5, 6, 3)))))[0] == 1.0


@pytest.mark.parametrize("dark", [1e-38, 1e-30, 1e-12, 1e-6])
@pytest.mark.parametrize("lit", [15, 16, 300, 1170, 2340])
def test_exposure_takes_a_tiny_background_for_black(engine, dark, lit):
    """So many of 2340 pixels have light. The exposure is that of a black background to the last bits, or none is
    black; in bands it is the same."""
    image = inputs.planes("uniform", 36, 65, 3) + np.float32(0.5)
    image.reshape(-1, 3)[np.random.default_rng(1).permutation(2340)[lit:]] = dark
    black = np.where(image == np.float32(dark), 0, image)
    planes = to_planes(engine, image)
    factor = scalars(engine, exposure.auto_exposure(engine, planes))[0]
    assert factor == pytest.approx(min(oracle.auto_exposure(image), 1e30), rel=1e-5)
    if lit >= 300 and dark < 1e-9:
        assert factor == pytest.approx(oracle.auto_exposure(black), rel=1e-6)
    bands = [(to_planes(engine, image[start:stop]), start) for start, stop in ((0, 7), (7, 8), (8, 36))]
    assert scalars(engine, exposure.exposure_of_bands(engine, bands, 36))[0] == factor


def test_all_of_a_depth_counts(engine):
    """A sky at 1e30 is no reason to take what is near for nothing."""
    depth = np.full((8, 16), 4.0, np.float32)
    depth[:, 8:] = 1e30
    scale = exposure.inverse_geometric_mean(engine, to_planes(engine, depth))
    assert scalars(engine, scale)[0] == pytest.approx(1 / np.sqrt(4e30), rel=1e-5)


@pytest.mark.parametrize("image", CASES)
def test_noise_level(engine, image):
    measured = scalars(engine, noise.noise_level(engine, to_planes(engine, image)))[0]
    assert measured == pytest.approx(oracle.noise_level(image), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("bright", [1e19, 1e25, 1e30, 3e38, np.inf])
def test_noise_level_is_finite_whatever_the_light(engine, bright):
    """Its squares are not; of a response above 1e30 that much counts."""
    image = inputs.planes("uniform", 31, 64, 3)
    image[10, 20, 1] = bright
    measured = scalars(engine, noise.noise_level(engine, to_planes(engine, image)))[0]
    assert np.isfinite(measured)
    if bright < 1e30:
        assert measured == pytest.approx(oracle.noise_level(image), rel=1e-5)


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize("radius", [0, 1, 4, 50])
def test_box_mean(engine, image, radius):
    close(to_array(engine, box.box_mean(engine, to_planes(engine, image), radius)), oracle.box_mean(image, radius))


def test_box_mean_forgets_a_bright_light(engine):
    """A running sum that carried its rounding errors along would be wrong behind the light."""
    image = inputs.planes("uniform", 300, 40, 1)
    image[100:103, 10:12] = 1e7
    actual = to_array(engine, box.box_mean(engine, to_planes(engine, image), 3))
    expected = oracle.box_mean(image[..., 0], 3)
    dark = expected < 2
    assert dark.mean() > 0.9
    np.testing.assert_allclose(actual[dark], expected[dark], rtol=1e-5)


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize(("radius", "epsilon"), [(1, 1e-2), (3, 1e-4), (20, 1e-1)])
def test_guided_filter(engine, image, radius, epsilon):
    rng = np.random.default_rng(3)
    height, width = image.shape[:2]
    binary = (rng.random((height, width)) < 0.3).astype(np.float32)
    smooth = inputs.planes("textured", height, width)
    for guide in (binary, smooth):
        out = guided.guided_filter(engine, to_planes(engine, guide), to_planes(engine, image), radius, epsilon)
        close(to_array(engine, out), oracle.guided_filter(guide, image, radius, epsilon))


def test_guided_filter_of_a_ripple_on_a_large_offset(engine):
    guide = inputs.planes("uniform", 31, 64)
    image = np.float32(1e5) + inputs.planes("uniform", 31, 64)
    out = guided.guided_filter(engine, to_planes(engine, guide), to_planes(engine, image), 3, 1e-3)
    expected = oracle.guided_filter(guide, image, 3, 1e-3)
    close(to_array(engine, out), expected, scale=1e5, tolerance=1e-7)


def test_guided_filter_agrees_with_opencv(engine):
    guide, image = inputs.planes("textured", 37, 101), inputs.planes("uniform", 37, 101)
    radius = 4
    out = to_array(
        engine, guided.guided_filter(engine, to_planes(engine, guide), to_planes(engine, image), radius, 0.01)
    )
    theirs = cv2.ximgproc.guidedFilter(guide, image, radius, 0.01)
    inner = np.s_[2 * radius : -2 * radius, 2 * radius : -2 * radius]  # another border rule than ours
    close(out[inner], theirs[inner])


@pytest.mark.parametrize("image", GRAY)
@pytest.mark.parametrize("sigma", [0.5, 1.4, 6.0])
def test_gaussian_blur(engine, image, sigma):
    close(
        to_array(engine, canny.gaussian_blur(engine, to_planes(engine, image), sigma)),
        oracle.gaussian_blur(image, sigma),
    )


@pytest.mark.parametrize("image", CASES)
def test_albedo_luminance(engine, image):
    expected = oracle.srgb_encode(oracle.luminance(image))
    close(to_array(engine, canny.albedo_luminance(engine, to_planes(engine, image))), expected, scale=1.0)


@pytest.mark.parametrize("image", GRAY)
def test_median_thresholds(engine, image):
    found = scalars(engine, canny.canny_thresholds(engine, to_planes(engine, image)), 2)
    np.testing.assert_allclose(found, oracle.median_thresholds(image), rtol=1e-6)
    found = scalars(engine, canny.canny_thresholds(engine, to_planes(engine, image), low=0.125), 2)
    np.testing.assert_allclose(found, [0.125, oracle.median_thresholds(image)[1]], rtol=1e-6)


def byte_image(kind, height, width):
    """Values 0 to 255 without fractions: gradients are then exact in integers and in floats alike."""
    return np.floor(np.minimum(inputs.planes(kind, height, width), 1) * 255).astype(np.float32)


@pytest.mark.parametrize(("height", "width"), [*inputs.SIZES, (97, 131)])
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize(("low", "high"), [(50.0, 120.0), (200.0, 700.0)])
def test_canny_is_exactly_the_oracle_and_opencv(engine, kind, height, width, low, high):
    image = byte_image(kind, height, width)
    if kind == "hdr":  # blobs: long closed contours, which exercise the hysteresis
        image = np.floor(cv2.GaussianBlur(image, (0, 0), 2.0) * 0.9)
    edges = to_array(engine, canny.canny(engine, to_planes(engine, image), low, high, sigma=0.0))
    np.testing.assert_array_equal(edges, oracle.canny(image, low, high, sigma=None))
    gx, gy = (g.astype(np.int16) for g in oracle.sobel(image))
    theirs = cv2.Canny(gx, gy, low, high, L2gradient=True) / 255
    np.testing.assert_array_equal(edges, theirs)


def test_canny_follows_a_weak_edge_to_its_strong_end(engine):
    """One long, winding, weak contour with a single strong pixel: all of it, or (no strong pixel) none."""
    image = np.zeros((65, 65), np.float32)
    for ring in range(4, 32, 8):
        cv2.rectangle(image, (ring, ring), (64 - ring, 64 - ring), 60.0, 2)
        cv2.line(image, (ring, 32), (ring + 8, 32), 60.0, 2)
    weak = to_array(engine, canny.canny(engine, to_planes(engine, image), 100.0, 500.0, sigma=0.0))
    assert weak.sum() == 0
    image[4, 4:8] = 255.0
    edges = to_array(engine, canny.canny(engine, to_planes(engine, image), 100.0, 500.0, sigma=0.0))
    np.testing.assert_array_equal(edges, oracle.canny(image, 100.0, 500.0, sigma=None))
    assert edges.sum() > 200


@pytest.mark.parametrize("seed", range(5))
def test_canny_with_blur_differs_only_where_rounding_decides(engine, seed):
    """With a blur, float32 and float64 can fall on different sides of a threshold or of a tie, rarely."""
    albedo = inputs.features(67, 91, seed=seed)["albedo"]
    gray = oracle.srgb_encode(oracle.luminance(albedo)).astype(np.float32)
    edges = to_array(engine, canny.canny(engine, to_planes(engine, gray), 0.2, 0.5))
    expected = oracle.canny(gray, 0.2, 0.5)
    assert 0.005 < expected.mean() < 0.5
    assert (edges != expected).mean() < 0.002


@pytest.mark.parametrize("image", CASES)
def test_plane_means(engine, image):
    means = scalars(engine, plane_means(engine, to_planes(engine, image - 0.3)), 3)
    np.testing.assert_allclose(means, np.abs(image.astype(np.float64) - 0.3).mean((0, 1)), rtol=1e-4)
