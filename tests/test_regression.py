"""Regression and what stands around it, on the device against the equations in float64."""

import inputs
import numpy as np
import oracle
import oracle_auto
import oracle_regression as theory
import pytest
from test_stages import close
from transfer import scalars, to_array, to_planes

from mcdenoise_cl import Frame, denoise
from mcdenoise_cl.stages import variance
from mcdenoise_cl.stages.exposure import inverse_geometric_mean
from mcdenoise_cl.stages.prefilter import prefilter
from mcdenoise_cl.stages.regression import first_order_regression
from mcdenoise_cl.stages.terms import choose_terms

CASES = [pytest.param(image, id=name) for name, image in inputs.images(3)]
SIZES = [(1, 1), (1, 9), (7, 1), (3, 2), (13, 17), (24, 40)]
RIDGES = {"ridge": 0.03, "noise_ridge": 10.0, "position_ridge": 0.1}


def noise(image, seed=1):
    """A variance that varies, of the order of the image's own."""
    rng = np.random.default_rng(seed)
    return (0.02 * (0.5 + rng.random(image.shape)) * (image**2 + 0.05)).astype(np.float32)


@pytest.mark.parametrize("image", CASES)
def test_variances_and_maps(engine, image):
    other = np.roll(image, 1, 1) + np.float32(0.01)
    planes = to_planes(engine, image)
    halves = variance.variance_from_halves(engine, planes, to_planes(engine, other))
    close(to_array(engine, halves), theory.variance_from_halves(image, other))
    # On one row or column the mask cancels exactly; in float32, to the rounding of the image.
    scale = (np.abs(image).max()) ** 2
    close(to_array(engine, variance.variance_from_image(engine, planes)), theory.variance_from_image(image), scale)
    factor = engine.constant([0.7])
    close(to_array(engine, variance.scale(engine, planes, factor)), image * 0.7)
    scaled = to_planes(engine, np.where(other > 0.5, np.float32(0.7) * image, other))
    back = to_array(engine, variance.scale_back(engine, scaled, factor, planes))
    close(back, np.where(other > 0.5, image, other / 0.7))
    assert (back == image)[other > 0.5].all()
    close(to_array(engine, variance.clip(engine, planes, 0.1, 0.6)), np.clip(image, 0.1, 0.6))


@pytest.mark.parametrize(("height", "width"), inputs.SIZES)
@pytest.mark.parametrize("kind", inputs.KINDS)
def test_depth_feature(engine, kind, height, width):
    depth = inputs.planes(kind, height, width) * 100
    depth.flat[::3] = 0.0
    spread = noise(depth)
    planes = to_planes(engine, depth)
    scale = inverse_geometric_mean(engine, planes)
    positive = depth[depth > 0].astype(np.float64)
    expected = np.exp(-np.log(positive).mean()) if positive.size else 1.0
    assert scalars(engine, scale)[0] == pytest.approx(expected, rel=1e-5)
    feature, left = theory.depth_feature(depth, spread)
    close(to_array(engine, variance.depth_feature(engine, planes, scale)), feature, scale=1.0)
    got = variance.depth_feature_variance(engine, planes, to_planes(engine, spread), scale)
    close(to_array(engine, got), left)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("channels", [None, 3])
def test_prefilter(engine, height, width, channels):
    scene = inputs.features(height, width, seed=2)
    feature = scene["normal"] if channels else scene["depth"]
    spread = np.full_like(feature, 0.003) * (1 + np.random.default_rng(0).random(feature.shape).astype("f4"))
    out, left = prefilter(engine, to_planes(engine, feature), to_planes(engine, spread))
    expected, expected_left = theory.prefilter(feature, spread)
    close(to_array(engine, out), expected, tolerance=2e-5)
    close(to_array(engine, left), expected_left, tolerance=2e-5)


@pytest.mark.parametrize(
    ("dx", "dy", "seen"), [(3, 1, True), (-1, 3, True), (3, 2, False), (-2, -3, False), (4, 0, False)]
)
def test_the_window_of_the_prefilter_is_a_disc(engine, dx, dy, seen):
    """Offset (2, 0) belongs to it, (2, 1) does not; one pixel's variance counts in those beside it."""
    spread = np.full((9, 9), 0.01, np.float32)
    spread[4 + dy, 4 + dx] = 0.5
    _, left = prefilter(engine, to_planes(engine, np.full((9, 9), 0.4)), to_planes(engine, spread))
    assert (abs(to_array(engine, left)[4, 4] - 0.01 / 13) > 1e-4) == seen


