"""Checks the choice between two images against their halves written out, SciPy, and errors that are known."""

from __future__ import annotations

import numpy as np
import oracle_choice as choice
import pytest
import scipy.ndimage
from inputs import SIZES, planes

SIZE = (96, 96)
OPEN = {"tracking": 0.0, "limit": 1e9}
PLAIN = {"radius": 8, "prior": 0.3, "doubt": 0.0, "margin": 0.0}


def image(halves: np.ndarray) -> np.ndarray:
    """Luminance and half difference of two halves (2, H, W)."""
    return np.stack([(halves[0] + halves[1]) / 2, (halves[0] - halves[1]) / 2], axis=-1)


def noisy(truth: np.ndarray | float, sigma: float, seed: int) -> np.ndarray:
    """Two halves whose mean has the standard deviation sigma."""
    return truth + np.sqrt(2.0) * sigma * np.random.default_rng(seed).normal(size=(2, *SIZE))


def smooth(plane: np.ndarray, radius: int) -> np.ndarray:
    for _ in range(2):
        plane = scipy.ndimage.uniform_filter(np.float64(plane), 2 * radius + 1, mode="mirror")
    return plane


def compared(current, candidate, target, sigma: float, scale=1.0, **options) -> tuple[np.ndarray, np.ndarray]:
    noise = np.full(SIZE, sigma**2)
    images = (image(np.broadcast_to(halves, (2, *SIZE))) for halves in (current, candidate, target))
    return choice.compare(*images, noise, np.broadcast_to(scale, SIZE), **(OPEN | options))


def error(halves: np.ndarray, truth) -> float:
    return ((image(halves)[..., 0] - truth) ** 2).mean()


