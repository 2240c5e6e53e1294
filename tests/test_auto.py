"""Half differences, the choice between filters, and the method `auto`, on the device against float64."""

from dataclasses import asdict

import inputs
import numpy as np
import oracle
import oracle_auto
import oracle_choice as theory
import pyopencl as cl
import pytest
from test_regression import FULL, SIZES, full_scene
from test_render import CAMERA, WORLD
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl import Denoiser, Frame, denoise
from mcdenoise_cl.device import context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.methods import auto, get_method
from mcdenoise_cl.render import render
from mcdenoise_cl.stages import choice, halves
from mcdenoise_cl.stages.box import box_mean
from mcdenoise_cl.stages.luminance import luminance_around, smooth_variance

WINDOW = {"search_radius": 3, "patch_radius": 1, "wide_radius": 2, "wide_stride": 2, "spread_radius": 6}


def options_of(**changed):
    """The method's parameters as the oracle takes them."""
    options = asdict(get_method("auto").make()) | changed
    if not options.pop("outliers"):
        options["outlier_limit"] = None
    return options | {
        "limit": auto.LIMIT,
        "keep": auto.KEEP,
        "apart": auto.APART,
        "smoothing_radius": choice.SMOOTHING_RADIUS,
    }


def frame_like(image, seed):
    """A filtered frame: colours near the image and a half difference."""
    rng = np.random.default_rng(seed)
    shape = image.shape[:2]
    colors = image * (1 + 0.2 * rng.standard_normal((*shape, 1)))
    return np.concatenate([colors, 0.1 * rng.standard_normal((*shape, 1))], axis=-1).astype(np.float32)


def in_brief(frame):
    return np.stack([oracle.luminance(frame[..., :3].astype(np.float64)), frame[..., 3]], axis=-1)


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_half_differences(engine, height, width):
    a, b = (inputs.planes("hdr", height, width, 3, seed=seed) for seed in (0, 1))
    factor = inputs.planes("uniform", height, width)
    out = halves.difference_of_halves(engine, *(to_planes(engine, plane) for plane in (a, b, factor)))
    close(to_array(engine, out), factor * oracle.luminance(a.astype(np.float64) - b) / 2)
    out = halves.difference_from_variance(engine, to_planes(engine, a))
    expected = oracle_auto.normal_numbers(height, width) * oracle_auto.luminance_deviation(a.astype(np.float64))
    close(to_array(engine, out), expected)


@pytest.mark.parametrize(("height", "width"), [*SIZES, (37, 101)])
@pytest.mark.parametrize("kind", inputs.KINDS)
def test_smooth_variance(engine, kind, height, width):
    color = inputs.planes(kind, height, width, 3)
    variance = inputs.planes("hdr", height, width, 3, seed=1)
    got = to_array(engine, smooth_variance(engine, to_planes(engine, variance), to_planes(engine, color), 2))
    np.testing.assert_allclose(got, oracle_auto.smooth_variance(variance, color.astype(np.float64)), rtol=1e-4)


def test_a_bright_light_gives_its_noise_to_no_wall(engine):
    color = np.full((20, 40, 3), 0.1, np.float32)
    color[:, 20:] = 100
    variance = 0.01 * color**2
    smooth = to_array(engine, smooth_variance(engine, to_planes(engine, variance), to_planes(engine, color), 2))
    assert (smooth[:, :18] <= 1.01 * variance[:, :18]).all() and (smooth[:, :18] >= 0.3 * variance[:, :18]).all()
    assert (oracle.box_mean(variance.astype(np.float64), 2)[:, 18] > 1e4 * variance[:, 18]).all()


