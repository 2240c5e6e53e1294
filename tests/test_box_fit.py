"""The guided fit over uniform windows, and the method around it, against the equations in float64."""

import inputs
import numpy as np
import oracle
import oracle_box_fit as theory
import pytest
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl import Frame, denoise
from mcdenoise_cl.methods import get_method
from mcdenoise_cl.stages.box_fit import box_fit

SIZES = [(1, 1), (1, 9), (7, 1), (3, 2), (13, 17), (24, 40)]
RIDGES = {"ridge": 0.02, "noise_ridge": 0.7, "floor": 1e-4}
WINDOWS = {"block": 2, "radius": 2, "residual_radius": 1}
EXACT = {"ridge": 0.0, "noise_ridge": 0.0, "floor": 1e-6}


def full_scene(height, width, seed=4):
    """Colour and features with the variances of their noise, and two half buffers."""
    scene = inputs.features(height, width, seed=seed)
    rng = np.random.default_rng(seed)
    for name in ("color", "albedo", "normal", "depth"):
        plane = scene[name]
        size = 0.02 * plane**2 + 0.002 if name == "color" else np.full_like(plane, 4e-4)
        scene[f"{name}_variance"] = (size * (0.7 + 0.6 * rng.random(plane.shape))).astype(np.float32)
    delta = (0.1 * scene["color"] * rng.standard_normal(scene["color"].shape)).astype(np.float32)
    scene["color_a"], scene["color_b"] = scene["color"] + delta, scene["color"] - delta
    return scene


def guides(scene, names):
    """The features side by side, (H, W, C), and a variance of theirs; None without any."""
    if not names:
        return None, None
    features = np.concatenate([np.atleast_3d(scene[name]) for name in names], axis=-1)
    return features, (0.01 * np.abs(features)).astype(np.float32)


def fit(engine, color, variance, features, noise, **options):
    planes = [to_planes(engine, image) for image in (color, variance)]
    sets = [[] if images is None else in_sets(engine, images) for images in (features, noise)]
    return to_array(engine, box_fit(engine, *planes, *sets, **options)[0])


def in_sets(engine, images):
    """Up to three sets of planes, as unequal as they can be."""
    cuts = [c for c in (1, 3) if c < images.shape[-1]]
    return [to_planes(engine, np.ascontiguousarray(part)) for part in np.split(images, cuts, axis=-1)]


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", inputs.KINDS)
@pytest.mark.parametrize("names", [("albedo", "normal", "depth"), ("normal",), ("depth",), ()], ids="+".join)
def test_box_fit(engine, kind, height, width, names):
    color = np.minimum(inputs.planes(kind, height, width, 3), 300)
    variance = (0.05 * color**2).astype(np.float32)
    features, noise = guides(inputs.features(height, width, seed=3), names)
    options = {**WINDOWS, **RIDGES, "relative": 2.0, "residual_noise": 1.0}
    out = fit(engine, color, variance, features, noise, **options)
    close(out, theory.box_fit(color, variance, features, noise, **options), tolerance=1e-4)


@pytest.mark.parametrize(
    ("block", "radius", "residual_radius"), [(1, 5, 2), (2, 0, 0), (3, 1, 1), (5, 2, 0), (8, 8, 4)]
)
@pytest.mark.parametrize("relative", [0.0, 1.5])
def test_box_fit_of_other_windows(engine, block, radius, residual_radius, relative):
    scene = full_scene(25, 43)
    features, noise = guides(scene, ("albedo", "depth"))
    options = {"block": block, "radius": radius, "residual_radius": residual_radius, "relative": relative, **RIDGES}
    out = fit(engine, scene["color"], scene["color_variance"], features, noise, **options, residual_noise=0.8)
    expected = theory.box_fit(scene["color"], scene["color_variance"], features, noise, **options, residual_noise=0.8)
    close(out, expected, tolerance=1e-4)


@pytest.mark.parametrize("radius", [0, 1, 2])
def test_windows_over_the_seams_of_tiles(engine, radius):
    """A work-item has its share of a row of blocks and of the rows; what its windows reach beyond is of others."""
    scene = full_scene(37, 301)
    features, noise = guides(scene, ("albedo", "normal", "depth"))
    options = {**WINDOWS, **RIDGES, "radius": radius, "relative": 2.0, "residual_noise": 1.0}
    given = scene["color"], scene["color_variance"], features, noise
    close(fit(engine, *given, **options), theory.box_fit(*given, **options), tolerance=1e-4)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 9), (3, 2), (9, 40), (41, 3), (24, 40)])
