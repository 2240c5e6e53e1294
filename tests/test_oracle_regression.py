"""Checks the oracle of `regression` against loops over pixels, NumPy's least squares, SciPy, and statistics."""

from __future__ import annotations

import numpy as np
import oracle
import oracle_regression as ora
import pytest
import scipy.ndimage
import scipy.stats
from inputs import KINDS, SIZES, features, planes
from test_oracle import assert_close

#: (height, width) for loops over pixels: one pixel, one row, one column, smaller than a window, and one of odd size.
SMALL = ((1, 1), (1, 9), (7, 1), (3, 2), (6, 7))
OFFSETS = ((0, 0), (1, 0), (-2, 1), (3, -3), (-9, 7))
RIDGES = {"ridge": 1e-3, "noise_ridge": 0.5, "position_ridge": 1e-2}
WINDOWS = {"search_radius": 2, "patch_radius": 1, "k": 0.8}


# --- Another way ------------------------------------------------------------------------------------------


def mirror(i: int, n: int) -> int:
    """Walk back and forth between the first and the last pixel until `i` is inside."""
    while n > 1 and not 0 <= i < n:
        i = -i if i < 0 else 2 * (n - 1) - i
    return i if n > 1 else 0


def at(image: np.ndarray, y: int, x: int) -> np.ndarray:
    return np.float64(image[mirror(y, image.shape[0]), mirror(x, image.shape[1])])


def window(radius: int) -> list[tuple[int, int]]:
    return [(dy, dx) for dy in range(-radius, radius + 1) for dx in range(-radius, radius + 1)]


def loop_mean(image: np.ndarray, radius: int) -> np.ndarray:
    out = np.zeros(image.shape)
    for y, x in np.ndindex(image.shape[:2]):
        out[y, x] = np.mean([at(image, y + dy, x + dx) for dy, dx in window(radius)], axis=0)
    return out