# --- The comparison ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("tracking", "limit"), [(0.0, 1e9), (0.05, 1.0), (-0.1, 0.0)])
def test_compare_matches_the_halves_written_out(size, tracking, limit):
    (a, b), (a_w, b_w), (a_t, b_t) = (planes("uniform", *size, 2, seed=s).transpose(2, 0, 1) for s in range(3))
    noise, scale = 0.1 * planes("uniform", *size, seed=3), 0.1 + planes("uniform", *size, seed=4)
    images = (image(np.float64(halves)) for halves in ((a, b), (a_w, b_w), (a_t, b_t)))
    g, q = choice.compare(*images, noise, scale, tracking=tracking, limit=limit)
    for y, x in np.ndindex(size):
        reach = limit * np.sqrt(2.0 * np.float64(noise[y, x]))
        held = []
        for other, old, new in ((b_t[y, x], a[y, x], a_w[y, x]), (a_t[y, x], b[y, x], b_w[y, x])):
            bound = reach + abs(float(new) - float(old)) / 2
            held.append(min(max(float(other) - (float(old) + float(new)) / 2, -bound), bound))
        saved = ((a_w[y, x] - a[y, x]) * held[0] + (b_w[y, x] - b[y, x]) * held[1]) / 2
        # What a half differs from the mean of both: variance that the whole image does not have.
        halves = (((a_w - b_w)[y, x] / 2.0) ** 2 - ((a - b)[y, x] / 2.0) ** 2) / 2
        np.testing.assert_allclose(g[y, x] * scale[y, x], tracking * noise[y, x] + saved + halves, atol=1e-6)
        changed = (float(a_w[y, x]) + b_w[y, x] - a[y, x] - b[y, x]) / 2
        np.testing.assert_allclose(q[y, x] * scale[y, x], changed**2, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_compare_measures_half_the_error_saved(seed):
    """Also where the current image is the target itself: one half of it knows nothing of the noise of the other."""
    truth = 2.0 + np.sin(np.arange(96.0) / 9.0)
    target = noisy(truth, 0.4, seed)
    blurred = scipy.ndimage.uniform_filter(target, (0, 5, 5))
    for current, candidate in (
        (target, noisy(truth, 0.1, seed + 10)),
        (noisy(truth, 0.1, seed + 10), target),
        (target, blurred),
        (blurred, blurred + 0.3),
        (noisy(truth + 0.2, 0.2, seed + 20), noisy(truth, 0.3, seed + 30)),
    ):
        g, q = compared(current, candidate, target, 0.4)
        np.testing.assert_allclose(g.mean(), (error(current, truth) - error(candidate, truth)) / 2, atol=0.006)
        np.testing.assert_allclose(q.mean(), ((image(current) - image(candidate))[..., 0] ** 2).mean(), rtol=1e-9)


def test_compare_of_an_image_with_itself_is_the_tracking():
    halves = noisy(1.0, 0.2, 0)
    g, q = compared(halves, halves, noisy(1.0, 0.5, 1), 0.5, scale=2.0, tracking=0.1)
    np.testing.assert_allclose(g, 0.1 * 0.5**2 / 2.0)
    assert not q.any()


def test_compare_holds_outliers_of_the_target_back():
    target = noisy(1.0, 0.1, 0)
    target[0, 40, 40] += 1e3
    current, candidate = noisy(1.0, 0.05, 1), noisy(1.0, 0.02, 2)
    assert np.abs(compared(current, candidate, target, 0.1)[0]).max() > 10.0
    assert np.abs(compared(current, candidate, target, 0.1, limit=3.0)[0]).max() < 0.2


# --- The share --------------------------------------------------------------------------------------------


def test_the_truth_takes_all_and_gives_nothing_away():
    off = noisy(1.6, 0.3, 0)
    truth = np.ones((2, *SIZE))
    target = noisy(1.0, 0.1, 1)
    for options in (PLAIN, PLAIN | {"doubt": 0.1, "margin": 0.02}):
        assert choice.share(*compared(off, truth, target, 0.1), **options).min() > 0.9
        assert choice.share(*compared(truth, off, target, 0.1), **options).max() < 0.1
    # The limit holds noise back, never the difference itself: what is left of the truth is noise alone.
    for limit in (1.0, 8.0):
        assert choice.share(*compared(off, truth, target, 0.1, limit=limit), **PLAIN).mean() > 0.95
        assert choice.share(*compared(truth, off, target, 0.1, limit=limit), **PLAIN).mean() < 0.05


@pytest.mark.parametrize("limit", [0.0, 1.0, 1e9])
@pytest.mark.parametrize("size", SIZES)
def test_without_noise_the_truth_takes_all_exactly(size, limit):
    truth = image(np.float64([planes("hdr", *size)] * 2))
    off = image(np.float64([planes("uniform", *size, seed=s) for s in (1, 2)]))
    arguments = truth, np.zeros(size), 0.1 + planes("uniform", *size, seed=3)
    options = {"tracking": 0.1, "limit": limit}
    shares = choice.share(*choice.compare(off, truth, *arguments, **options), **PLAIN)
    np.testing.assert_allclose(shares, 1.0, atol=1e-6)
    shares = choice.share(*choice.compare(truth, off, *arguments, **options), **PLAIN)
    np.testing.assert_allclose(shares, 0.0, atol=1e-6)


def test_two_equally_noisy_images_share_alike():
    current, candidate = noisy(1.0, 0.2, 0), noisy(1.0, 0.2, 1)
    shares = choice.share(*compared(current, candidate, noisy(1.0, 0.3, 2), 0.3), **PLAIN)
    np.testing.assert_allclose(shares.mean(), 0.5, atol=0.02)
    assert shares.std() < 0.2


@pytest.mark.parametrize(("sigma", "bias"), [(0.1, 0.0), (0.2, 0.1), (0.3, 0.0), (0.15, 0.3)])
def test_the_share_is_the_weight_of_least_error(sigma, bias):
    current, candidate = noisy(1.0, 0.2, 0), noisy(1.0 + bias, sigma, 1)
    weights = np.linspace(0.0, 1.0, 101)
    errors = [error((1.0 - a) * current + a * candidate, 1.0) for a in weights]
    best = weights[np.argmin(errors)]
    shares = choice.share(*compared(current, candidate, noisy(1.0, 0.3, 2), 0.3), **PLAIN | {"radius": 20})
    np.testing.assert_allclose(shares.mean(), best, atol=0.06)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("radius", [0, 2])
def test_share_matches_scipy(size, radius):
    g, q = planes("uniform", *size) - 0.4, planes("uniform", *size, seed=1)
    prior, doubt, margin = 0.2, 0.7, 0.1
    # SciPy mirrors a single row or column as well.
    gs, qs, squares = smooth(g, radius), smooth(q, radius), smooth(np.float64(g) ** 2, radius)
    sd = np.sqrt(np.maximum(squares - gs**2, 0.0))
    wanted = (gs - margin * sd) / (qs + 1e-11) + 0.5
    unknown = doubt * sd + 1e-10
    doubtful = unknown**2 / (unknown**2 + (qs + 1e-11) ** 2)
    expected = np.clip(wanted + doubtful * (prior - wanted), 0.0, 1.0)
    actual = choice.share(g, q, radius=radius, prior=prior, doubt=doubt, margin=margin)
    # sd is the root of a difference: rounding makes it 1e-8 where it is 0.
    np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_doubt_leads_to_the_prior_and_a_margin_against_the_candidate():
    g, q = compared(noisy(1.0, 0.2, 0), noisy(1.0, 0.15, 1), noisy(1.0, 0.3, 2), 0.3)
    plain = choice.share(g, q, **PLAIN)
    np.testing.assert_allclose(choice.share(g, q, **PLAIN | {"doubt": 1e6}), PLAIN["prior"], atol=1e-6)
    assert (choice.share(g, q, **PLAIN | {"margin": 0.1}) < plain).all()
    between = choice.share(g, q, **PLAIN | {"doubt": 0.5})
    assert ((between - plain) * (PLAIN["prior"] - plain) >= 0.0).all() and not np.allclose(between, plain)


def test_equal_images_share_as_the_prior_says():
    zero = np.zeros((5, 6))
    for doubt, margin in ((0.0, 0.0), (1.0, 1.0)):
        for prior in (0.0, 0.5, 0.9):
            shares = choice.share(zero, zero, radius=1, prior=prior, doubt=doubt, margin=margin)
            np.testing.assert_allclose(shares, prior, atol=0.011)
            # A relative difference of 1e-4 counts as one.
            better = choice.share(zero + 5e-9, zero + 1e-8, radius=1, prior=prior, doubt=doubt, margin=0.0)
            np.testing.assert_allclose(better, 1.0, atol=2e-3)


# --- The error that is left -------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.1, 0.4])
@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("bias", [0.0, 0.2])
def test_estimated_error_is_near_the_error(sigma, weight, bias):
    truth = 2.0 + np.sin(np.arange(96.0) / 9.0)
    target = noisy(truth, sigma, 0)
    scale = np.broadcast_to(truth**2 + 0.01, SIZE)
    for current in (noisy(truth + bias, 0.1, 1), scipy.ndimage.uniform_filter(target, (0, 3, 3)) + bias):
        mix = image((1.0 - weight) * current + weight * target)[..., 0]
        estimate = choice.estimated_error(image(current), image(target), weight, scale, radius=12)
        expected = ((mix - truth) ** 2 / scale).mean()
        np.testing.assert_allclose(estimate.mean(), expected, rtol=0.1, atol=0.02 * sigma**2)


def test_estimated_error_of_the_best_share_is_the_least_and_near_the_error():
    target, current = noisy(1.0, 0.2, 0), noisy(1.1, 0.15, 1)
    best = choice.share(*compared(current, target, target, 0.2), **PLAIN)

    def estimated(weight):
        return choice.estimated_error(image(current), image(target), weight, np.ones(SIZE), radius=8)

    estimate = estimated(best)
    for weight in (best - 0.05, best + 0.05, 0.0, 1.0):
        assert estimated(weight).mean() > estimate.mean()
    mix = image((1.0 - best) * current + best * target)[..., 0]
    np.testing.assert_allclose(estimate.mean(), ((mix - 1.0) ** 2).mean(), rtol=0.1)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("radius", [0, 2])
def test_estimated_error_matches_the_halves_written_out(size, radius):
    """Each half against the other half of the target, less the noise of that and what a half has more than both."""
    x, t = (np.float64(planes("uniform", *size, 2, seed=s)).transpose(2, 0, 1) for s in (0, 1))
    h, scale = np.float64(planes("uniform", *size, seed=2)), 0.1 + np.float64(planes("uniform", *size, seed=3))
    noise, left = ((t[0] - t[1]) / 2.0) ** 2, ((x[0] - x[1]) / 2.0) ** 2
    across = ((x[0] - t[1]) ** 2 + (x[1] - t[0]) ** 2) / 2.0
    own = np.maximum(smooth((across - 2.0 * noise - left) / scale, radius), smooth(left / scale, radius))
    between = smooth((x.mean(axis=0) - t.mean(axis=0)) ** 2 / scale, radius)
    expected = (1.0 - h) * own + h * smooth(noise / scale, radius) - h * (1.0 - h) * between
    actual = choice.estimated_error(image(x), image(t), h, scale, radius=radius)
    np.testing.assert_allclose(actual, np.maximum(expected, 0.0), atol=1e-9)


def test_estimated_error_is_at_least_the_variance_left():
    target = noisy(1.0, 0.1, 0)
    # By chance or because the filter follows the noise it seems to have no error.
    current = np.stack([target[1] + 0.03, target[0] - 0.03])
    estimate = choice.estimated_error(image(current), image(target), 0.0, np.ones(SIZE), radius=2)
    np.testing.assert_allclose(estimate, smooth(image(current)[..., 1] ** 2, 2), rtol=1e-9)