def both_regressions(engine, color, spread, features, left, fitted, *, search, patch, stride, bandwidth, ridges):
    """Fits of the window and of its middle, by the device and by the equations."""
    terms = None
    if features is not None:
        terms = choose_terms(engine, to_planes(engine, features), to_planes(engine, left), search * stride)
    window = {"search_radius": search, "patch_radius": patch, "stride": stride}
    got = first_order_regression(
        engine,
        to_planes(engine, color),
        to_planes(engine, spread.sum(-1)),
        terms,
        to_planes(engine, fitted),
        **window,
        bandwidth=bandwidth,
        with_inner=True,
        **ridges,
    )
    expected = theory.first_order_regression(color, spread, features, left, fitted, **window, k=bandwidth, **ridges)
    return [to_array(engine, planes) for planes in got], expected


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize(
    ("search", "patch", "stride", "names"),
    [(2, 1, 1, ("albedo", "normal")), (4, 2, 1, ("normal",)), (3, 0, 1, ()), (3, 1, 3, ("albedo", "normal"))],
)
def test_first_order_regression(engine, kind, height, width, search, patch, stride, names):
    color = np.minimum(inputs.planes(kind, height, width, 3), 20)
    spread = noise(color)
    difference = 0.1 * (inputs.planes("uniform", height, width, 1, seed=5) - 0.5)
    scene = inputs.features(height, width, seed=3)
    features = left = None
    if names:
        features = np.concatenate([scene[name] for name in names], axis=-1)
        left = 0.01 * np.abs(features)
    fitted = np.concatenate([color, difference], axis=-1)
    window = {"search": search, "patch": patch, "stride": stride, "bandwidth": 0.8, "ridges": RIDGES}
    got, expected = both_regressions(engine, color, spread, features, left, fitted, **window)
    for one, other in zip(got, expected, strict=True):
        # The normal equations are solved in float32; their condition multiplies its rounding.
        close(one, other, tolerance=1e-4)


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize(
    ("dx", "dy", "whole", "inner"),
    [
        (4, 2, True, False),
        (-2, 4, True, False),
        (4, 3, False, False),
        (-3, -4, False, False),
        (4, 4, False, False),
        (3, 3, True, False),
        (-1, 2, True, True),
        (2, -2, True, False),
        (0, -2, True, True),
    ],
)
def test_a_pixel_counts_in_the_disc_and_not_just_outside(engine, stride, dx, dy, whole, inner):
    """Radius 4 with its middle of radius 2: 4² + 2² is at most 4 · 5, 4² + 3² is not; 1² + 2² at most 2 · 3."""
    size = (8 * stride + 1, 8 * stride + 1, 3)
    color = np.ones(size, np.float32)
    color[(4 + dy) * stride, (4 + dx) * stride] = 100
    window = {"search": 4, "patch": 0, "stride": stride, "bandwidth": 1.0, "ridges": RIDGES}
    got, _ = both_regressions(engine, 0 * color, np.ones_like(color), None, None, color, **window)
    for fit, seen in zip(got, (whole, inner), strict=True):
        assert (abs(fit[4 * stride, 4 * stride, 0] - 1) > 0.1) == seen
        assert seen or abs(fit[4 * stride, 4 * stride, 0] - 1) < 1e-4


def test_differences_in_the_dark_are_seen_where_the_noise_is_small(engine):
    """A ten-thousandth of the usual brightness, everything alike: a variance of 1e-11 is not nothing."""
    color = np.float32(1e-4) * inputs.planes("textured", 13, 17, 3)
    color += np.float32(1e-6) * inputs.planes("uniform", 13, 17, 3)
    spread = np.full_like(color, 1e-11)
    window = {"search": 3, "patch": 1, "stride": 1, "bandwidth": 0.8, "ridges": RIDGES}
    got, expected = both_regressions(engine, color, spread, None, None, color, **window)
    for one, other in zip(got, expected, strict=True):
        close(one, other, tolerance=1e-4)
    bright, _ = both_regressions(engine, 1e4 * color, 1e8 * spread, None, None, 1e4 * color, **window)
    close(1e4 * got[0], bright[0], tolerance=0.02)


@pytest.mark.parametrize("offset", [0.0, 0.9])
def test_a_texture_of_little_contrast_is_told_apart_beside_a_strong_edge(engine, offset):
    """Moments are taken about the block's mean: what cancels must be small against what a dark texture varies by."""
    rng = np.random.default_rng(1)
    features = np.repeat((0.02 + 0.01 * rng.random((24, 40, 1))), 3, axis=-1).astype(np.float32)
    features[:, 30:] += np.float32(offset)
    color = (features * 5).astype(np.float32)
    spread = np.full_like(color, 0.01)
    ridges = {"ridge": 1e-3, "noise_ridge": 0.0, "position_ridge": 0.1}
    window = {"search": 4, "patch": 1, "stride": 1, "bandwidth": 1.0, "ridges": ridges}
    got, expected = both_regressions(engine, color, spread, features, 0 * features, color, **window)
    np.testing.assert_allclose(got[0], expected[0], rtol=5e-4)
    assert np.abs(got[0] - color)[:, :20].max() < 0.3 * np.ptp(color[:, :20])