@pytest.mark.parametrize(("block", "radius"), [(2, 0), (2, 1), (2, 5), (2, 8), (1, 5), (8, 8)])
def test_windows_wider_than_the_image(engine, height, width, block, radius):
    """Up to 17 blocks wide: they are joined from pairs, and mirrored several times where the image has few."""
    scene = full_scene(height, width)
    features, noise = guides(scene, ("normal", "depth"))
    options = {"block": block, "radius": radius, "residual_radius": 1, "relative": 2.0, **RIDGES}
    given = scene["color"], scene["color_variance"], features, noise
    out = fit(engine, *given, **options, residual_noise=1.0)
    close(out, theory.box_fit(*given, **options, residual_noise=1.0), tolerance=1e-4)


def test_without_features_it_is_a_weighted_mean(engine):
    """Of all pixels of a window, and of the windows around; here over one block alone."""
    color = inputs.planes("uniform", 24, 40, 3)
    options = {"block": 4, "radius": 0, "residual_radius": 0, "relative": 2.0, **RIDGES, "residual_noise": 1e6}
    out = fit(engine, color, np.ones_like(color), None, None, **options)
    weight = theory.relative_weight(color, 2.0)[..., None]
    sums = (
        np.add.reduceat(np.add.reduceat(p, range(0, 24, 4), 0), range(0, 40, 4), 1) for p in (weight * color, weight)
    )
    means = np.divide(*sums)
    close(out, theory.upsampled(means, 24, 40, 4))


def test_a_small_ripple_on_a_large_offset_is_followed(engine):
    """Features are taken about a mean of their own, so that their spread survives float32."""
    rng = np.random.default_rng(0)
    ripple = (1e-2 * rng.standard_normal((24, 40, 1))).astype(np.float32)
    color = (2.0 + 30.0 * ripple * np.float32([1.0, -1.0, 0.5])).astype(np.float32)
    options = {**WINDOWS, **EXACT, "relative": 2.0, "residual_noise": 1.0}
    for offset in (0.0, 1.0, 10.0):
        feature = np.float32(offset) + ripple
        out = fit(engine, color, np.full_like(color, 9.0), feature, None, **options)
        expected = theory.box_fit(color, np.full_like(color, 9.0), feature, None, **options)
        close(out, expected, tolerance=1e-4)


def test_a_linear_function_of_the_features_is_reproduced(engine):
    """What an average cannot do: colour that is a ramp in the albedo comes out as it is, noise or not."""
    rng = np.random.default_rng(0)
    albedo = rng.random((30, 40, 3)).astype(np.float32)
    color = (0.2 + albedo @ np.float32([[1, 0, 0.2], [0.5, 1, 0], [0, 0.3, 1]])).astype(np.float32)
    options = {**WINDOWS, **EXACT, "relative": 2.0, "residual_noise": 1.0}
    out = fit(engine, color, np.ones_like(color), albedo, None, **options)
    assert np.abs(out - color).max() < 1e-3
    assert np.abs(oracle.box_mean(color, 4) - color).max() > 0.3


def test_the_residual_comes_back_where_noise_does_not_explain_it(engine):
    """A shadow that no feature shows: kept without noise, averaged away where the variance says it may be noise."""
    color = inputs.planes("textured", 24, 40, 3)
    options = {**WINDOWS, **RIDGES, "relative": 2.0}
    np.testing.assert_array_equal(fit(engine, color, 0 * color, None, None, **options, residual_noise=1.0), color)
    smooth = fit(engine, color, np.ones_like(color), None, None, **options, residual_noise=1.0)
    assert smooth.std() < 0.7 * color.std()


