"""Whole methods against the equations in float64, and what they promise of parameters."""

from dataclasses import asdict

import inputs
import numpy as np
import oracle
import oracle_auto
import pytest
from test_auto import options_of
from test_stages import close

from mcdenoise_cl import ParameterError, denoise, methods
from mcdenoise_cl.methods import DEFAULT_PRESET, PRESETS, get_method, settle
from mcdenoise_cl.methods.parameters import make, parse
from mcdenoise_cl.render import render

SIZES = [(1, 1), (1, 9), (7, 1), (3, 2), (13, 17), (48, 64)]


def scene(height, width, seed=0):
    """A synthetic scene; the edges of its albedo do not hang on float32 rounding (checked by the caller)."""
    return inputs.features(height, width, seed=seed)


def close_in_both_domains(actual, expected):
    """1e-5 in the domain that is averaged; undoing x / (1 + x) multiplies an error by (1 + x)² at bright pixels."""
    close(oracle.compress(actual, 1.0), oracle.compress(expected, 1.0), scale=1.0)
    close(actual, expected, tolerance=1e-4)


def defaults(method):
    values = asdict(make(get_method(method).make, method, {}))
    values.pop("stabilised", None)
    if values["patch_sigma"] is None:
        values["patch_sigma"] = values["patch_radius"] / 2
    return values


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize(
    "given", [{}, {"curve": "clip", "average": "linear", "center": "one"}, {"average": "tonemapped"}]
)
def test_nlm(height, width, given):
    color = scene(height, width)["color"]
    expected = oracle.denoise_nlm(color, **{**defaults("nlm"), **given})
    close_in_both_domains(denoise(color, method="nlm", **given), expected)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize(
    "given",
    [
        {},
        {"stabilised": False},
        {"curve": "clip", "average": "linear", "h": 0.1, "exposure": 0.5},
        {"search_radius": 2, "patch_radius": 1, "patch_sigma": 0.8, "canny_low": 0.3, "canny_high": 0.9},
        {"guided_radius": 4, "guided_epsilon": 1e-3, "canny_sigma": 0.0, "ssim_c2": 1e-3, "stabiliser": 0.5},
    ],
)
def test_ssim_nlm(height, width, given):
    planes = scene(height, width)
    color = planes.pop("color")
    planes.pop("depth")
    options = {**defaults("ssim-nlm"), **given}
    if not options.pop("stabilised", True):
        options |= {"stabiliser": 0.0, "center": "one"}
    gray = oracle.srgb_encode(oracle.luminance(planes["albedo"]))
    low, high = (
        mid if options[name] is None else options[name]
        for name, mid in zip(("canny_low", "canny_high"), oracle.median_thresholds(gray), strict=True)
    )
    # Canny decides; the comparison is fair only where a change the size of float32's rounding decides nothing.
    sigma = options["canny_sigma"]
    edges = oracle.canny(gray, low, high, sigma)
    for nudge in (-1e-5, 1e-5):
        np.testing.assert_array_equal(edges, oracle.canny(gray, low + nudge, high + nudge, sigma))
    expected = oracle.denoise_ssim_nlm(color, **planes, **options)
    close_in_both_domains(denoise(color, **planes, method="ssim-nlm", **given), expected)


def test_a_frame_with_holes():
    planes = scene(48, 64)
    planes.pop("depth")
    rng = np.random.default_rng(5)
    for plane in planes.values():
        plane[rng.random(plane.shape[:2]) < 0.02] = np.nan
    planes["color"][20:30, 40:50, 1] = np.inf
    color = planes.pop("color")
    expected = oracle.denoise_ssim_nlm(color, **planes, **defaults("ssim-nlm"))
    close_in_both_domains(denoise(color, **planes, method="ssim-nlm"), expected)


def test_denoising_brings_a_noisy_image_closer_to_the_truth():
    noisy, truth = inputs.features(96, 128), inputs.features(96, 128, noise=0.0)["color"]
    errors = {}
    for method in ("nlm", "ssim-nlm", "regression", "auto", "guided"):
        clean = denoise(noisy["color"], albedo=noisy["albedo"], normal=noisy["normal"], method=method)
        errors[method] = np.mean((clean - truth) ** 2 / (truth**2 + 0.01))
    before = np.mean((noisy["color"] - truth) ** 2 / (truth**2 + 0.01))
    assert errors["nlm"] < 0.5 * before
    assert errors["ssim-nlm"] < errors["nlm"]
    assert errors["regression"] < errors["nlm"]


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("method", ["nlm", "ssim-nlm"])
def test_exposure_does_not_matter(method, scale):
    planes = scene(48, 64)
    color = planes["color"]
    features = {"albedo": planes["albedo"], "normal": planes["normal"]}
    once = denoise(color, **features, method=method)
    scaled = denoise(color * np.float32(scale), **features, method=method) / np.float32(scale)
    close(scaled, once, tolerance=1e-4)