@pytest.mark.parametrize(("height", "width"), [*SIZES, (37, 101)])
@pytest.mark.parametrize("kind", ["uniform", "constant", "step", "textured"])
@pytest.mark.parametrize(
    ("prior", "doubt", "margin", "apart", "known"), [(0.5, 0.4, 0.0, 0.2, False), (0.0, 0.0, 0.4, 1e30, True)]
)
def test_choice(engine, kind, height, width, prior, doubt, margin, apart, known):
    image = inputs.planes(kind, height, width, 3)
    current, candidate, noisy = (frame_like(image, seed) for seed in range(3))
    variance = (0.02 * (image + 0.1)).astype(np.float32)
    planes = [to_planes(engine, frame) for frame in (current, candidate, noisy)]
    level = box_mean(engine, choice.luminance_noise(engine, to_planes(engine, variance)), 1)
    target = choice.Target(planes[2], level, luminance_around(engine, planes[0]))
    noise = oracle.box_mean(oracle_auto.luminance_deviation(variance.astype(np.float64)) ** 2, 1)
    scale = oracle.box_mean(oracle.luminance(current[..., :3].astype(np.float64)), 1) ** 2 + 1e-3
    close(to_array(engine, target.noise), noise)

    found = choice.compare(engine, *planes[:2], target, tracking=0.01, limit=1.0, known=known)
    briefs = [in_brief(frame) for frame in (current, candidate, noisy)]
    g, q = theory.compare(*briefs, noise, scale, tracking=0.01, limit=1.0)
    square = 2 * q * noise / scale if known else g * g
    for got, expected in zip(to_array(engine, found).transpose(2, 0, 1), (g, square, q), strict=True):
        close(got, theory.twice_box_mean(expected, choice.SMOOTHING_RADIUS), tolerance=1e-5)

    share = choice.mix_in(engine, *planes[:2], found, prior=prior, doubt=doubt, margin=margin, apart=apart)
    options = {"prior": prior, "doubt": doubt, "margin": margin, "square": square}
    expected = theory.share(g, q, radius=choice.SMOOTHING_RADIUS, **options) * theory.believed(*briefs[:2], apart)
    close(to_array(engine, share), expected, scale=1.0, tolerance=1e-3)
    close(to_array(engine, planes[0]), current + expected[..., None] * (candidate - current), tolerance=1e-3)

    error = choice.estimated_error(engine, planes[1], target, share)
    expected = theory.estimated_error(briefs[1], briefs[2], expected, scale, radius=choice.SMOOTHING_RADIUS)
    close(to_array(engine, error), expected, scale=max(expected.max(), q.max()), tolerance=1e-3)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize(
    "names",
    [FULL, (*FULL, "color_a", "color_b"), FULL[:3], ("color_a", "color_b"), ("depth", "depth_variance"), ()],
    ids=lambda names: "+".join(names) or "color alone",
)
def test_whole_method(height, width, names):
    scene = full_scene(height, width)
    planes = {name: scene[name] for name in names}
    image, shares, error = oracle_auto.denoise_auto(scene["color"], planes, **options_of(**WINDOW))
    result = denoise(scene["color"], **planes, method="auto", details=True, **WINDOW)
    # A share near a clip changes by the rounding of a small quotient; the mix then by that share of a small step.
    close(result.image, image, tolerance=5e-4)
    close(result.error_map, error, scale=max(error.max(), 1e-2), tolerance=5e-3)
    assert set(result.report.shares) == set(result.candidates)
    if height * width > 1:  # in a single pixel every candidate is the input, and rounding decides
        np.testing.assert_allclose(list(result.report.shares.values()), shares.mean((1, 2)), atol=5e-3)
    assert result.model_map.shape == (height, width) and result.model_map.max() < len(result.candidates)


@pytest.mark.parametrize(("height", "width"), [size for size in SIZES if min(size) > 10])
@pytest.mark.parametrize("names", [FULL, (*FULL, "color_a", "color_b"), ("color_a", "color_b")], ids="+".join)
def test_whole_method_where_there_is_little_noise(height, width, names):
    """What it keeps of its noise is found by disturbing the frame."""
    scene = with_little_noise(full_scene(height, width))
    planes = {name: scene[name] for name in names}
    assert oracle_auto.is_quiet(scene["color"], planes)
    image, shares, _ = oracle_auto.denoise_auto(scene["color"], planes, **options_of(**WINDOW))
    result = denoise(scene["color"], **planes, method="auto", details=True, **WINDOW)
    # What is left of a small part of the noise in float32, by which the rest is divided.
    close(result.image, image, tolerance=1e-3)
    np.testing.assert_allclose(list(result.report.shares.values()), shares.mean((1, 2)), atol=5e-3)


