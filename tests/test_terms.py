"""Which features and which of their principal components serve a block, on the device against float64.

What is left out is so by a threshold, and components are found to a thousandth: every input here keeps clear of both.
"""

import inputs
import numpy as np
import oracle_terms as theory
import pyopencl as cl
import pytest
from transfer import scalars, to_planes

from mcdenoise_cl.device import SCHEDULE_VARIABLE, SCHEDULES, context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.stages.terms import choose_terms


class Blocks:
    """What terms.h says of each block, (down, across, ...), and for each feature how many blocks use it."""

    def __init__(self, engine, features, noise, reach):
        n = features.shape[-1]
        terms = choose_terms(engine, to_planes(engine, features), to_planes(engine, noise), reach)
        floats = scalars(engine, terms.blocks, (2 * n + 1 + n * n) * terms.down * terms.across)
        floats = floats.reshape(terms.down, terms.across, -1).astype(np.float64)
        self.mean, self.count = floats[..., :n], floats[..., n].astype(int)
        self.variance = floats[..., n + 1 : 2 * n + 1]
        self.direction = floats[..., 2 * n + 1 :].reshape(terms.down, terms.across, n, n)
        self.used = scalars(engine, terms.used, n, np.int32)

    def __iter__(self):
        """(mean, variance, direction) of the components that are used, block by block."""
        for at in np.ndindex(self.count.shape):
            count = self.count[at]
            yield self.mean[at], self.variance[at][:count], self.direction[at][:count]


def mixed(height, width, variances, count, seed):
    """Features that are turned from independent ones of these variances; the rest of `count` say nothing new."""
    rng = np.random.default_rng(seed)
    own = rng.standard_normal((height, width, len(variances))) * np.sqrt(variances)
    turned = np.linalg.qr(rng.standard_normal((count, count)))[0][:, : len(variances)]
    return (0.3 + own @ turned.T).astype(np.float32)


@pytest.mark.parametrize(("height", "width"), [(8, 32), (19, 70), (5, 9)])
@pytest.mark.parametrize(
    ("variances", "count"),
    [
        ([0.1], 1),
        ([0.3, 0.02], 2),
        ([0.3, 0.1, 0.03], 3),
        ([1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3], 7),
        ([0.2] * 7, 7),
        ([1.0, 1e-2, 1e-4], 7),
        ([0.1, 0.1], 7),
    ],
)
@pytest.mark.parametrize("reach", [1, 9])
def test_components_are_eigenvectors(engine, height, width, variances, count, reach):
    """Along what says nothing new there is noise, too much to use it; along the rest far from enough."""
    features = mixed(height, width, variances, count, seed=count)
    noise = np.full(features.shape, 1e-5, np.float32)
    blocks = Blocks(engine, features, noise, reach)
    statistics = theory.statistics_of_blocks(features.astype(np.float64), noise.astype(np.float64), reach)
    for found, (_, mean, covariance, left) in zip(blocks, statistics, strict=True):
        _, expected, vectors = theory.components(covariance, left)
        vectors = vectors[expected > 0]
        expected = expected[expected > 0]
        own, variance, direction = found
        assert len(variance) == len(expected) == len(variances)
        np.testing.assert_allclose(own, mean, atol=1e-5)
        np.testing.assert_allclose(direction @ direction.T, np.eye(len(variance)), atol=1e-5)
        np.testing.assert_allclose(np.sort(variance), expected[::-1], rtol=3e-3)
        np.testing.assert_allclose(direction.T @ direction, vectors.T @ vectors, atol=3e-3)
        scale = np.sqrt(variance[:, None] * variance)
        np.testing.assert_allclose(direction @ covariance @ direction.T / scale, np.eye(len(variance)), atol=2e-3)
    assert (blocks.used == blocks.count.size).all()


def test_a_component_of_features_all_of_the_same_is_left_out_by_their_noise(engine):
    """The channels of a grey albedo: of three components one carries something."""
    rng = np.random.default_rng(0)
    grey = rng.random((16, 64, 1)) + 0.01 * rng.standard_normal((16, 64, 3))
    for noise, count in ((1e-6, 3), (1e-3, 1)):
        blocks = Blocks(engine, grey, np.full(grey.shape, noise), 3)
        assert (blocks.count == count).all() and (blocks.used == 4).all()
        for _, variance, direction in blocks:
            k = np.argmax(variance)
            np.testing.assert_allclose(np.abs(direction[k]), 3**-0.5, atol=2e-3)
            assert len(variance) == 1 or np.sort(variance)[1] < 2e-3 * variance[k]


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize(("height", "width"), [(1, 5), (2, 2), (3, 2), (2, 3)])
@pytest.mark.parametrize("reach", [3, 4, 7])
def test_rounding_is_no_component(device, monkeypatch, schedule, height, width, reach):
    """Six pixels or fewer tell seven features apart in five directions at most: float32 finds more, by rounding."""
    monkeypatch.setenv(SCHEDULE_VARIABLE, schedule)
    engine = Engine(cl.CommandQueue(context_for(device), device))
    for seed in range(3):
        scene = inputs.features(height, width, seed=seed)
        features = np.concatenate([scene["albedo"], scene["normal"], np.atleast_3d(scene["depth"]) / 4], axis=-1)
        blocks = Blocks(engine, features, np.zeros_like(features), reach)
        _, _, covariance, left = next(theory.statistics_of_blocks(features.astype(np.float64), 0 * features, reach))
        assert blocks.count.tolist() == [[np.count_nonzero(theory.components(covariance, left)[1])]]