def test_a_linear_function_of_the_features_is_reproduced(engine):
    """What an average cannot do: colour that is a ramp in the albedo comes out as it is, noise or not."""
    rng = np.random.default_rng(0)
    albedo = rng.random((30, 40, 3)).astype(np.float32)
    color = (0.2 + albedo @ np.float32([[1, 0, 0.2], [0.5, 1, 0], [0, 0.3, 1]])).astype(np.float32)
    tiny = {"ridge": 1e-4, "noise_ridge": 0.0, "position_ridge": 0.1}
    window = {"search": 4, "patch": 2, "stride": 1, "bandwidth": 1.0, "ridges": tiny}
    got, _ = both_regressions(engine, color, np.full_like(color, 0.2), albedo, 0 * albedo, color, **window)
    assert np.abs(got[0] - color).max() < 2e-3
    assert np.abs(oracle.box_mean(color, 4) - color).max() > 0.3


PARAMETERS = {"search_radius": 3, "patch_radius": 1, "bandwidth": 0.8, **RIDGES, "spread_radius": 6}
FULL = ("albedo", "normal", "depth", "albedo_variance", "normal_variance", "depth_variance", "color_variance")


def full_scene(height, width):
    scene = inputs.features(height, width, seed=4)
    rng = np.random.default_rng(4)
    for name in ("color", "albedo", "normal", "depth"):
        plane = scene[name]
        size = 0.02 * plane**2 + 0.002 if name == "color" else np.full_like(plane, 4e-4)
        scene[f"{name}_variance"] = (size * (0.7 + 0.6 * rng.random(plane.shape))).astype(np.float32)
    delta = (0.1 * scene["color"] * rng.standard_normal(scene["color"].shape)).astype(np.float32)
    scene["color_a"], scene["color_b"] = scene["color"] + delta, scene["color"] - delta
    return scene


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize(
    "names",
    [FULL, FULL[:3], ("color_a", "color_b"), ("albedo", "color_a", "color_b"), ("depth", "depth_variance"), ()],
    ids=lambda names: "+".join(names) or "color alone",
)
def test_whole_method(height, width, names):
    scene = full_scene(height, width)
    planes = {name: scene[name] for name in names}
    expected = oracle_auto.denoise_regression(scene["color"], planes, **PARAMETERS)
    close(denoise(scene["color"], **planes, method="regression", **PARAMETERS), expected, tolerance=2e-4)


def test_without_outlier_handling():
    scene = full_scene(24, 40)
    color = scene["color"]
    planes = {"color_variance": scene["color_variance"]}
    expected = oracle_auto.denoise_regression(color, planes, **PARAMETERS, outlier_limit=None)
    given = {"color_variance": scene["color_variance"], "method": "regression"}
    close(denoise(color, **given, **PARAMETERS, outliers=False), expected, tolerance=2e-4)


def test_every_plane_brings_the_result_closer_to_the_truth():
    truth = inputs.features(96, 128, noise=0.0)["color"]
    scene = inputs.features(96, 128)

    def error(image):
        return np.mean((image - truth) ** 2 / (truth**2 + 0.01))

    alone = error(denoise(scene["color"], method="regression"))
    with_features = error(denoise(Frame(**scene), method="regression"))
    assert with_features < 0.5 * alone < 0.25 * error(scene["color"])


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_exposure_does_not_matter(scale):
    scene = full_scene(24, 40)
    names = ("albedo", "normal", "depth", "albedo_variance", "normal_variance", "depth_variance")
    features = {name: scene[name] for name in names}
    scale = np.float32(scale)
    once = denoise(scene["color"], **features, color_variance=scene["color_variance"], method="regression")
    scaled = denoise(
        scene["color"] * scale, **features, color_variance=scene["color_variance"] * scale**2, method="regression"
    )
    close(scaled / scale, once, tolerance=1e-4)


def test_a_converged_frame_is_left_alone():
    """Noise at 1e-4 of the image's level: nothing may be lost to a filter."""
    truth = inputs.features(64, 96, noise=0.0)
    rng = np.random.default_rng(1)
    sigma = 1e-4 * truth["color"]
    color = (truth["color"] + sigma * rng.standard_normal(sigma.shape)).astype(np.float32)
    planes = {name: truth[name] for name in ("albedo", "normal", "depth")}
    clean = denoise(color, **planes, color_variance=sigma**2, method="regression", outliers=False)
    before, after = (np.mean((image - truth["color"]) ** 2) for image in (color, clean))
    assert after <= before