def with_little_noise(scene):
    """The same frame with a tenth of the noise said of its colour."""
    quiet = {"color_variance": 0.01 * scene["color_variance"]}
    for name in ("color_a", "color_b"):
        quiet[name] = scene["color"] + np.float32(0.1) * (scene[name] - scene["color"])
    return scene | quiet


@pytest.mark.parametrize("names", [("color_variance",), ("color_a", "color_b"), ()], ids=["variance", "halves", "none"])
def test_only_noise_that_is_known_holds_the_result_to_the_input(device, names):
    """An estimate from the image would take a texture for noise, and a smooth place for one without."""
    profiling = cl.command_queue_properties.PROFILING_ENABLE
    engine = Engine(cl.CommandQueue(context_for(device), device, properties=profiling))
    scene = full_scene(13, 17)
    planes = {name: to_planes(engine, scene[name]) for name in ("color", *names)}
    auto.run(engine, planes, get_method("auto").make(**WINDOW))
    assert ("shrink" in engine.stage_times()) == bool(names)


def test_auto_is_what_happens_without_a_method():
    scene = full_scene(24, 40)
    np.testing.assert_array_equal(denoise(scene["color"]), denoise(scene["color"], method="auto"))


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_exposure_does_not_matter(scale):
    scene = full_scene(24, 40)
    scaled = {name: plane * np.float32(scale) if name.startswith("color") else plane for name, plane in scene.items()}
    scaled["color_variance"] = scene["color_variance"] * np.float32(scale) ** 2
    close(denoise(Frame(**scaled)) / scale, denoise(Frame(**scene)), tolerance=1e-4)


def test_the_mix_is_better_than_the_regression_alone():
    truth = inputs.features(96, 128, noise=0.0)["color"]
    scene = inputs.features(96, 128)

    def error(method):
        image = denoise(Frame(**scene), method=method)
        return np.mean((image - truth) ** 2 / (truth**2 + 0.01))

    assert error("auto") < error("regression")


def with_noise(truth, noise, known, seed=1):
    """The truth with noise of this part of each pixel's value, and what is known of that: a variance, or two halves."""
    rng = np.random.default_rng(seed)
    sigma = noise * truth
    if known == "variance":
        color = (truth + sigma * rng.standard_normal(truth.shape)).astype(np.float32)
        return {"color": color, "color_variance": sigma**2}
    a, b = (truth + np.sqrt(2) * sigma * rng.standard_normal((2, *truth.shape))).astype(np.float32)
    return {"color": (a + b) / 2, "color_a": a, "color_b": b}


@pytest.mark.parametrize("known", ["variance", "halves"])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_no_harm_to_a_converged_frame(noise, known):
    scene = inputs.features(64, 96, noise=0.0)
    truth = scene["color"]
    frame = Frame(**scene | with_noise(truth, noise, known))

    def error(image):
        return np.mean((image.astype(np.float64) - truth) ** 2 / (truth.astype(np.float64) ** 2 + 0.01))

    assert error(denoise(frame)) <= error(frame.color) + 1e-11


@pytest.mark.parametrize("seed", range(2))
def test_noise_that_is_exactly_known_is_not_kept(seed):
    """The same everywhere: what a result differs by from its input is noise, and no reason to doubt the result."""
    scene = inputs.features(96, 128, noise=0.0)
    truth, rng = scene["color"], np.random.default_rng(seed)
    sigma = 0.01 * truth.mean()
    scene["color"] = (truth + sigma * rng.standard_normal(truth.shape)).astype(np.float32)
    result = denoise(Frame(**scene, color_variance=np.full_like(truth, sigma**2)), details=True)
    assert result.report.shares["input"] < 0.02
    assert np.mean((result.image - truth) ** 2) < 0.5 * sigma**2


@pytest.fixture(scope="module")
def rendering(tmp_path_factory):
    """Of 256 samples, to be taken as truth: its own noise is a texture that no feature shows."""
    path = tmp_path_factory.mktemp("scene") / "still.xml"
    path.write_text(f'<scene version="3.0.0">{CAMERA + WORLD}</scene>')
    return render(path, spp=256, width=64, variant="scalar_rgb")