PARAMETERS = {**WINDOWS, **RIDGES, "relative": 2.0, "residual_noise": 1.0, "spread_radius": 6}
FEATURES = ("albedo", "normal", "depth", "albedo_variance", "normal_variance", "depth_variance")


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("prefiltered", [False, True])
@pytest.mark.parametrize(
    "names",
    [(*FEATURES, "color_variance"), FEATURES[:3], ("albedo", "color_a", "color_b"), ("depth", "depth_variance"), ()],
    ids=lambda names: "+".join(names) or "color alone",
)
def test_whole_method(height, width, prefiltered, names):
    scene = full_scene(height, width)
    given = {name: scene[name] for name in names}
    apart = {name: given[name] for name in ("color_variance", "color_a", "color_b") if name in given}
    expected = theory.denoise_guided(scene["color"], planes=given, prefiltered=prefiltered, **apart, **PARAMETERS)
    out = denoise(scene["color"], **given, method="guided", prefilter=prefiltered, **PARAMETERS)
    close(out, expected, tolerance=2e-4)


@pytest.mark.parametrize(("name", "image"), [(n, i) for n, i in inputs.images(3) if i.shape[0] < 30])
def test_whole_method_on_every_kind_of_image(name, image):
    scene = inputs.features(*image.shape[:2], seed=5)
    planes = {feature: scene[feature] for feature in ("albedo", "normal", "depth")}
    expected = theory.denoise_guided(image, planes=planes, **PARAMETERS)
    close(denoise(image, **planes, method="guided", **PARAMETERS), expected, tolerance=1e-4)


def test_without_outlier_handling():
    scene = full_scene(24, 40)
    planes = {name: scene[name] for name in FEATURES}
    variance = {"color_variance": scene["color_variance"]}
    out = denoise(scene["color"], **planes, **variance, method="guided", outliers=False, **PARAMETERS)
    expected = theory.denoise_guided(scene["color"], planes=planes, **variance, outlier_limit=None, **PARAMETERS)
    close(out, expected, tolerance=1e-4)


def test_every_plane_brings_the_result_closer_to_the_truth():
    truth = inputs.features(96, 128, noise=0.0)["color"]
    scene = inputs.features(96, 128)

    def error(image):
        return np.mean((image - truth) ** 2 / (truth**2 + 0.01))

    alone = error(denoise(scene["color"], method="guided"))
    with_features = error(denoise(Frame(**scene), method="guided"))
    assert with_features < 0.7 * alone < 0.5 * error(scene["color"])


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_exposure_does_not_matter(scale):
    scene = full_scene(24, 40)
    features = {name: scene[name] for name in FEATURES}
    scale = np.float32(scale)
    variance = scene["color_variance"]
    once = denoise(scene["color"], **features, color_variance=variance, method="guided")
    scaled = denoise(scene["color"] * scale, **features, color_variance=variance * scale**2, method="guided")
    close(scaled / scale, once, tolerance=1e-4)


@pytest.mark.parametrize("outliers", [False, True])
@pytest.mark.parametrize("least", [0.0, -0.1])
def test_only_a_negative_pixel_may_come_out_negative(least, outliers):
    scene = full_scene(40, 56)
    color = scene["color"] + np.float32(least)
    color[::7, ::5] = 0.0
    features = {name: scene[name] for name in FEATURES}
    given = {"ridge": 0.0, "noise_ridge": 0.0, "floor": 1e-6, "color_variance": scene["color_variance"]}
    out = denoise(color, **features, **given, method="guided", outliers=outliers)
    assert (out[color >= 0] >= 0).all()
    # What is spread over a pixel scales it by half as much again at most.
    assert (out >= (1.5 if outliers else 1.0) * 1.0001 * np.minimum(color, 0.0)).all()


def test_a_converged_frame_is_left_alone():
    """Noise at 1e-4 of the image's level: nothing may be lost to a filter."""
    truth = inputs.features(64, 96, noise=0.0)
    rng = np.random.default_rng(1)
    sigma = 1e-4 * truth["color"]
    color = (truth["color"] + sigma * rng.standard_normal(sigma.shape)).astype(np.float32)
    planes = {name: truth[name] for name in ("albedo", "normal", "depth")}
    clean = denoise(color, **planes, color_variance=sigma**2, method="guided", outliers=False)
    before, after = (np.mean((image - truth["color"]) ** 2) for image in (color, clean))
    assert after <= 1.05 * before


def test_its_parameters_are_described():
    method = get_method("guided")
    assert method.needs == () and {"albedo", "normal", "depth", "color_variance"} <= set(method.uses)
    assert all(info.meaning for info in method.parameters)
