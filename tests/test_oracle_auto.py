"""Checks the methods of `oracle_auto` against loops, SciPy, statistics, and scenes whose truth is known."""

from __future__ import annotations

from itertools import product

import numpy as np
import oracle
import oracle_auto as ora
import oracle_regression
import pytest
import scipy.ndimage
import scipy.stats
from inputs import SIZES, features, planes
from test_oracle import assert_close
from test_oracle_regression import (
    RIDGES,
    loop_image_variance,
    loop_mean,
    loop_outliers,
    loop_prefilter,
    loop_regression,
)

WINDOWS = {"search_radius": 2, "patch_radius": 1, "bandwidth": 0.8}
SMALL = WINDOWS | RIDGES

#: The defaults of both methods.
FIRST = {"search_radius": 7, "patch_radius": 2, "bandwidth": 0.72}
FIRST |= {"ridge": 0.02, "noise_ridge": 5.0, "position_ridge": 0.1}
WIDE = {"wide_radius": 3, "wide_stride": 3, "wide_bandwidth": 1.8}
CHOICE = {"tracking": 0.01, "doubt": 0.42, "caution": 0.1, "keep": 0.05, "limit": 1.0, "smoothing_radius": 4}
CHOICE |= {"apart": 1.0}
AUTO = FIRST | WIDE | CHOICE