@pytest.mark.parametrize("known", ["variance", "halves"])
@pytest.mark.parametrize("noise", [1e-4, 1e-3, 1e-2])
def test_no_harm_to_a_converged_rendering(rendering, noise, known):
    """The error of the input is the square of the noise: a few wrong fits in the dark would add a quarter to 1e-3."""
    truth = rendering.color.astype(np.float64)
    features = {name: plane for name, plane in rendering.planes().items() if not name.startswith("color")}

    def error(image):
        return np.mean((image - truth) ** 2 / (truth**2 + 1e-4 * truth.mean() ** 2))

    frames = [Frame(**features, **with_noise(rendering.color, noise, known, seed)) for seed in range(3)]
    ratio = sum(error(denoise(frame)) for frame in frames) / sum(error(frame.color) for frame in frames)
    assert ratio <= 1.0001


def texture():
    return 0.3 + 0.2 * inputs.planes("textured", 64, 96, 3)


def test_a_bright_texel_that_both_halves_have_is_no_outlier():
    truth = texture()
    truth[30, 40] *= 3.0
    out = denoise(Frame(**with_noise(truth, 1e-4, "halves")))
    np.testing.assert_allclose(out[30, 40], truth[30, 40], rtol=0.01)


@pytest.mark.parametrize("noise", [1e-4, 0.1])
def test_a_firefly_in_one_half_goes(noise):
    truth = texture()
    halves = with_noise(truth, noise, "halves")
    halves["color_a"][30, 40] *= 1e3
    halves["color"] = (halves["color_a"] + halves["color_b"]) / 2
    out = denoise(Frame(**halves))
    assert halves["color"][30, 40].min() > 100.0
    np.testing.assert_allclose(out[30, 40], truth[30, 40], rtol=0.1)
    # Its light is spread; half as much again is the most that any pixel gets in proportion.
    assert (out < 1.6 * truth).all()


def test_the_estimated_error_tells_a_good_result_from_a_bad_one():
    truth = inputs.features(96, 128, noise=0.0)["color"].astype(np.float64)
    estimated, true = [], []
    for noise in (0.25, 0.5, 1.0):
        rng = np.random.default_rng(2)
        sigma = (noise * 0.3 * truth).astype(np.float32)
        scene = inputs.features(96, 128, noise=0.0)
        color = (truth + sigma * rng.standard_normal((96, 128, 1))).astype(np.float32)
        features = {name: scene[name] for name in ("albedo", "normal", "depth")}
        given = {"color_variance": sigma**2, "outliers": False, "details": True}
        result = denoise(color, **features, **given)
        step = oracle.luminance(result.image.astype(np.float64) - truth)
        estimated.append(result.report.estimated_error)
        true.append(np.mean(step**2 / (oracle.luminance(truth) ** 2 + 1e-3)))
    np.testing.assert_allclose(np.log(estimated), np.log(true), atol=np.log(2))


def test_the_report_says_what_was_used():
    scene = full_scene(24, 64)
    scene["normal"][:] = (0, 0, 1)
    scene["normal_variance"][:] = 0
    scene["color"][10, 10] = 500
    scene["color_variance"][10, 10] = 500**2
    denoiser = Denoiser(24, 64, method="auto")
    denoiser(Frame(**scene))
    report = denoiser.report
    assert report.features_used["normal"] == 0.0 and report.features_used["albedo"] == 1.0
    assert sum(report.shares.values()) == pytest.approx(1.0, abs=1e-5)
    kept = oracle_auto.prepare(scene["color"], {"color_variance": scene["color_variance"]}, 1.1, 1.0).color
    lost = np.abs(scene["color"] - kept).sum()
    assert report.energy_removed == pytest.approx(lost / np.abs(scene["color"]).sum(), rel=1e-3)
    assert report.estimated_error == pytest.approx(float(denoiser.error_map.mean()))
    off = Denoiser(24, 64, method="auto", outliers=False)
    off(Frame(**scene))
    assert off.report.energy_removed == 0.0


def test_a_single_filter_has_no_maps():
    result = denoise(full_scene(13, 17)["color"], method="nlm", details=True)
    assert result.model_map is None and result.error_map is None and result.report.shares == {}