@pytest.mark.parametrize("method", ["nlm", "ssim-nlm"])
@pytest.mark.parametrize("value", [0.0, 0.3, 7.0, 12345.0, -0.1])
def test_a_constant_frame_comes_out_to_the_last_bit(method, value):
    color = np.full((20, 70, 3), value, np.float32) * np.float32([1.0, 0.7, 0.1])
    normal = np.zeros_like(color) + np.float32([0, 0, 1])
    np.testing.assert_array_equal(denoise(color, albedo=normal, normal=normal, method=method), color)


def test_negative_colors_survive():
    rng = np.random.default_rng(0)
    color = (-0.2 + 0.01 * rng.standard_normal((32, 32, 3))).astype(np.float32)
    clean = denoise(color, method="nlm")
    assert clean.max() < -0.15
    assert clean.std() < 0.5 * color.std()


def test_every_parameter_explains_itself():
    for method in methods():
        assert method.summary
        for info in method.parameters:
            assert info.meaning, (method.name, info.name)
            assert info.type in (bool, int, float, str)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"serch_radius": 3}, ["serch_radius", "search_radius"]),
        ({"search_radius": -1}, ["search_radius is -1", "from 0 to 64"]),
        ({"search_radius": 2.5}, ["2.5", "whole number"]),
        ({"search_radius": True}, ["True"]),
        ({"search_radius": "3"}, ["'3'", "whole number"]),
        ({"h": float("nan")}, ["nan", "at least 0", "or none"]),
        ({"exposure": 0}, ["exposure is 0"]),
        ({"average": "median"}, ["median", "linear, compressed, tonemapped"]),
        ({"stabilised": 1}, ["stabilised is 1", "true or false"]),
    ],
)
def test_wrong_parameters_are_named(given, words):
    with pytest.raises(ParameterError) as error:
        make(get_method("ssim-nlm").make, "ssim-nlm", given)
    for word in words:
        assert word in str(error.value)


def test_numpy_scalars_are_numbers():
    made = make(get_method("nlm").make, "nlm", {"search_radius": np.int64(4), "h": np.float32(0.5)})
    assert (made.search_radius, made.h) == (4, 0.5)


def test_parsing_of_the_command_line():
    info = {i.name: i for i in get_method("ssim-nlm").parameters}
    assert parse(info["search_radius"], "5") == 5
    assert parse(info["h"], "none") is None
    assert parse(info["stabilised"], "no") is False
    assert parse(info["average"], "linear") == "linear"
    for name, text in [("search_radius", "5.5"), ("search_radius", "none"), ("stabilised", "maybe"), ("h", "x")]:
        with pytest.raises(ParameterError, match=name):
            parse(info[name], text)


def test_unknown_method():
    with pytest.raises(ParameterError, match="'bm3d' but one of nlm, ssim-nlm, regression, auto, guided"):
        get_method("bm3d")


@pytest.fixture(scope="module")
def rendering():
    """A few samples of a real scene: black pixels, fireflies, a lamp, and features with noise of their own."""
    return render("room", spp=4, width=40, height=24, halves=True, variant="scalar_rgb")


def test_nlm_on_a_rendering(rendering):
    expected = oracle.denoise_nlm(rendering.color, **defaults("nlm"))
    close_in_both_domains(denoise(rendering, method="nlm"), expected)


def test_ssim_nlm_on_a_rendering(rendering):
    features = {"albedo": rendering.albedo, "normal": rendering.normal}
    expected = oracle.denoise_ssim_nlm(rendering.color, **features, **defaults("ssim-nlm"))
    close_in_both_domains(denoise(rendering, method="ssim-nlm"), expected)


def test_regression_on_a_rendering(rendering):
    options = asdict(get_method("regression").make()) | {"search_radius": 4}
    del options["outliers"]
    expected = oracle_auto.denoise_regression(rendering.color, rendering.planes(), **options)
    close(denoise(rendering, method="regression", search_radius=4), expected, tolerance=2e-4)


def test_auto_on_a_rendering(rendering):
    image, _, _ = oracle_auto.denoise_auto(rendering.color, rendering.planes(), **options_of(search_radius=4))
    close(denoise(rendering, method="auto", search_radius=4), image, tolerance=5e-4)


@pytest.mark.parametrize("name", list(PRESETS))
def test_a_preset_is_its_method_with_its_parameters(name):
    scene = inputs.features(24, 40, noise=0.3)
    planes = {key: scene[key] for key in ("albedo", "normal", "depth")}
    preset = PRESETS[name]
    expected = denoise(scene["color"], **planes, method=preset.method, **preset.parameters)
    np.testing.assert_array_equal(denoise(scene["color"], **planes, preset=name), expected)


def test_no_preset_is_the_default_preset_and_parameters_go_before_a_preset():
    assert settle(None, None, {}) == settle(None, DEFAULT_PRESET, {})
    assert settle(None, "balanced", {"search_radius": 3})[1]["search_radius"] == 3
    assert settle("nlm", None, {"h_factor": 2.0}) == ("nlm", {"h_factor": 2.0})


def test_presets_refused():
    color = np.ones((4, 4, 3), np.float32)
    with pytest.raises(ParameterError, match="method 'nlm' and preset 'fast' are both given"):
        denoise(color, method="nlm", preset="fast")
    with pytest.raises(ParameterError, match="preset is 'best' but one of fast, balanced, high is needed"):
        denoise(color, preset="best")