def test_features_that_carry_nothing_are_left_out(engine):
    """One constant, one of noise alone, one constant in the left half only; 64x24 pixels are 2x3 blocks."""
    rng = np.random.default_rng(0)
    features = np.zeros((24, 64, 3), np.float32)
    features[..., 0] = 0.7
    features[..., 1] = 0.1 * rng.standard_normal((24, 64))
    features[:, 40:, 2] = rng.random((24, 24))
    left = np.zeros_like(features)
    left[..., 1] = 0.01
    for reach, columns in ((7, [0, 1]), (9, [1, 1])):  # 40 - 31 = 9 pixels from the left blocks
        blocks = Blocks(engine, features, left, reach)
        assert blocks.used.tolist() == [0, 0, 3 * sum(columns)]
        np.testing.assert_array_equal(blocks.count, [columns] * 3)
        terms = theory.terms_of_blocks(features, left, reach)
        np.testing.assert_allclose(blocks.mean, terms.mean[::8, ::32], atol=1e-6)
        np.testing.assert_array_equal(terms.used[::8, ::32, 2], blocks.count)
        expected = terms.variance[::8, ::32].max(axis=-1)[blocks.count > 0]
        np.testing.assert_allclose(blocks.variance[..., 0][blocks.count > 0], expected, rtol=1e-4)
        for _, _, direction in blocks:
            assert not direction[:, :2].any() and (np.abs(direction[:, 2]) == 1).all()


@pytest.mark.parametrize(("reach", "blocks"), [(1, [0, 1, 0]), (2, [1, 1, 0]), (30, [1, 1, 1])])
def test_features_left_out_have_no_weight_beside_others(engine, reach, blocks):
    """Correlated with the others, but noisier than half its variance: where, the block says; the last one is cut off.

    The step of the first feature lies at column 33.
    """
    rng = np.random.default_rng(1)
    common = rng.standard_normal((8, 70, 1))
    features = (common * [0.1, 0.2, 0.3, 0.0] + 0.05 * rng.standard_normal((8, 70, 4))).astype(np.float32)
    features[..., 0] = np.arange(70) >= 33
    noise = np.full(features.shape, 1e-4, np.float32)
    noise[..., 2] = 0.09
    found = Blocks(engine, features, noise, reach)
    assert found.used.tolist() == [sum(blocks), 3, 0, 3]
    for used, (_, _, direction) in zip(blocks, found, strict=True):
        assert len(direction) == 2 + used
        assert not direction[:, 2].any() and (direction[:, 0].any() == used)
        np.testing.assert_allclose(direction @ direction.T, np.eye(2 + used), atol=1e-5)


def test_noise_counts_along_each_component(engine):
    """As much of each feature's as the component has of it; where a threshold is near, another draw is taken."""
    dropped = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        features = mixed(8, 32, [1.0, 0.5, 0.05, 0.03, 0.02], 5, seed)
        noise = np.broadcast_to(rng.choice([1e-3, 0.15], 5), features.shape).astype(np.float32)
        ((_, _, covariance, left),) = theory.statistics_of_blocks(features.astype(np.float64), noise, 1)
        used, _, _ = theory.components(covariance, left)
        variance, vectors = np.linalg.eigh(covariance)
        ratio = variance / (vectors.T**2 @ left)
        if not used.all() or (np.diag(covariance) < 2.2 * left).any() or (np.abs(np.log(ratio / 0.5)) < 0.1).any():
            continue
        blocks = Blocks(engine, features, noise, 1)
        assert blocks.used.tolist() == [1] * 5
        assert blocks.count[0, 0] == (ratio > 0.5).sum()
        np.testing.assert_allclose(
            np.sort(blocks.variance[0, 0][: blocks.count[0, 0]]), variance[ratio > 0.5], rtol=3e-3
        )
        dropped.append(5 - blocks.count[0, 0])
    assert len(dropped) > 5 and 0.3 < np.mean(dropped) < 4


@pytest.mark.parametrize("order", [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)])
@pytest.mark.parametrize(("variance", "kept"), [(0.0205, True), (0.0135, False)])
def test_a_third_of_a_noisy_feature_is_a_third_of_its_noise(engine, order, variance, kept):
    """The first component holds a third of each feature, one of which has a noise of 0.1: half of that third counts."""
    directions = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])
    own = np.random.default_rng(0).standard_normal((8, 32, 3))
    own = own @ np.linalg.inv(np.linalg.cholesky(np.cov(own.reshape(-1, 3).T, bias=True))).T
    features = (own * np.sqrt([variance, 0.1, 0.5])) @ directions
    noise = np.broadcast_to([0.0, 0.1, 0.0], features.shape)
    blocks = Blocks(engine, features[..., order], noise[..., order], 0)
    assert blocks.used.tolist() == [1, 1, 1] and blocks.count[0, 0] == 2 + kept