def scene_of(height: int, width: int, seed: int = 0, noise: float = 1.0) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Colour and features in float64."""
    scene = {name: np.float64(plane) for name, plane in features(height, width, seed, noise).items()}
    return scene.pop("color"), scene


def halved_scene(height: int, width: int, seed: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """What a renderer gives: the truth, the mean of two halves, and features, variances and both halves."""
    truth, _ = scene_of(height, width, noise=0.0)
    (a, f), (b, g) = (scene_of(height, width, seed=s) for s in (2 * seed + 1, 2 * seed + 2))
    given = {"color_a": a, "color_b": b}
    for name in f:
        given |= {name: (f[name] + g[name]) / 2, f"{name}_variance": (f[name] - g[name]) ** 2 / 4}
    return truth, (a + b) / 2, given


def relative_error(image: np.ndarray, truth: np.ndarray) -> float:
    return np.mean((image - truth) ** 2 / (truth**2 + 0.01))


# --- Regression -------------------------------------------------------------------------------------------


def loop_denoise(color, e, variance, parts, limit, significant, spread_radius, *, bandwidth, **options) -> np.ndarray:
    """The steps in order, from loops; `variance` that of e · color, `parts` pairs of a feature and its variance."""
    c = e * np.float64(color)
    kept, factor = (c, np.ones(c.shape[:2])) if limit is None else loop_outliers(c, limit, variance, *significant)
    square = loop_mean(loop_mean(oracle.luminance(kept)[..., None], 1), 1) ** 2 + 1e-3
    variance = loop_mean(variance * factor[..., None] ** 2 / square, 2) * square
    pairs = [(p, np.zeros(p.shape)) if v is None else loop_prefilter(p, v, 2, 1) for p, v in parts]
    plane = np.concatenate([np.zeros((*c.shape[:2], 0)), *(p for p, _ in pairs)], axis=-1)
    noise = np.concatenate([np.zeros((*c.shape[:2], 0)), *(v for _, v in pairs)], axis=-1)
    out, _ = loop_regression(kept, variance, plane, noise, kept, k=bandwidth, **options)
    return (out if limit is None else oracle_regression.spread_removed(out, c - kept, spread_radius)) / e


@pytest.mark.parametrize("limit", [None, 1.5])
@pytest.mark.parametrize("noise", ["image", "halves", "given", "all"])
def test_regression_matches_the_loops(noise, limit):
    size = (6, 7)
    color, scene = scene_of(*size)
    color[2, 3] *= 50.0
    color[4, 1] *= 20.0
    scene["albedo"] *= 1.5
    e = 0.18 / scipy.stats.gmean(oracle.luminance(color).ravel())
    given = {}
    variances = dict.fromkeys(("albedo", "normal", "depth"))
    if noise == "image":
        variance = loop_image_variance(e * color)
    elif noise == "halves":
        half = 0.3 * color * np.float64(planes("uniform", *size, 3))
        given = {"color_a": color + half, "color_b": color - half}
        variance = (e * half) ** 2
    else:
        given["color_variance"] = 0.1 * color**2
        given["color_variance"][4, 1] = 1e-6  # a small light, not an outlier
        variance = e**2 * given["color_variance"]
        # Halves give way to a variance.
        given |= {"color_a": color, "color_b": 2.0 * color}
    if noise == "all":
        variances["albedo"] = 4e-4 * (1.0 + np.float64(planes("uniform", *size, 3)))
        variances["normal"] = 2e-3 * (1.0 + np.float64(planes("uniform", *size, 3, seed=1)))
        variances["depth"] = 0.01 * (1.0 + np.float64(planes("uniform", *size, seed=2)))
    given |= {f"{name}_variance": v for name, v in variances.items() if v is not None}

    scale = scipy.stats.gmean(scene["depth"].ravel())
    z = scene["depth"]
    parts = [
        (np.clip(scene["albedo"], 0.0, 1.0), variances["albedo"]),
        (scene["normal"], variances["normal"]),
        ((z / (z + scale) - 0.5)[..., None], None),
    ]
    if noise == "all":
        parts[2] = (parts[2][0], (variances["depth"] * scale**2 / (z + scale) ** 4)[..., None])
    denoised = ora.denoise_regression(color, scene | given, **SMALL, outlier_limit=limit, spread_radius=3)
    significant = {"image": (np.inf, True), "halves": (3.0, True)}.get(noise, (3.0, False))
    assert_close(denoised, loop_denoise(color, e, variance, parts, limit, significant, 3, **SMALL), 1e-8)


@pytest.mark.parametrize("size", SIZES)
def test_regression_takes_any_size_and_set_of_features(size):
    color, scene = scene_of(*size)
    for names in ((), ("albedo",), ("normal", "depth"), tuple(scene)):
        denoised = ora.denoise_regression(color, {name: scene[name] for name in names}, **SMALL)
        assert denoised.shape == color.shape and np.isfinite(denoised).all()


def test_regression_keeps_a_constant_and_follows_the_exposure():
    constant = np.full((9, 8, 3), (0.2, 0.5, 1.5))
    np.testing.assert_allclose(ora.denoise_regression(constant, {}, **SMALL), constant, rtol=1e-9)
    color, scene = scene_of(9, 8)
    one = ora.denoise_regression(color, scene, **SMALL)
    assert_close(ora.denoise_regression(1000.0 * color, scene, **SMALL) / 1000.0, one, 1e-9)
    set_by_hand = ora.denoise_regression(color, scene, **SMALL, exposure=oracle.auto_exposure(color))
    assert np.array_equal(set_by_hand, one)
    defaults = {"outlier_limit": 1.1, "spread_radius": 50, "exposure": None}
    assert np.array_equal(ora.denoise_regression(color, scene, **SMALL, **defaults), one)
    # The image's own noise sets the distances, so that the exposure acts only beside the constant 1e-12.
    other = ora.denoise_regression(color, scene, **SMALL, exposure=1e-4)
    assert np.abs(other - one).max() > 1e-3


def test_regression_removes_noise_and_fireflies_and_keeps_the_light():
    (color, scene), (truth, _) = scene_of(31, 64), scene_of(31, 64, noise=0.0)
    options = {"search_radius": 4, "patch_radius": 2, "bandwidth": 0.7} | RIDGES
    with_features = ora.denoise_regression(color, scene, **options)
    without_limit = ora.denoise_regression(color, scene, **options, outlier_limit=None)
    error, alone = (relative_error(i, truth) for i in (with_features, ora.denoise_regression(color, {}, **options)))
    assert error < 0.05 * relative_error(color, truth)
    assert error < alone < relative_error(color, truth)
    assert error < relative_error(without_limit, truth)
    np.testing.assert_allclose(with_features.mean(), color.mean(), rtol=0.05)


# --- Halves -----------------------------------------------------------------------------------------------


def test_normal_numbers_are_normal_and_independent():
    """Within four standard errors, of 60000 numbers."""
    field = ora.normal_numbers(200, 300)
    error = 4.0 / np.sqrt(field.size)
    assert field.shape == (200, 300) and np.isfinite(field).all()
    assert abs(field.mean()) < error
    assert abs(field.var() - 1.0) < np.sqrt(2.0) * error
    assert abs(scipy.stats.skew(field.ravel())) < np.sqrt(6.0) * error
    assert abs(scipy.stats.kurtosis(field.ravel())) < np.sqrt(24.0) * error
    assert scipy.stats.kstest(field.ravel(), "norm").pvalue > 1e-3
    padded = field - field.mean()
    for dy, dx in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (0, 3), (3, 0), (3, 3), (0, 8), (8, 0)):
        one, other = padded[dy:, dx:], padded[: 200 - dy, : 300 - dx]
        assert abs((one * other).mean()) < error
        # Nor does the size of one number tell that of the other.
        assert abs(((one**2 - 1.0) * (other**2 - 1.0)).mean()) < 2.0 * error
    # No row and no column leans to one side.
    assert np.abs(field.mean(axis=1)).max() < 4.5 / np.sqrt(300)
    assert np.abs(field.mean(axis=0)).max() < 4.5 / np.sqrt(200)


def test_normal_numbers_depend_on_the_coordinates_alone():
    field = ora.normal_numbers(20, 300)

    def scrambled(v: int) -> int:
        v = ((v ^ (v >> 16)) * 0x7FEB352D) % 2**32
        v = ((v ^ (v >> 15)) * 0x846CA68B) % 2**32
        return v ^ (v >> 16)

    for y, x in ((0, 0), (0, 1), (1, 0), (19, 299), (7, 128)):
        assert ora.normal_numbers(y + 1, x + 1)[y, x] == field[y, x]
        one = scrambled(2 * (65536 * y + x) + 1)
        two = scrambled((one + 0x9E3779B9) % 2**32)
        radius = np.sqrt(-2.0 * np.log(((one >> 8) + 0.5) / 2**24))
        np.testing.assert_allclose(field[y, x], radius * np.cos(2.0 * np.pi * ((two >> 8) + 0.5) / 2**24), rtol=1e-9)


@pytest.mark.parametrize("exposure", [None, 3.0])
@pytest.mark.parametrize("limit", [None, 1.0])
def test_half_difference_of_real_halves_gives_them_back(limit, exposure):
    a, b = (np.float64(planes("hdr", 9, 11, 3, seed=s)) for s in (0, 1))
    given = {"color_a": a, "color_b": b, "color_variance": np.ones(a.shape)}
    f = ora.prepare((a + b) / 2, given, limit, exposure)
    d = ora.half_difference(f, given)
    level = oracle.luminance(f.color)
    for half, expected in ((level + d, a), (level - d, b)):
        assert_close(half, f.factor * f.exposure * oracle.luminance(expected), 1e-12)
    assert (f.factor.min() < 0.5) == (limit is not None)


def test_half_difference_made_up_has_the_variance_of_the_luminance():
    """Of noise that the channels share: here it scales the colour, as the throughput of a path does."""
    rng = np.random.default_rng(0)
    truth = np.array([0.2, 0.5, 1.5]) * (1.0 + np.arange(120)[:, None] / 100.0) * np.ones((100, 1, 1))
    color = truth * (1.0 + 0.2 * rng.standard_normal((100, 120, 1)))
    spread = ((oracle.luminance(color) - oracle.luminance(truth)) ** 2).mean()
    given = {"color_variance": (0.2 * truth) ** 2}
    f = ora.prepare(color, given, None, 1.0)
    d = ora.half_difference(f, given)
    expected = ora.luminance_deviation(given["color_variance"]) ** 2
    np.testing.assert_allclose(expected, (0.2 * oracle.luminance(truth)) ** 2, rtol=1e-12)
    np.testing.assert_allclose((d**2).mean(), expected.mean(), rtol=0.05)
    np.testing.assert_allclose((d**2).mean(), spread, rtol=0.06)
    assert abs(np.corrcoef(d.ravel(), (color - truth)[..., 1].ravel())[0, 1]) < 0.04
    # Estimated from the image it is about the same; a pixel alone says little, so that the smoothed one is taken.
    f = ora.prepare(color, {}, None, 1.0)
    np.testing.assert_allclose((ora.half_difference(f, {}) ** 2).mean(), spread, rtol=0.1)
    np.testing.assert_allclose(
        ora.half_difference(f, {}), ora.normal_numbers(100, 120) * ora.luminance_deviation(f.variance), rtol=1e-12
    )
    # What was taken from an outlier is missing from its noise.
    f = ora.prepare(color, given, 1.0, 2.0)
    factor = 2.0 * f.factor
    assert factor.min() < 1.9
    assert_close(ora.half_difference(f, given), factor * d, 1e-12)


def test_luminance_deviation_takes_no_negative_variance():
    deviation = ora.luminance_deviation(np.array([[[-1.0, 4.0, 0.0], [1.0, 1.0, 1.0]]]))
    np.testing.assert_allclose(deviation, [[2.0 * 0.7152, 1.0]], rtol=1e-12)


# --- Auto -------------------------------------------------------------------------------------------------


def check(color: np.ndarray, result: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    image, shares, error = result
    assert image.shape == color.shape and np.isfinite(image).all()
    assert shares.shape == (4, *color.shape[:2]) and error.shape == color.shape[:2]
    assert (shares >= 0.0).all() and (shares <= 1.0).all()
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-12)
    assert np.isfinite(error).all() and (error >= 0.0).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 2)])
def test_auto_takes_any_size_and_set_of_planes(size):
    _, color, given = halved_scene(*size, seed=0)
    halves = {name: given[name] for name in ("color_a", "color_b")}
    noises = {}, halves, {"color_variance": (halves["color_a"] - halves["color_b"]) ** 2 / 4}
    options = AUTO | {"search_radius": 3, "wide_radius": 2}
    for count, (noise, variances) in product(range(8), zip(noises, (False, True, True), strict=True)):
        names = [name for bit, name in enumerate(("albedo", "normal", "depth")) if count >> bit & 1]
        names += [f"{name}_variance" for name in names if variances]
        check(color, ora.denoise_auto(color, noise | {name: given[name] for name in names}, **options))
    for strange in (0.0 * color, -color):
        check(strange, ora.denoise_auto(strange, given, **options))


@pytest.mark.parametrize("limit", [None, 1.0])
def test_auto_is_the_mix_of_its_candidates(limit):
    _, color, given = halved_scene(24, 40, seed=0)
    options = AUTO | {"search_radius": 4, "outlier_limit": limit, "spread_radius": 6}
    image, shares, error = ora.denoise_auto(color, given, **options)
    check(color, (image, shares, error))
    f = ora.prepare(color, given, limit, None)
    noisy = np.concatenate([f.color, ora.half_difference(f, given)[..., None]], axis=-1)
    ridges = {name: AUTO[name] for name in ("ridge", "noise_ridge", "position_ridge")}
    window = {"search_radius": 4, "patch_radius": 2, "k": 0.72}
    (first, narrow), (own_terms, _) = (
        oracle_regression.first_order_regression(
            f.color, f.variance, f.features, f.noise, noisy, **window, **ridges, terms_reach=reach
        )
        for reach in (9, 4)  # what the wider of both passes sees, three steps of three pixels; and the first alone
    )
    window = {"search_radius": 3, "patch_radius": 1, "stride": 3, "k": 1.8}
    wide = oracle_regression.second_pass(first, f.features, f.noise, **window, **ridges, terms_reach=9)
    own, *filtered = shares
    mix = sum(s[..., None] * part[..., :3] for s, part in zip(filtered, (narrow, first, wide), strict=True))
    # The light of the outliers is given to what is filtered; the input has it where it was. No part is all input.
    assert own.max() < 0.999
    mix /= (1.0 - own)[..., None]
    if limit is not None:
        mix = oracle_regression.spread_removed(mix, f.removed, 6)
    mix = (1.0 - own)[..., None] * mix + own[..., None] * f.exposure * color
    assert_close(image, mix / f.exposure, 1e-12)
    # Every filter is of use somewhere; and with nothing but the first pass it is `regression`.
    assert (shares[1:].max(axis=(1, 2)) > (0.05, 0.3, 0.3)).all()
    regression = {name: options[name] for name in (*FIRST, "outlier_limit", "spread_radius")}
    alone = ora.denoise_regression(color, given, **regression)
    assert not np.allclose(own_terms, first, rtol=1e-3)
    only = oracle_regression.spread_removed(own_terms[..., :3], f.removed, 6) if limit else own_terms[..., :3]
    assert_close(alone, only / f.exposure, 1e-12)


def test_auto_gives_a_noise_free_frame_back():
    truth, scene = scene_of(24, 40, noise=0.0)
    options = AUTO | {"search_radius": 4}
    none = {"color_variance": np.zeros(truth.shape)}
    halves = {"color_a": truth, "color_b": truth}
    for given, limit in ((none, None), (scene | none, 1.0), (scene | halves, 1.0), (halves, None)):
        image, shares, error = ora.denoise_auto(truth, given, **options, outlier_limit=limit)
        check(truth, (image, shares, error))
        np.testing.assert_allclose(image, truth, atol=1e-3)
        assert error.max() < 1e-6
    # Where nothing tells a light from a firefly, the highlights of one pixel go with the outliers.
    peaks = {True: [], False: []}
    for given in (none, halves, {}):
        kept = ora.prepare(truth, given, 1.0, 1.0).color
        peaks[bool(given)].append(np.array_equal(kept, truth))
    assert peaks == {True: [True, True], False: [False]}


def test_auto_keeps_the_input_where_filters_destroy_it():
    """Equal halves show a texture to be no noise, whatever its variance says; halves that differ show noise."""
    rng = np.random.default_rng(0)
    texture = 0.5 * (1.0 + 0.2 * rng.standard_normal((24, 40, 1))) * np.ones(3)
    given = {"color_variance": np.full(texture.shape, 0.1**2)}
    image, shares, _ = ora.denoise_auto(
        texture, given | {"color_a": texture, "color_b": texture}, **AUTO, outlier_limit=None
    )
    blurred = ora.denoise_regression(texture, given, **FIRST, outlier_limit=None)
    assert shares[0].mean() > 0.6
    assert ((image - texture) ** 2).mean() < 0.2 * ((blurred - texture) ** 2).mean()
    flat = 0.5 + 0.1 * np.sqrt(2.0) * rng.standard_normal((2, 24, 40, 1)) * np.ones(3)
    image, shares, _ = ora.denoise_auto(
        flat.mean(axis=0), given | {"color_a": flat[0], "color_b": flat[1]}, **AUTO, outlier_limit=None
    )
    assert shares[0].mean() < 0.05
    assert ((image - 0.5) ** 2).mean() < 0.1 * 0.1**2


@pytest.mark.parametrize("seed", range(2))
def test_auto_is_better_than_regression(seed):
    truth, color, given = halved_scene(24, 40, seed)
    result = ora.denoise_auto(color, given, **AUTO)
    check(color, result)
    error, before = relative_error(result[0], truth), relative_error(color, truth)
    single = relative_error(ora.denoise_regression(color, given, **FIRST), truth)
    assert error < 1.02 * single and error < 0.25 * before
    # Without anything known of the noise, but without fireflies.
    noise = np.random.default_rng(seed).gamma(20.0, 1.0 / 20.0, (24, 40, 1))
    scene = {name: given[name] for name in ("albedo", "normal", "depth")}
    image, _, _ = ora.denoise_auto(truth * noise, scene, **AUTO)
    single = relative_error(ora.denoise_regression(truth * noise, scene, **FIRST), truth)
    assert relative_error(image, truth) < 1.1 * single


def test_auto_follows_the_exposure_and_has_the_defaults_of_regression():
    _, color, given = halved_scene(13, 17, seed=0)
    options = AUTO | {"search_radius": 3}
    one = ora.denoise_auto(color, given, **options)
    bright = given | {name: 1000.0 * given[name] for name in ("color_a", "color_b")}
    image, shares, error = ora.denoise_auto(1000.0 * color, bright, **options)
    assert_close(image / 1000.0, one[0], 1e-7)
    assert_close(shares, one[1], 1e-6)
    assert_close(error, one[2], 1e-7)
    defaults = {"outlier_limit": 1.1, "spread_radius": 50, "exposure": oracle.auto_exposure(color)}
    for result, expected in zip(ora.denoise_auto(color, given, **options, **defaults), one, strict=True):
        assert np.array_equal(result, expected)
