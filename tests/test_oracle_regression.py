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
from test_oracle_terms import at, loop_terms

#: (height, width) for loops over pixels: one pixel, one row, one column, smaller than a window, and one of odd size.
SMALL = ((1, 1), (1, 9), (7, 1), (3, 2), (6, 7))
OFFSETS = ((0, 0), (1, 0), (-2, 1), (3, -3), (-9, 7))
RIDGES = {"ridge": 1e-3, "noise_ridge": 0.5, "position_ridge": 1e-2}
WINDOWS = {"search_radius": 2, "patch_radius": 1, "k": 0.8}


# --- Another way ------------------------------------------------------------------------------------------


def window(radius: int) -> list[tuple[int, int]]:
    return [(dy, dx) for dy in range(-radius, radius + 1) for dx in range(-radius, radius + 1)]


def loop_mean(image: np.ndarray, radius: int) -> np.ndarray:
    out = np.zeros(image.shape)
    for y, x in np.ndindex(image.shape[:2]):
        out[y, x] = np.mean([at(image, y + dy, x + dx) for dy, dx in window(radius)], axis=0)
    return out


def loop_outliers(
    color, limit: float, variance=None, significant: float = np.inf, by_chance: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    scaled, factor = color.astype(np.float64), np.ones(color.shape[:2])
    for y, x in np.ndindex(factor.shape):
        around = [max(at(color, y + dy, x + dx)) for dy, dx in window(1) if (dy, dx) != (0, 0)]
        largest, brightest = float(max(color[y, x])), max(*around, 0.0)
        # Without noise nothing is by chance, unless nothing is ever significant.
        sigmas = np.inf
        if np.isfinite(significant):
            each = [
                sum(at(variance, y + dy, x + dx)) / (max(at(color, y + dy, x + dx)) ** 2 + 1e-6) for dy, dx in window(1)
            ]
            sigmas = significant * np.sqrt(
                max(sum(variance[y, x]), by_chance * sum(each) / 9 * (largest**2 + 1e-6), 0.0)
            )
        if limit * brightest < largest <= brightest + sigmas:
            factor[y, x] = limit * brightest / largest
        if np.isfinite(significant):
            further = [max(at(color, y + dy, x + dx)) for dy, dx in window(2) if (dy, dx) != (0, 0)]
            fourth = max(sorted(further, reverse=True)[3], 0.0)
            if 16 * limit * fourth < largest <= fourth + min(significant, 1.5) / significant * sigmas:
                factor[y, x] = min(factor[y, x], limit * fourth / largest)
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
    total = 0.0
    for py, px in window(patch_radius):
        first, second = at(color, y + py, x + px), at(color, y + py + dy, x + px + dx)
        v, u = np.sum(at(variance, y + py, x + px)), np.sum(at(variance, y + py + dy, x + px + dx))
        total += (np.sum((first - second) ** 2) - (v + min(v, u))) / (v + u + 1e-12)
    return max(total / (2 * patch_radius + 1) ** 2, 0.0)


def loop_prefilter(feature, variance, search_radius: int, patch_radius: int) -> tuple[np.ndarray, np.ndarray]:
    v = loop_mean(np.minimum(np.float64(variance), 1.0), 1)
    filtered, left = np.zeros(feature.shape), np.zeros(feature.shape)
    disc = [(dy, dx) for dy, dx in window(search_radius) if np.hypot(dy, dx) < search_radius + 1e-9]
    for y, x in np.ndindex(feature.shape[:2]):
        distances = {o: loop_distance(feature, v, y, x, *o, patch_radius) for o in disc}
        w = {o: max(0.0, 1.0 - d / 4.0) ** 4 for o, d in distances.items()}
        total = sum(w.values())
        filtered[y, x] = sum(w[dy, dx] / total * at(feature, y + dy, x + dx) for dy, dx in w)
        left[y, x] = sum((w[dy, dx] / total) ** 2 * at(v, y + dy, x + dx) for dy, dx in w)
    return filtered, left


def loop_weight(guide, variance, y: int, x: int, dy: int, dx: int, patch_radius: int, k: float) -> float:
    distances = (loop_distance(guide, variance, y, x, dy, dx, r) for r in (patch_radius, patch_radius // 2))
    return sum(max(0.0, 1.0 - d / (4.0 * k * k)) ** 4 for d in distances) / 2.0


def ridge_least_squares(rows, targets, weights, penalties) -> np.ndarray:
    """The constant term of a weighted least-squares problem; penalties: rows beside it, of the other terms."""
    more = np.hstack([np.zeros((len(penalties), 1)), penalties])
    left = np.vstack([np.sqrt(weights)[:, None] * rows, more])
    right = np.vstack([np.sqrt(weights)[:, None] * targets, np.zeros((len(more), targets.shape[1]))])
    # Columns of unit length, so that no cut-off of small singular values takes a term away.
    length = np.linalg.norm(left, axis=0)
    return np.linalg.lstsq(left / length, right, rcond=None)[0][0] / length[0]


def loop_window(radius: int) -> list[tuple[int, int]]:
    """A disc half a pixel wider than its radius; no offset is so near to its edge that a quarter pixel matters."""
    return [(dy, dx) for dy, dx in window(radius) if np.hypot(dy, dx) <= np.sqrt((radius + 0.5) ** 2 - 0.2)]


def loop_regression(
    guide,
    variance,
    plane,
    noise,
    color,
    *,
    search_radius,
    patch_radius,
    k,
    ridge,
    noise_ridge,
    position_ridge,
    stride=1,
    terms_reach=None,
) -> np.ndarray:
    """Both fits, the whole and the inner one, of least squares over the components that are used."""
    out = np.zeros((2, *color.shape))
    span = max(search_radius, 1)
    taps = loop_window(search_radius)
    inner = np.array([tap in loop_window(search_radius // 2) for tap in taps])
    steps = [(dy * stride, dx * stride) for dy, dx in taps]
    blocks = {}
    for y, x in np.ndindex(color.shape[:2]):
        if (y // 8, x // 32) not in blocks:
            reach = search_radius * stride if terms_reach is None else terms_reach
            blocks[y // 8, x // 32] = loop_terms(plane, noise, y, x, reach)
        terms = blocks[y // 8, x // 32]
        v, count = terms.direction, len(terms.variance)
        changes = np.array([v @ (at(plane, y + dy, x + dx) - plane[y, x]) for dy, dx in steps])
        here = v @ (plane[y, x] - terms.mean)
        rows = np.array([[1.0, *t, dx / span, dy / span] for t, (dy, dx) in zip(changes, taps, strict=True)])
        targets = np.array([at(color, y + dy, x + dx) for dy, dx in steps])
        weights = np.array([loop_weight(guide, variance, y, x, *step, patch_radius, k) for step in steps])
        for fit, part in zip(out, (slice(None), inner), strict=True):
            w, penalties = weights[part], np.zeros((0, count + 2))
            # A change of a feature along the components costs what the feature's own moment and noise say.
            for q, along in enumerate(v.T):
                cost = ridge * (w @ (changes[part] @ along) ** 2) + noise_ridge * w.sum() * noise[y, x, q]
                penalties = np.vstack([penalties, [*(np.sqrt(cost) * along), 0.0, 0.0]])
            least = [5e-5 * (s + t**2) + 1e-9 for s, t in zip(terms.variance, here, strict=True)]
            per_weight = np.array([*least, *[position_ridge + 1e-9] * 2])
            own = w @ rows[part][:, 1:] ** 2 * [*[0.0] * count, ridge, ridge]
            penalties = np.vstack([penalties, np.diag(np.sqrt(own + w.sum() * per_weight))])
            fit[y, x] = ridge_least_squares(rows[part], targets[part], w, penalties)
            for c in range(3):  # no light below 0 but where the pixel itself is
                fit[y, x, c] = max(fit[y, x, c], min(color[y, x, c], 0.0))
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


@pytest.mark.parametrize("significant", [0.5, 2.0, np.inf])
@pytest.mark.parametrize("limit", [1.0, 1.5])
@pytest.mark.parametrize("size", SMALL)
def test_outliers_of_significance_stay(size, limit, significant):
    color, variance = (np.float64(planes("hdr", *size, 3, seed=s)) for s in (0, 1))
    variance[0] = 0.0
    scaled, factor = ora.outliers(color, limit, variance, significant)
    expected, expected_factor = loop_outliers(color, limit, variance, significant)
    assert_close(scaled, expected, 1e-12)
    assert_close(factor, expected_factor, 1e-12)
    if significant == np.inf:
        assert np.array_equal(scaled, ora.outliers(color, limit)[0])


def test_significance_counts_from_the_brightest_neighbour():
    """A pixel of 2 beside 1 and a deviation of 0.3 stands out by 3.3 of them, whatever the limit below 2 is."""
    color = np.ones((3, 3, 3))
    color[1, 1, 2] = 2.0
    variance = np.zeros((3, 3, 3))
    variance[1, 1] = 0.3**2 / 3.0
    for limit in (1.0, 1.9):
        assert ora.outliers(color, limit, variance, 3.2)[1][1, 1] == 1.0
        assert ora.outliers(color, limit, variance, 3.4)[1][1, 1] == limit / 2.0
    assert ora.outliers(color, 2.0, variance, 3.4)[1][1, 1] == 1.0


def test_halves_that_agree_by_chance_are_as_uncertain_as_those_around():
    """A pixel of 2 beside 1, all 10 % uncertain but for itself, which seems exact: 5.3 deviations of 0.2 * 8/9."""
    color = np.ones((3, 3, 3))
    color[1, 1] = 2.0
    variance = np.full((3, 3, 3), 0.1**2 / 3.0)
    variance[1, 1] = 0.0
    assert ora.outliers(color, 1.1, variance, 5.2)[1][1, 1] == 1.0
    assert ora.outliers(color, 1.1, variance, 5.4)[1][1, 1] == 0.55


def test_significance_follows_what_is_known_of_the_noise():
    both = ("color_variance", "color_a", "color_b")
    given = [ora.significance(names) for names in (both, both[:1], both[1:], ("albedo",), ())]
    assert given == [3.0, 3.0, 3.0, np.inf, np.inf]
    assert [ora.by_chance(names) for names in (both, both[:1], both[1:], ())] == [False, False, True, True]


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


def test_variance_distance_takes_the_variances_of_the_channels_together():
    color, variance = planes("hdr", 6, 7, 3), 0.3 * planes("uniform", 6, 7, 3, seed=1)
    distance = ora.variance_distance(color, variance, 2, 1, 1)
    total = np.float64(variance).sum(axis=-1, keepdims=True)
    assert_close(ora.variance_distance(color, total, 2, 1, 1), distance, 1e-12)
    assert_close(ora.variance_distance(color, variance[..., ::-1], 2, 1, 1), distance, 1e-6)
    # A channel without noise does not outweigh the others.
    color, variance = np.zeros((1, 2, 3)), np.zeros((1, 2, 3))
    color[0, 1, 1], variance[..., 0] = 1.0, 0.5
    np.testing.assert_allclose(ora.variance_distance(color, variance, 1, 0, 0), 0.0)


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
        np.testing.assert_allclose(d[y, x], z / (z + scale) - 0.5, rtol=1e-12)
        np.testing.assert_allclose(v[y, x], variance[y, x] * slope**2, rtol=1e-6)
    assert d[0, 0] == d[0, 1] == -0.5 and (d >= -0.5).all() and (d < 0.5).all()


def test_depth_feature_does_not_depend_on_the_unit():
    depth, variance = planes("uniform", 6, 7) + 0.1, planes("uniform", 6, 7, seed=1)
    d, v = ora.depth_feature(depth, variance)
    other, other_v = ora.depth_feature(100.0 * np.float64(depth), 1e4 * np.float64(variance))
    assert_close(other, d, 1e-12)
    assert_close(other_v, v, 1e-12)


def test_depth_feature_without_any_depth():
    d, v = ora.depth_feature(np.zeros((3, 2)), np.full((3, 2), 0.5))
    assert (d == -0.5).all() and (v == 0.5).all()


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
    for one, other in zip(ora.prefilter(feature, variance), ora.prefilter(feature, variance, 2, 1), strict=True):
        assert np.array_equal(one, other)
    for one, other in zip(ora.prefilter(feature, variance), loop_prefilter(feature, variance, 2, 1), strict=True):
        assert_close(one, other, 1e-12)
    for one, other in zip(
        ora.prefilter(feature, variance), ora.prefilter(feature, np.minimum(variance, 1.0)), strict=True
    ):
        assert np.array_equal(one, other)


def test_prefilter_of_a_constant_takes_the_mean_of_all():
    filtered, left = ora.prefilter(np.full((9, 9, 3), 0.4), np.full((9, 9, 3), 0.01))
    np.testing.assert_allclose(filtered, 0.4, rtol=1e-12)
    np.testing.assert_allclose(left, 0.01 / 13.0, rtol=1e-12)


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


@pytest.mark.parametrize(("distance", "expected"), [(0.0, 1.0), (1.0, 0.75**4), (2.0, 0.5**4), (4.0, 0.0), (9.0, 0.0)])
def test_regression_weight_ends_at_four(distance, expected):
    k = 0.7
    step = np.zeros((1, 2, 1))
    step[0, 1] = np.sqrt(2.0 * distance * k**2 + 2.0)
    weights = ora.regression_weight(step, np.ones(step.shape), 1, 0, patch_radius=0, k=k)
    np.testing.assert_allclose(weights, expected, atol=1e-7)


@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("count", [0, 1, 4])
@pytest.mark.parametrize("windows", [(0, 0, 1), (1, 1, 1), (2, 1, 1), (2, 1, 3)])
def test_regression_matches_least_squares(size, count, windows):
    color = planes("hdr", *size, 3)
    guide = np.float64(planes("uniform", *size, 3, seed=2))
    variance = 0.05 * planes("uniform", *size, 3, seed=3)
    plane = np.float64(planes("uniform", *size, max(count, 1), seed=4))[..., :count]
    noise = np.float64(planes("uniform", *size, max(count, 1), seed=5))[..., :count] * (0.1, 0.01, 0.0, 0.04)[:count]
    options = dict(zip(("search_radius", "patch_radius", "stride"), windows, strict=True)) | {"k": 0.8} | RIDGES
    fits = ora.first_order_regression(guide, variance, plane, noise, color, **options)
    for fitted, expected in zip(fits, loop_regression(guide, variance, plane, noise, color, **options), strict=True):
        assert_close(fitted, expected, 1e-9)


@pytest.mark.parametrize("ridge", [0.0, 0.3])
@pytest.mark.parametrize("noise_ridge", [0.0, 5.0])
@pytest.mark.parametrize("position_ridge", [0.0, 1e-6, 2.0])
def test_every_ridge_matches_least_squares(ridge, noise_ridge, position_ridge):
    scene = features(6, 7)
    plane = np.concatenate([scene["albedo"], scene["depth"][..., None]], axis=-1).astype(np.float64)
    noise = 0.02 * np.float64(planes("uniform", 6, 7, 4))
    color, variance = scene["color"], 0.05 * planes("uniform", 6, 7, 3)
    options = WINDOWS | {"ridge": ridge, "noise_ridge": noise_ridge, "position_ridge": position_ridge}
    fits = ora.first_order_regression(color, variance, plane, noise, color, **options)
    for fitted, expected in zip(fits, loop_regression(color, variance, plane, noise, color, **options), strict=True):
        assert_close(fitted, expected, 1e-7)


def test_regression_reproduces_what_is_linear_in_features_and_position():
    y, x = np.mgrid[:13, :17].astype(np.float64)
    plane = np.float64(planes("uniform", 13, 17, 3))
    color = plane @ np.random.default_rng(0).normal(size=(3, 3)) + 5.0
    guide, variance = planes("uniform", 13, 17, 3, seed=1), np.full((13, 17, 3), 0.1)
    options = {"search_radius": 6, "patch_radius": 1, "k": 1.0}
    options |= {"ridge": 0.0, "noise_ridge": 1.0, "position_ridge": 0.0}
    clean = np.zeros(plane.shape)
    for fitted in ora.first_order_regression(guide, variance, plane, clean, color, **options):
        np.testing.assert_allclose(fitted, color, atol=4e-4)
    color += (0.1 * x - 0.2 * y)[..., None]
    for fitted in ora.first_order_regression(guide, variance, plane, clean, color, **options):
        np.testing.assert_allclose(fitted[6:-6, 6:-6], color[6:-6, 6:-6], atol=4e-4)


@pytest.mark.parametrize("stride", [1, 2])
def test_regression_reproduces_a_ramp_in_a_feature_and_averages_without_it(stride):
    ramp = (np.arange(40.0) / 40.0 * np.ones((12, 1)))[..., None]
    color = np.repeat(3.0 - 2.0 * ramp, 3, axis=-1)
    alike = np.zeros(color.shape), np.ones(color.shape)
    options = {"search_radius": 4, "patch_radius": 1, "stride": stride, "k": 1.0}
    options |= {"ridge": 1e-6, "noise_ridge": 1.0, "position_ridge": 1e9}
    for fitted in ora.first_order_regression(*alike, ramp, 0.0 * ramp, color, **options):
        np.testing.assert_allclose(fitted, color, atol=2e-3)
    # With noise enough the ramp is not used, and at the border the mean leans inward.
    fitted, inner = ora.first_order_regression(*alike, ramp, 1.0 + ramp, color, **options)
    for fit, radius in ((fitted, 4), (inner, 2)):
        away = np.mean([abs(dx) for dx, _ in ora.disc(radius)]) * stride
        np.testing.assert_allclose((color - fit)[:, 0], 2.0 * away / 40.0, rtol=1e-6)


@pytest.mark.parametrize(("radius", "count"), [(0, 1), (1, 9), (2, 21), (3, 37), (6, 137), (7, 177)])
def test_the_window_is_a_disc(radius, count):
    assert len(ora.disc(radius)) == len(set(ora.disc(radius))) == count
    assert sorted((dy, dx) for dx, dy in ora.disc(radius)) == loop_window(radius)


@pytest.mark.parametrize("stride", [1, 2])
def test_a_pixel_counts_in_the_disc_and_not_just_outside(stride):
    """Radius 4 holds (4, 2) and not (3, 4) nor (4, 4), its middle of radius 2 (1, 2) and not (2, 2)."""
    size = (8 * stride + 1, 8 * stride + 1)
    alike = np.zeros((*size, 3)), np.ones((*size, 3))
    options = {"search_radius": 4, "patch_radius": 0, "k": 1.0, "stride": stride} | RIDGES
    for (dx, dy), whole, inner in (
        ((4, 2), True, False),
        ((4, 3), False, False),
        ((-3, 4), False, False),
        ((4, 4), False, False),
        ((3, 3), True, False),
        ((1, 2), True, True),
        ((2, 2), True, False),
        ((2, 0), True, True),
    ):
        color = np.ones((*size, 3))
        color[(4 + dy) * stride, (4 + dx) * stride] = 100.0
        fits = ora.first_order_regression(*alike, None, None, color, **options)
        for fit, seen in zip(fits, (whole, inner), strict=True):
            assert (abs(fit[4 * stride, 4 * stride, 0] - 1.0) > 0.1) == seen


def test_regression_reproduces_a_constant_under_any_ridge():
    plane, color = np.float64(planes("textured", 6, 7, 4)), np.full((6, 7, 4), (0.1, 2.0, 30.0, -0.5))
    guide, variance = planes("hdr", 6, 7, 3), planes("uniform", 6, 7, 3)
    for fitted in ora.first_order_regression(guide, variance, plane, 0.1 * plane, color, **WINDOWS, **RIDGES):
        np.testing.assert_allclose(fitted, color, rtol=1e-10)


def test_great_ridges_leave_non_local_means():
    color, variance = planes("uniform", 6, 7, 3), 0.05 * planes("uniform", 6, 7, 3, seed=1)
    plane = np.float64(planes("uniform", 6, 7, 2, seed=2))
    options = WINDOWS | {"ridge": 0.0, "noise_ridge": 1e10, "position_ridge": 1e9}
    fits = ora.first_order_regression(color, variance, plane, np.full(plane.shape, 0.01), color, **options)
    for fitted, radius in zip(fits, (2, 1), strict=True):
        weights = [
            ora.regression_weight(color, variance, dx, dy, patch_radius=1, k=0.8) * ((dx, dy) in ora.disc(radius))
            for dx, dy in oracle.offsets(radius)
        ]
        np.testing.assert_allclose(fitted, oracle.weighted_mean(color, np.stack(weights), radius), atol=1e-7)


def test_regression_without_features():
    color, variance = planes("uniform", 6, 7, 3), 0.05 * planes("uniform", 6, 7, 3, seed=1)
    none = ora.first_order_regression(color, variance, None, None, color, **WINDOWS, **RIDGES)
    empty = np.zeros((6, 7, 0))
    useless = np.concatenate([np.ones((6, 7, 1)), planes("uniform", 6, 7, 1, seed=2)], axis=-1)
    noise = np.full(useless.shape, 1.0 / 12.0)
    for plane, left in ((empty, empty), (useless, noise)):
        fits = ora.first_order_regression(color, variance, plane, left, color, **WINDOWS, **RIDGES)
        for fitted, expected in zip(fits, none, strict=True):
            np.testing.assert_allclose(fitted, expected, rtol=1e-12)
    with_feature = ora.first_order_regression(color, variance, useless, 0.0 * noise, color, **WINDOWS, **RIDGES)
    assert not np.allclose(with_feature[0], none[0])


def test_the_inner_fit_is_that_of_half_the_window_in_the_units_of_the_whole():
    """In units of the whole a position is half as long, so that its ridge weighs four times as much."""
    ridge = 0.05 + 1e-9  # with what is always added
    color, variance = planes("uniform", 9, 11, 3), 0.2 * planes("uniform", 9, 11, 3, seed=1)
    options = {"patch_radius": 1, "k": 1.0, "ridge": 0.1, "noise_ridge": 0.0}
    for stride in (1, 2):
        options["stride"] = stride
        inner = ora.first_order_regression(
            color, variance, None, None, color, search_radius=4, position_ridge=0.05, **options
        )[1]
        small = ora.first_order_regression(
            color, variance, None, None, color, search_radius=2, position_ridge=4.0 * ridge - 1e-9, **options
        )[0]
        np.testing.assert_allclose(inner, small, rtol=1e-10)
        other = ora.first_order_regression(
            color, variance, None, None, color, search_radius=2, position_ridge=0.05, **options
        )[0]
        assert not np.allclose(inner, other, rtol=1e-4)


def test_a_stride_sees_every_third_pixel():
    """Patches of one pixel: the fit of an image of every third pixel, mirrored at the same places."""
    color, variance = planes("uniform", 13, 19, 3), 0.2 * planes("uniform", 13, 19, 3, seed=1)
    options = {"search_radius": 3, "patch_radius": 0, "k": 1.0} | RIDGES
    whole = ora.first_order_regression(color, variance, None, None, color, stride=3, **options)
    every = np.s_[::3, ::3]
    part = ora.first_order_regression(color[every], variance[every], None, None, color[every], **options)
    for fitted, expected in zip(whole, part, strict=True):
        np.testing.assert_allclose(fitted[every], expected, rtol=1e-12)


def test_regression_is_linear_in_the_color_and_reads_its_guide():
    guide, variance = planes("uniform", 6, 7, 3), 0.05 * planes("uniform", 6, 7, 3, seed=1)
    plane = np.float64(planes("uniform", 6, 7, 2, seed=2))
    a, b = np.float64(planes("hdr", 6, 7, 3, seed=3)), np.float64(planes("step", 6, 7, 3))

    def fit(color, guide=guide):
        return ora.first_order_regression(guide, variance, plane, 0.01 * plane, color, **WINDOWS, **RIDGES)[0]

    far = 1e4  # so far above 0 that its clamp does nothing
    assert_close(fit(2.0 * a - b + far), 2.0 * fit(a + far) - fit(b + far), 1e-10)
    assert fit(a - a.mean()).min() >= min(a.min() - a.mean(), 0.0)
    assert not np.allclose(fit(a), fit(a, guide=b))


def test_a_fourth_column_is_fitted_alike_and_may_be_negative():
    guide, variance = planes("uniform", 6, 7, 3), 0.2 * planes("uniform", 6, 7, 3, seed=1)
    plane, color = np.float64(planes("uniform", 6, 7, 2, seed=2)), np.float64(planes("hdr", 6, 7, 3, seed=3))
    both = np.concatenate([color, -color[..., :1]], axis=-1)
    options = WINDOWS | RIDGES
    three = ora.first_order_regression(guide, variance, plane, 0.01 * plane, color, **options)
    four = ora.first_order_regression(guide, variance, plane, 0.01 * plane, both, **options)
    for without, fitted in zip(three, four, strict=True):
        np.testing.assert_allclose(fitted[..., :3], without, rtol=1e-12)
        assert fitted[..., :3].min() >= 0.0
        held = fitted[..., 0] == 0.0
        np.testing.assert_allclose(fitted[..., 3][~held], -fitted[..., 0][~held], rtol=1e-10)
        assert (fitted[..., 3][held] >= 0.0).all()


# --- The second pass --------------------------------------------------------------------------------------

SECOND = {"search_radius": 2, "patch_radius": 1, "stride": 2, "k": 1.5} | RIDGES


def test_second_pass_is_a_regression_on_its_own_guide():
    size = (6, 7)
    first = np.concatenate([planes("uniform", *size, 3), planes("uniform", *size, 1, seed=1) - 0.5], axis=-1)
    first = first.astype(np.float64)
    first[1, 2, :3], first[1, 3, :3], first[4, 4, :3] = 0.0, 2e-5, 2e-7
    # Light of blue alone is all of 1 / 0.0722² noisier; with channels below 0 it would be more, and is not.
    first[2, 1, :3], first[3, 5, :3] = (0.0, 0.0, 0.4), (0.3, -0.08, 0.1)
    plane, noise = np.float64(planes("uniform", *size, 2, seed=2)), np.full((*size, 2), 0.01)
    spread = np.zeros((*size, 1))
    for y, x in np.ndindex(size):
        light = max(first[y, x, :3] @ (0.2126, 0.7152, 0.0722), 1e-6)
        colored = min(sum((c / light) ** 2 for c in first[y, x, :3]), 1.0 / 0.0722**2)
        spread[y, x] = first[y, x, 3] ** 2 * colored
    expected, _ = loop_regression(first[..., :3], loop_mean(spread, 3), plane, noise, first, **SECOND)
    assert_close(ora.second_pass(first, plane, noise, **SECOND), expected, 1e-9)


def test_second_pass_evens_out_what_the_half_difference_explains():
    rng = np.random.default_rng(0)
    halves = 0.5 + 0.03 * rng.normal(size=(2, 48, 48))
    halves[:, :, 24:] += 1.0
    truth = np.where(np.arange(48) < 24, 0.5, 1.5)
    color, d = (halves[0] + halves[1]) / 2, (halves[0] - halves[1]) / 2
    first = np.stack([color, color, color, d], axis=-1)
    options = SECOND | {"search_radius": 3, "stride": 3}
    second = ora.second_pass(first, None, None, **options)
    assert ((second[..., 0] - truth) ** 2).mean() < 0.15 * ((color - truth) ** 2).mean()
    # The half difference of what comes out still tells its variance, and the edge stays.
    np.testing.assert_allclose((second[..., 3] ** 2).mean(), ((second[..., 0] - truth) ** 2).mean(), rtol=0.3)
    assert np.abs(second[..., 0] - truth).max() < 0.1
    # Without any noise only equals are averaged.
    first = np.concatenate([planes("uniform", 9, 9, 3), np.zeros((9, 9, 1))], axis=-1)
    np.testing.assert_allclose(ora.second_pass(first, None, None, **SECOND), first, rtol=1e-6)


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


@pytest.mark.parametrize("n", [1, 2, 3, 7, 40, 200])
@pytest.mark.parametrize("box", [1, 3, 25])
def test_what_a_blur_leaves_in_place(n, box):
    """As three means have it, but for a spline in place of their steps."""
    alone = np.eye(n)[:, :, None]
    for _ in range(3):
        alone = np.stack([ora.wide_box_mean(np.repeat(row[None], 1, 0), box // 2)[0] for row in alone])
    exact = np.diagonal(alone[..., 0])
    np.testing.assert_allclose(ora.left_in_place(n, box), exact, rtol=0.35 if box == 1 else 0.05)


def loop_limited(image, removed, thrice, box):
    """What is given back of removed light, pixel by pixel: what makes no more than 4 % of the light in its place, so a
    twenty-fourth of what is there without it."""
    down, across = (ora.left_in_place(n, box) for n in image.shape[:2])
    limited = removed.copy()
    for _ in range(3):
        level = thrice((image + limited).mean(axis=-1))
        for y, x in np.ndindex(image.shape[:2]):
            alone, own = (down[y] * across[x] * light[y, x].mean() for light in (removed, limited))
            most = max(level[y, x] - own, 0.0) / 24.0
            limited[y, x] = removed[y, x] * (most / alone if alone > most else 1.0)
    return limited


@pytest.mark.parametrize("size", SMALL)
@pytest.mark.parametrize("radius", [1, 3])
@pytest.mark.parametrize("times", [0.01, 1.0])
def test_spread_removed_matches_loops(size, radius, times):
    image, removed = np.float64(planes("uniform", *size, 3)), times * np.float64(planes("hdr", *size, 3))

    def thrice(plane):
        for _ in range(3):
            plane = loop_mean(plane, radius)
        return plane

    light = thrice(loop_limited(image, removed, thrice, 2 * radius + 1))
    level = thrice((image + light / 2.0).sum(axis=-1) / 3.0)
    expected = np.zeros(image.shape)
    for y, x in np.ndindex(size):
        gain = 1.0 + 0.5 * np.mean(light[y, x]) / max(level[y, x], np.mean(light[y, x]), 1e-9)
        expected[y, x] = (image[y, x] + 0.5 * light[y, x]) * gain
    assert_close(ora.spread_removed(image, removed, radius), expected, 1e-12)


@pytest.mark.parametrize("size", [*SMALL, (13, 17), (21, 24)])
@pytest.mark.parametrize("radius", [32, 50])
def test_a_wide_blur_works_on_blocks_of_four(size, radius):
    """50 / 4 rounds to 12. Interpolation as SciPy has it, between the centres of blocks."""
    image, removed = np.float64(planes("uniform", *size, 3)), np.float64(planes("hdr", *size, 3))
    high, wide = -(-size[0] // 4), -(-size[1] // 4)

    def blocks_of(plane):
        labels = (np.arange(size[0])[:, None] // 4) * wide + np.arange(size[1]) // 4
        return scipy.ndimage.mean(plane, labels, np.arange(high * wide)).reshape(high, wide)

    def thrice(plane):
        for _ in range(3):
            plane = ora.wide_box_mean(plane, {32: 8, 50: 12}[radius])
        return plane

    def at_pixels(blocks):
        y, x = np.mgrid[: size[0], : size[1]]
        return scipy.ndimage.map_coordinates(blocks, [(y - 1.5) / 4.0, (x - 1.5) / 4.0], order=1, mode="nearest")

    blocks = [np.stack([blocks_of(plane[..., c]) for c in range(3)], axis=-1) for plane in (image, removed)]
    light = [thrice(c) for c in np.moveaxis(loop_limited(*blocks, thrice, {32: 17, 50: 25}[radius]), -1, 0)]
    level = at_pixels(thrice(blocks_of(image.sum(axis=-1) / 3.0) + sum(light) / 6.0))
    light = np.stack([at_pixels(blocks) for blocks in light], axis=-1)
    mean = light.sum(axis=-1) / 3.0
    expected = (image + 0.5 * light) * (1.0 + 0.5 * mean / np.maximum(np.maximum(level, mean), 1e-9))[..., None]
    assert_close(ora.spread_removed(image, removed, radius), expected, 1e-12)


def test_blocks_serve_from_a_radius_of_32_on():
    """Between the centres of blocks all is linear: two second differences of four are 0."""
    removed = np.zeros((240, 240, 3))
    removed[60:140:4, 60:140:4] = 10.0
    for radius, part in ((31, 1.0), (32, 0.5)):
        bends = np.diff(ora.spread_removed(np.zeros(removed.shape), removed, radius)[140:182, 100, 0], n=2)
        assert (np.abs(bends) > 1e-8).mean() == pytest.approx(part, abs=0.03)
    rough, fine = (ora.spread_removed(np.zeros(removed.shape), removed, radius).sum() for radius in (32, 31))
    np.testing.assert_allclose(rough, fine, rtol=0.01)


def test_spread_removed_gives_all_light_back():
    grey = np.full((20, 20, 3), 0.3)
    np.testing.assert_allclose(ora.spread_removed(grey, np.full(grey.shape, 0.1), 5), 0.4, rtol=1e-12)
    assert np.array_equal(ora.spread_removed(grey, 0.0 * grey, 5), grey)
    assert not ora.spread_removed(0.0 * grey, 0.0 * grey, 5).any()
    removed = np.zeros((61, 61, 3))
    removed[30, 30] = 2.0
    image = 0.5 + 0.1 * np.float64(planes("uniform", 61, 61, 3))
    light = (ora.spread_removed(image, removed, 4) - image).sum(axis=(0, 1)).mean()
    np.testing.assert_allclose(light, 2.0, rtol=0.02)


@pytest.mark.parametrize("times", [1e3, 1e6])
def test_light_that_one_pixel_found_makes_no_veil(times):
    """As many pixels that found as much are believed."""
    image, removed = np.ones((64, 80, 3)), np.zeros((64, 80, 3))
    removed[40, 30] = times
    assert (ora.spread_removed(image, removed, 8) < 1.05).all()
    removed[2::4, 2::4] = times
    assert (ora.spread_removed(image, removed, 8) - image).mean() > removed.mean() / 2
