"""Checks which features and components serve a block against loops, singular values, and by what it is for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import oracle_terms as ora
import pytest
from inputs import planes

#: (height, width): one pixel, one row, one column, smaller than a reach, of odd size, and of four blocks.
SIZES = ((1, 1), (1, 9), (7, 1), (3, 2), (6, 7), (9, 40))


def mirror(i: int, n: int) -> int:
    """Walk back and forth between the first and the last pixel until `i` is inside."""
    while n > 1 and not 0 <= i < n:
        i = -i if i < 0 else 2 * (n - 1) - i
    return i if n > 1 else 0


def at(image: np.ndarray, y: int, x: int) -> np.ndarray:
    return np.float64(image[mirror(y, image.shape[0]), mirror(x, image.shape[1])])


class LoopTerms(NamedTuple):
    mean: np.ndarray
    used: np.ndarray
    variance: list[float]
    direction: np.ndarray  # the used components alone, a row each


def loop_terms(plane: np.ndarray, noise: np.ndarray, y: int, x: int, reach: int) -> LoopTerms:
    """Those of the block of one pixel, from the singular values of its features."""
    rows, columns = range(y - y % 8, y - y % 8 + 8), range(x - x % 32, x - x % 32 + 32)
    around = np.array(
        [
            at(plane, j, i)
            for j in range(rows.start - reach, rows.stop + reach)
            for i in range(columns.start - reach, columns.stop + reach)
        ]
    )
    inside = [noise[j, i] for j, i in np.ndindex(noise.shape[:2]) if j in rows and i in columns]
    mean, left = np.mean(around, axis=0), np.mean(inside, axis=0)
    used = (np.var(around, axis=0) > 1e-8) & (np.var(around, axis=0) > 2.0 * left)
    singular, vectors = np.linalg.svd((around - mean) * used, full_matrices=False)[1:]
    variance = singular**2 / len(around)
    kept = [k for k, v in enumerate(vectors) if variance[k] > max(1e-8, 0.5 * sum(v**2 * left))]
    return LoopTerms(mean, used, list(variance[kept]), vectors[kept].reshape(len(kept), plane.shape[-1]))


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("reach", [0, 2, 9])
def test_terms_of_blocks_match_a_loop(size, reach):
    plane = np.concatenate([planes(kind, *size, 1) for kind in ("uniform", "constant", "textured")], axis=-1)
    noise = 0.06 * np.float64(planes("uniform", *size, 3, seed=1)) ** 2
    terms = ora.terms_of_blocks(plane, noise, reach)
    for y in range(0, size[0], 3):
        for x in range(0, size[1], 5):
            expected, count = loop_terms(plane, noise, y, x, reach), (terms.variance[y, x] > 0.0).sum()
            np.testing.assert_allclose(terms.mean[y, x], expected.mean, atol=1e-12)
            assert np.array_equal(terms.used[y, x], expected.used) and count == len(expected.variance)
            np.testing.assert_allclose(sorted(terms.variance[y, x])[::-1][:count], expected.variance, atol=1e-12)
            projector = terms.direction[y, x].T @ terms.direction[y, x]
            np.testing.assert_allclose(projector, expected.direction.T @ expected.direction, atol=1e-9)


@pytest.mark.parametrize("count", [1, 3, 7])
def test_all_components_are_a_rotation_of_the_features(count):
    rng = np.random.default_rng(count)
    square = rng.normal(size=(count, count))
    covariance = square @ square.T
    used, variance, direction = ora.components(covariance, np.zeros(count))
    assert used.all() and (np.diff(variance) <= 0.0).all()
    np.testing.assert_allclose(direction @ direction.T, np.eye(count), atol=1e-12)
    np.testing.assert_allclose(direction.T * variance @ direction, covariance, atol=1e-12)


def test_features_that_say_the_same_are_one_component():
    """Twice the same feature is one term, in the middle of both; noise along a direction is that of its features."""
    same = np.array([[4.0, 4.0, 0.0], [4.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    used, variance, direction = ora.components(same, np.array([0.1, 0.1, 0.1]))
    assert used.all()
    np.testing.assert_allclose(variance, (8.0, 1.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(np.abs(direction), [[0.5**0.5, 0.5**0.5, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    # Two features of noise 0.4 and a difference of variance 0.16, 0.24: below and above half the noise of 0.4.
    for little, kept in ((0.16, False), (0.24, True)):
        nearly = np.array([[1.0, 1.0 - little], [1.0 - little, 1.0]])
        variance = ora.components(nearly, np.array([0.4, 0.4]))[1]
        np.testing.assert_allclose(variance, (2.0 - little, little if kept else 0.0))


@pytest.mark.parametrize(("noise", "used"), [(0.49, True), (0.51, False)])
def test_a_feature_of_too_much_noise_takes_no_part_in_any_component(noise, used):
    covariance = np.array([[1.0, 0.9], [0.9, 1.0]])
    which, variance, direction = ora.components(covariance, np.array([noise, 0.0]))
    assert which.tolist() == [used, True]
    if not used:
        np.testing.assert_allclose(variance, (1.0, 0.0))
        np.testing.assert_allclose(np.abs(direction), [[0.0, 1.0], [0.0, 0.0]])


def test_a_feature_that_is_constant_or_its_own_noise_serves_no_block():
    rng = np.random.default_rng(0)
    ramp = np.arange(64.0) / 64.0 * np.ones((32, 1))
    white = rng.normal(0.0, 0.1, (32, 64))
    plane = np.stack([np.full((32, 64), 0.1), white, white, ramp, ramp + white], axis=-1)
    noise = np.broadcast_to([0.0, 0.1**2, 0.1**2 / 3.0, 0.0, 0.0], plane.shape)
    terms = ora.terms_of_blocks(plane, noise, 0)
    assert not terms.used[..., :2].any() and terms.used[..., 2:].all()
    # Of the three that are used the last is the sum of the others.
    assert ((terms.variance > 0.0).sum(axis=-1) == 2).all() and not terms.direction[..., :2].any()
    np.testing.assert_allclose(terms.mean[0, [0, 31, 32, 63], 3], (0.2422, 0.2422, 0.7422, 0.7422), atol=1e-4)


def test_a_feature_serves_the_blocks_that_its_change_is_within_reach_of():
    plane = np.zeros((16, 100, 1))
    plane[:, 34:] = 1.0
    clean = np.zeros(plane.shape)
    used = ora.terms_of_blocks(plane, clean, 2).used
    assert not used[:, :32].any() and used[:, 32:64].all() and not used[:, 64:].any()
    assert ora.terms_of_blocks(plane, clean, 3).used[0, :64].all()
    plane[:] = 0.0
    plane[10:] = 1.0
    used = ora.terms_of_blocks(plane, clean, 2).used
    assert not used[:8].any() and used[8:].all()
    assert ora.terms_of_blocks(plane, clean, 3).used.all()
    # A last block of few pixels is filled with mirrored ones, here zeros.
    plane = np.zeros((8, 33, 1))
    plane[:, 32] = 1.0
    terms = ora.terms_of_blocks(plane, np.zeros(plane.shape), 0)
    np.testing.assert_allclose(terms.mean[0, [0, 32], 0], (0.0, 1.0 / 32.0))
    np.testing.assert_allclose(terms.variance[0, [0, 32], 0], (0.0, 31.0 / 32.0**2))
    np.testing.assert_allclose(np.abs(terms.direction[0, [0, 32], 0, 0]), (0.0, 1.0))
    assert not terms.used[:, :32].any() and terms.used[:, 32].all()