def loop_outliers(color: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    scaled, factor = color.astype(np.float64), np.ones(color.shape[:2])
    for y, x in np.ndindex(factor.shape):
        around = [max(at(color, y + dy, x + dx)) for dy, dx in window(1) if (dy, dx) != (0, 0)]
        largest, bound = float(max(color[y, x])), limit * max(*around, 0.0)
        if largest > bound:
            factor[y, x] = bound / largest
            scaled[y, x] *= factor[y, x]
    return scaled, factor


def loop_image_variance(color: np.ndarray) -> np.ndarray:
    out = np.zeros(color.shape)
    for y, x in np.ndindex(color.shape[:2]):
        response = 0.0
        for dy, dx in window(1):
            response = response + (-2.0) ** ((dy == 0) + (dx == 0)) * at(color, y + dy, x + dx)
        out[y, x] = response**2 / 36.0
    return out


def loop_distance(color, variance, y: int, x: int, dy: int, dx: int, patch_radius: int) -> float:
    terms = []
    for py, px in window(patch_radius):
        first, second = at(color, y + py, x + px), at(color, y + py + dy, x + px + dx)
        v, u = at(variance, y + py, x + px), at(variance, y + py + dy, x + px + dx)
        for a, b, va, vb in zip(*map(np.atleast_1d, (first, second, v, u)), strict=True):
            terms.append(((a - b) ** 2 - (va + min(va, vb))) / (va + vb + 1e-8))
    return max(sum(terms) / len(terms), 0.0)


def loop_prefilter(feature, variance, search_radius: int, patch_radius: int) -> tuple[np.ndarray, np.ndarray]:
    v = loop_mean(np.minimum(np.float64(variance), 1.0), 1)
    filtered, left = np.zeros(feature.shape), np.zeros(feature.shape)
    for y, x in np.ndindex(feature.shape[:2]):
        w = {o: np.exp(-loop_distance(feature, v, y, x, *o, patch_radius)) for o in window(search_radius)}
        total = sum(w.values())
        filtered[y, x] = sum(w[dy, dx] / total * at(feature, y + dy, x + dx) for dy, dx in w)
        left[y, x] = sum((w[dy, dx] / total) ** 2 * at(v, y + dy, x + dx) for dy, dx in w)
    return filtered, left


def loop_regression(
    guide, variance, plane, noise, color, *, search_radius, patch_radius, k, ridge, noise_ridge, position_ridge
) -> np.ndarray:
    """Ridges as rows of a weighted least-squares problem; the value at the pixel is the constant term."""
    out = np.zeros(color.shape)
    span = max(search_radius, 1)
    for y, x in np.ndindex(color.shape[:2]):
        rows, targets, weights = [], [], []
        for dy, dx in window(search_radius):
            wide, narrow = (loop_distance(guide, variance, y, x, dy, dx, r) for r in (patch_radius, patch_radius // 2))
            weights.append((np.exp(-wide / k**2) + np.exp(-narrow / k**2)) / 2)
            rows.append([1.0, *(at(plane, y + dy, x + dx) - at(plane, y, x)), dx / span, dy / span])
            targets.append(at(color, y + dy, x + dx))
        rows, targets, weights = np.array(rows), np.array(targets), np.array(weights)
        per_weight = np.array([*(noise_ridge * noise[y, x]), position_ridge, position_ridge]) + 1e-8
        second = weights @ rows[:, 1:] ** 2
        penalty = np.hstack([np.zeros((len(second), 1)), np.diag(np.sqrt(ridge * second + weights.sum() * per_weight))])
        left = np.vstack([np.sqrt(weights)[:, None] * rows, penalty])
        right = np.vstack([np.sqrt(weights)[:, None] * targets, np.zeros((len(second), color.shape[-1]))])
        # Columns of unit length, so that no cut-off of small singular values takes a term away.
        length = np.linalg.norm(left, axis=0)
        solution = np.linalg.lstsq(left / length, right, rcond=None)[0]
        for c in range(color.shape[-1]):  # no light below 0 but where the pixel itself is
            out[y, x, c] = max(solution[0, c] / length[0], min(color[y, x, c], 0.0))
    return out


# --- Outliers and variances -------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("kind", KINDS)
def test_outliers_match_a_loop(kind, size, limit):
    color = planes(kind, *size, 3).astype(np.float64)
    for image in (color, color - 0.5):
        scaled, factor = ora.outliers(image, limit)
        expected, expected_factor = loop_outliers(image, limit)
        assert factor.shape == size and (factor >= 0.0).all() and (factor <= 1.0).all()
        assert_close(scaled, expected, 1e-12)
        assert_close(factor, expected_factor, 1e-12)


def test_outliers_touch_only_what_exceeds_every_neighbour():
    color = planes("uniform", 13, 17, 3).astype(np.float64)
    color[5, 6] = (4.0, 400.0, 40.0)
    scaled, factor = ora.outliers(color)
    largest = color.max(axis=-1)
    around = np.ones((3, 3), dtype=bool)
    around[1, 1] = False
    highest = scipy.ndimage.maximum_filter(largest, footprint=around, mode="mirror")
    assert np.array_equal(factor < 1.0, largest > highest)
    np.testing.assert_allclose(scaled.max(axis=-1), np.minimum(largest, highest), rtol=1e-12)
    np.testing.assert_allclose(scaled[5, 6] / scaled[5, 6, 1], (0.01, 1.0, 0.1))


def test_outliers_in_the_dark():
    color = np.zeros((5, 5, 3))
    color[2, 2] = 1.0
    scaled, factor = ora.outliers(color)
    assert not scaled.any() and factor[2, 2] == 0.0 and factor.sum() == 24.0
    scaled, factor = ora.outliers(-1.0 - color)
    assert np.array_equal(scaled, -1.0 - color) and (factor == 1.0).all()


def test_variance_from_halves_is_that_of_their_mean():
    rng = np.random.default_rng(0)
    a, b = rng.normal(3.0, 0.4, (2, 120, 120, 3))
    assert np.array_equal(ora.variance_from_halves(a, b), ora.variance_from_halves(b, a))
    estimate = ora.variance_from_halves(a, b).mean(axis=(0, 1))
    np.testing.assert_allclose(estimate, 0.4**2 / 2.0, rtol=0.05)
    np.testing.assert_allclose(estimate, ((a + b) / 2.0).var(axis=(0, 1)), rtol=0.07)


@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("kind", KINDS)
def test_variance_from_image_matches_a_loop_and_scipy(kind, size):
    color = planes(kind, *size, 3).astype(np.float64)
    variance = ora.variance_from_image(color)
    assert_close(variance, loop_image_variance(color), 1e-12)
    if min(size) > 1:
        row = np.array([1.0, -2.0, 1.0])
        response = scipy.ndimage.correlate(color, np.outer(row, row)[..., None], mode="mirror")
        assert_close(variance, response**2 / 36.0, 1e-12)


def test_variance_from_image_sees_noise_and_no_planes():
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:120, :120].astype(np.float64)
    ramp = np.stack([2.0 * x - y, x, 3.0 + 0.0 * x], axis=-1)
    assert ora.variance_from_image(ramp)[1:-1, 1:-1].max() < 1e-20
    noisy = ramp + rng.normal(0.0, 0.3, ramp.shape)
    estimate = ora.variance_from_image(noisy)[1:-1, 1:-1].mean(axis=(0, 1))
    np.testing.assert_allclose(estimate, 0.3**2, rtol=0.1)


# --- Variance-aware distance ------------------------------------------------------------------------------


@pytest.mark.parametrize("patch_radius", [0, 1, 2])
@pytest.mark.parametrize("size", SMALL)
def test_variance_distance_matches_a_loop(size, patch_radius):
    for channels in (None, 1, 3):
        color = planes("hdr", *size, channels)
        variance = 0.3 * planes("uniform", *size, channels, seed=1)
        for dx, dy in OFFSETS:
            distance = ora.variance_distance(color, variance, dx, dy, patch_radius)
            loop = np.zeros(size)
            for y, x in np.ndindex(size):
                loop[y, x] = loop_distance(color, variance, y, x, dy, dx, patch_radius)
            assert_close(distance, loop, 1e-12)


def test_variance_distance_of_a_pixel_to_itself_is_zero():
    color, variance = planes("hdr", 13, 17, 3), planes("uniform", 13, 17, 3)
    assert not ora.variance_distance(color, variance, 0, 0, 2).any()
    assert not ora.variance_distance(color, 0.0 * variance, 0, 0, 2).any()


def test_variance_distance_of_noise_alone_is_small_and_of_an_edge_is_not():
    """Before it is held at 0, the distance of pure noise has mean 0; a step of n sigma adds n² / 2."""
    rng = np.random.default_rng(0)
    sigma = 0.2
    color = rng.normal(1.0, sigma, (40, 40, 3))
    variance = np.full(color.shape, sigma**2)
    noise = ora.variance_distance(color, variance, 8, 0, 3)
    assert noise.mean() < 0.1 and noise.max() < 1.0
    color[:, 20:] += 6.0 * sigma
    across = ora.variance_distance(color, variance, 8, 0, 3)[:, 15:17]
    np.testing.assert_allclose(across.mean(), 6.0**2 / 2.0, rtol=0.1)


def test_variance_distance_takes_the_smaller_variance_off():
    color = np.zeros((1, 2, 1))
    color[0, 1] = 3.0
    variance = np.zeros((1, 2, 1))
    variance[0, :, 0] = 1.0, 0.25
    there = ora.variance_distance(color, variance, 1, 0, 0)
    np.testing.assert_allclose(there[0, 0], (9.0 - 1.25) / 1.25)
    np.testing.assert_allclose(there[0, 1], (9.0 - 0.5) / 1.25)


# --- Features ---------------------------------------------------------------------------------------------


def test_depth_feature_matches_its_formula_and_derivative():
    depth = planes("uniform", 6, 7).astype(np.float64) * 5.0 + 0.1
    depth[0, 0], depth[0, 1] = 0.0, -2.0
    variance = planes("uniform", 6, 7, seed=1).astype(np.float64)
    d, v = ora.depth_feature(depth, variance)
    scale = scipy.stats.gmean(depth[depth > 0.0])
    for y, x in np.ndindex(d.shape):
        z = max(depth[y, x], 0.0)
        step = 1e-5
        slope = ((z + step) / (z + step + scale) - (z - step) / (z - step + scale)) / (2.0 * step)
        np.testing.assert_allclose(d[y, x], z / (z + scale), rtol=1e-12)
        np.testing.assert_allclose(v[y, x], variance[y, x] * slope**2, rtol=1e-6)
    assert d[0, 0] == d[0, 1] == 0.0 and (d >= 0.0).all() and (d < 1.0).all()


def test_depth_feature_does_not_depend_on_the_unit():
    depth, variance = planes("uniform", 6, 7) + 0.1, planes("uniform", 6, 7, seed=1)
    d, v = ora.depth_feature(depth, variance)
    other, other_v = ora.depth_feature(100.0 * np.float64(depth), 1e4 * np.float64(variance))
    assert_close(other, d, 1e-12)
    assert_close(other_v, v, 1e-12)


def test_depth_feature_without_any_depth():
    d, v = ora.depth_feature(np.zeros((3, 2)), np.full((3, 2), 0.5))
    assert not d.any() and (v == 0.5).all()


def test_depth_feature_variance_predicts_the_spread():
    rng = np.random.default_rng(0)
    depth = np.full((150, 150), 3.0) + rng.normal(0.0, 0.05, (150, 150))
    d, v = ora.depth_feature(depth, np.full(depth.shape, 0.05**2))
    np.testing.assert_allclose(v.mean(), d.var(), rtol=0.05)


@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("channels", [None, 1, 3])
def test_prefilter_matches_a_loop(size, channels):
    feature = planes("textured", *size, channels) + 0.1 * planes("uniform", *size, channels)
    variance = 0.02 * planes("uniform", *size, channels, seed=1)
    for radii in ((2, 1), (1, 0)):
        filtered, left = ora.prefilter(feature, variance, *radii)
        expected, expected_left = loop_prefilter(feature, variance, *radii)
        assert_close(filtered, expected, 1e-12)
        np.testing.assert_allclose(left, expected_left, rtol=1e-10)


def test_prefilter_defaults_and_cap():
    feature, variance = planes("uniform", 6, 7, 3), 3.0 * planes("uniform", 6, 7, 3, seed=1)
    for one, other in zip(ora.prefilter(feature, variance), ora.prefilter(feature, variance, 3, 1), strict=True):
        assert np.array_equal(one, other)
    for one, other in zip(ora.prefilter(feature, variance), loop_prefilter(feature, variance, 3, 1), strict=True):
        assert_close(one, other, 1e-12)
    for one, other in zip(
        ora.prefilter(feature, variance), ora.prefilter(feature, np.minimum(variance, 1.0)), strict=True
    ):
        assert np.array_equal(one, other)


def test_prefilter_of_a_constant_takes_the_mean_of_all():
    filtered, left = ora.prefilter(np.full((9, 9, 3), 0.4), np.full((9, 9, 3), 0.01))
    np.testing.assert_allclose(filtered, 0.4, rtol=1e-12)
    np.testing.assert_allclose(left, 0.01 / 49.0, rtol=1e-12)


def test_prefilter_leaves_a_clean_feature_alone():
    feature = planes("uniform", 9, 9, 3).astype(np.float64)
    filtered, left = ora.prefilter(feature, np.zeros(feature.shape))
    np.testing.assert_allclose(filtered, feature, atol=1e-12)
    assert not left.any()


def test_prefilter_removes_noise_and_keeps_an_edge():
    rng = np.random.default_rng(0)
    sigma = 0.05
    clean = np.where(np.arange(40) < 20, 0.2, 0.8)[None, :, None] * np.ones((40, 40, 3))
    noisy = clean + rng.normal(0.0, sigma, clean.shape)
    filtered, left = ora.prefilter(noisy, np.full(clean.shape, sigma**2))
    error = ((filtered - clean) ** 2).mean()
    assert error < 0.15 * sigma**2
    # The weights follow the noise, so the variance that is left is a little below the error.
    assert 0.3 < left.mean() / error < 1.5
    assert np.abs(filtered - clean).max() < 0.2


# --- Regression -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("count", [0, 1, 4])
@pytest.mark.parametrize("radii", [(0, 0), (1, 1), (2, 1)])
def test_regression_matches_least_squares(size, count, radii):
    color = planes("hdr", *size, 3)
    guide = np.float64(planes("uniform", *size, 3, seed=2))
    variance = 0.05 * planes("uniform", *size, 3, seed=3)
    plane = np.float64(planes("uniform", *size, max(count, 1), seed=4))[..., :count]
    noise = 0.1 * np.float64(planes("uniform", *size, max(count, 1), seed=5))[..., :count]
    options = {"search_radius": radii[0], "patch_radius": radii[1], "k": 0.8} | RIDGES
    fitted = ora.first_order_regression(guide, variance, plane, noise, color, **options)
    assert_close(fitted, loop_regression(guide, variance, plane, noise, color, **options), 1e-9)


@pytest.mark.parametrize("ridge", [0.0, 0.3])
@pytest.mark.parametrize("noise_ridge", [0.0, 5.0])
@pytest.mark.parametrize("position_ridge", [0.0, 2.0])
def test_every_ridge_matches_least_squares(ridge, noise_ridge, position_ridge):
    scene = features(6, 7)
    plane = np.concatenate([scene["albedo"], scene["depth"][..., None]], axis=-1).astype(np.float64)
    noise = 0.02 * np.float64(planes("uniform", 6, 7, 4))
    color, variance = scene["color"], 0.05 * planes("uniform", 6, 7, 3)
    options = WINDOWS | {"ridge": ridge, "noise_ridge": noise_ridge, "position_ridge": position_ridge}
    fitted = ora.first_order_regression(color, variance, plane, noise, color, **options)
    assert_close(fitted, loop_regression(color, variance, plane, noise, color, **options), 1e-7)


def test_regression_reproduces_what_is_linear_in_features_and_position():
    y, x = np.mgrid[:13, :17].astype(np.float64)
    plane = np.float64(planes("uniform", 13, 17, 3))
    color = plane @ np.random.default_rng(0).normal(size=(3, 3)) + 0.5
    guide, variance = planes("uniform", 13, 17, 3, seed=1), np.full((13, 17, 3), 0.1)
    options = {"search_radius": 3, "patch_radius": 1, "k": 1.0, "ridge": 0.0, "noise_ridge": 1.0, "position_ridge": 0.0}
    clean = np.zeros(plane.shape)
    fitted = ora.first_order_regression(guide, variance, plane, clean, color, **options)
    np.testing.assert_allclose(fitted, color, atol=1e-5)
    color += (0.1 * x - 0.2 * y)[..., None]
    fitted = ora.first_order_regression(guide, variance, plane, clean, color, **options)
    np.testing.assert_allclose(fitted[3:-3, 3:-3], color[3:-3, 3:-3], atol=1e-5)


def test_regression_reproduces_a_constant_under_any_ridge():
    plane, color = np.float64(planes("textured", 6, 7, 4)), np.full((6, 7, 3), (0.1, 2.0, 30.0))
    guide, variance = planes("hdr", 6, 7, 3), planes("uniform", 6, 7, 3)
    fitted = ora.first_order_regression(guide, variance, plane, 0.1 * plane, color, **WINDOWS, **RIDGES)
    np.testing.assert_allclose(fitted, color, rtol=1e-10)


def test_great_ridges_leave_non_local_means():
    color, variance = planes("uniform", 6, 7, 3), 0.05 * planes("uniform", 6, 7, 3, seed=1)
    plane = np.float64(planes("uniform", 6, 7, 2, seed=2))
    options = WINDOWS | {"ridge": 0.0, "noise_ridge": 1e9, "position_ridge": 1e9}
    fitted = ora.first_order_regression(color, variance, plane, np.ones(plane.shape), color, **options)
    wide, narrow = (
        np.stack([np.exp(-ora.variance_distance(color, variance, dx, dy, r) / 0.8**2) for dx, dy in oracle.offsets(2)])
        for r in (1, 0)
    )
    expected = oracle.weighted_mean(color, (wide + narrow) / 2, 2)
    np.testing.assert_allclose(fitted, expected, atol=1e-7)


def test_regression_without_features():
    color, variance = planes("uniform", 6, 7, 3), 0.05 * planes("uniform", 6, 7, 3, seed=1)
    none = ora.first_order_regression(color, variance, None, None, color, **WINDOWS, **RIDGES)
    empty = np.zeros((6, 7, 0))
    assert np.array_equal(none, ora.first_order_regression(color, variance, empty, empty, color, **WINDOWS, **RIDGES))
    constant = np.ones((6, 7, 2))
    useless = ora.first_order_regression(color, variance, constant, 0.0 * constant, color, **WINDOWS, **RIDGES)
    np.testing.assert_allclose(none, useless, rtol=1e-10)


def test_regression_is_linear_in_the_color_and_reads_its_guide():
    guide, variance = planes("uniform", 6, 7, 3), 0.05 * planes("uniform", 6, 7, 3, seed=1)
    plane = np.float64(planes("uniform", 6, 7, 2, seed=2))
    a, b = np.float64(planes("hdr", 6, 7, 3, seed=3)), np.float64(planes("step", 6, 7, 3))

    def fit(color, guide=guide):
        return ora.first_order_regression(guide, variance, plane, 0.01 * plane, color, **WINDOWS, **RIDGES)

    far = 1e4  # so far above 0 that its clamp does nothing
    assert_close(fit(2.0 * a - b + far), 2.0 * fit(a + far) - fit(b + far), 1e-10)
    assert fit(a - a.mean()).min() >= min(a.min() - a.mean(), 0.0)
    assert not np.allclose(fit(a), fit(a, guide=b))


# --- The energy of the outliers ---------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
def test_wide_box_mean_is_the_box_mean(size):
    for channels in (None, 3):
        image = planes("hdr", *size, channels)
        for radius in (0, 1, 4):
            assert_close(ora.wide_box_mean(image, radius), oracle.box_mean(image, radius), 1e-12)
    if min(size) > 1:
        image = np.float64(planes("hdr", *size))
        assert_close(ora.wide_box_mean(image, 50), scipy.ndimage.uniform_filter(image, 101, mode="mirror"), 1e-10)


@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("radius", [1, 3])
def test_spread_removed_matches_loops(size, radius):
    image, removed = np.float64(planes("uniform", *size, 3)), np.float64(planes("hdr", *size, 3))

    def thrice(plane):
        for _ in range(3):
            plane = loop_mean(plane, radius)
        return plane

    light = thrice(removed)
    level = thrice((image + light / 2.0).sum(axis=-1) / 3.0)
    expected = np.zeros(image.shape)
    for y, x in np.ndindex(size):
        gain = 1.0 + 0.5 * np.mean(light[y, x]) / max(level[y, x], np.mean(light[y, x]), 1e-9)
        expected[y, x] = (image[y, x] + 0.5 * light[y, x]) * gain
    assert_close(ora.spread_removed(image, removed, radius), expected, 1e-12)


def test_spread_removed_gives_all_light_back():
    grey = np.full((20, 20, 3), 0.3)
    np.testing.assert_allclose(ora.spread_removed(grey, np.full(grey.shape, 0.1), 5), 0.4, rtol=1e-12)
    assert np.array_equal(ora.spread_removed(grey, 0.0 * grey, 5), grey)
    assert not ora.spread_removed(0.0 * grey, 0.0 * grey, 5).any()
    removed = np.zeros((61, 61, 3))
    removed[30, 30] = 20.0
    image = 0.5 + 0.1 * np.float64(planes("uniform", 61, 61, 3))
    light = (ora.spread_removed(image, removed, 4) - image).sum(axis=(0, 1)).mean()
    np.testing.assert_allclose(light, 20.0, rtol=0.02)


# --- The whole method -------------------------------------------------------------------------------------


def loop_denoise(color, e, variance, parts, limit, spread_radius, **options) -> np.ndarray:
    """The steps in order, from loops; `variance` that of e · color, `parts` pairs of a feature and its variance."""
    c = e * np.float64(color)
    kept, factor = (c, np.ones(c.shape[:2])) if limit is None else loop_outliers(c, limit)
    variance = loop_mean(variance * factor[..., None] ** 2, 2)
    pairs = [(p, np.zeros(p.shape)) if v is None else loop_prefilter(p, v, 3, 1) for p, v in parts]
    plane = np.concatenate([np.zeros((*c.shape[:2], 0)), *(p for p, _ in pairs)], axis=-1)
    noise = np.concatenate([np.zeros((*c.shape[:2], 0)), *(v for _, v in pairs)], axis=-1)
    out = loop_regression(kept, variance, plane, noise, kept, **options)
    return (out if limit is None else ora.spread_removed(out, c - kept, spread_radius)) / e


@pytest.mark.parametrize("limit", [None, 1.0, 1.5])
@pytest.mark.parametrize("noise", ["image", "halves", "given", "all"])
def test_denoise_matches_the_loops(noise, limit):
    size = (6, 7)
    scene = {name: np.float64(plane) for name, plane in features(*size).items()}
    color = scene.pop("color")
    color[2, 3] *= 50.0
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
        ((z / (z + scale))[..., None], None),
    ]
    if noise == "all":
        parts[2] = (parts[2][0], (variances["depth"] * scale**2 / (z + scale) ** 4)[..., None])
    options = WINDOWS | RIDGES
    denoised = ora.denoise_regression(color, **scene, **given, **options, outlier_limit=limit, spread_radius=3)
    assert_close(denoised, loop_denoise(color, e, variance, parts, limit, 3, **options), 1e-8)


@pytest.mark.parametrize("size", SIZES)
def test_denoise_takes_any_size_and_set_of_features(size):
    scene = features(*size)
    color = scene.pop("color")
    for names in ((), ("albedo",), ("normal", "depth"), tuple(scene)):
        denoised = ora.denoise_regression(color, **{name: scene[name] for name in names}, **WINDOWS, **RIDGES)
        assert denoised.shape == color.shape and np.isfinite(denoised).all()


def test_denoise_keeps_a_constant_and_follows_the_exposure():
    constant = np.full((9, 8, 3), (0.2, 0.5, 1.5))
    np.testing.assert_allclose(ora.denoise_regression(constant, **WINDOWS, **RIDGES), constant, rtol=1e-9)
    scene = {name: np.float64(plane) for name, plane in features(9, 8).items()}
    color = scene.pop("color")
    one = ora.denoise_regression(color, **scene, **WINDOWS, **RIDGES)
    assert_close(ora.denoise_regression(1000.0 * color, **scene, **WINDOWS, **RIDGES) / 1000.0, one, 1e-9)
    set_by_hand = ora.denoise_regression(color, **scene, **WINDOWS, **RIDGES, exposure=oracle.auto_exposure(color))
    assert np.array_equal(set_by_hand, one)
    defaults = {"outlier_limit": 1.0, "spread_radius": 50, "exposure": None}
    assert np.array_equal(ora.denoise_regression(color, **scene, **WINDOWS, **RIDGES, **defaults), one)
    # The image's own noise sets the distances, so that the exposure acts only beside the constant 1e-8.
    other = ora.denoise_regression(color, **scene, **WINDOWS, **RIDGES, exposure=1e-4)
    assert np.abs(other - one).max() > 1e-3


def test_denoise_removes_noise_and_fireflies_and_keeps_the_light():
    scene, clean = features(31, 64), features(31, 64, noise=0.0)["color"].astype(np.float64)
    color = scene.pop("color")
    options = {"search_radius": 4, "patch_radius": 2, "k": 0.7} | RIDGES

    def error(image):
        return np.mean((image - clean) ** 2 / (clean**2 + 0.01))

    with_features = ora.denoise_regression(color, **scene, **options)
    alone = ora.denoise_regression(color, **options)
    assert error(with_features) < 0.05 * error(color)
    assert error(with_features) < error(alone) < error(color)
    assert error(with_features) < error(ora.denoise_regression(color, **scene, **options, outlier_limit=None))
    np.testing.assert_allclose(with_features.mean(), color.mean(), rtol=0.05)
