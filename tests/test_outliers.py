"""Outliers held back, and their light given back, on the device against the equations in float64."""

import numpy as np
import oracle_regression as theory
import pytest
from test_regression import CASES, noise
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl.methods.features import hold_back_outliers
from mcdenoise_cl.stages import outliers


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize(("limit", "significant"), [(1.0, np.inf), (2.5, np.inf), (1.0, 2.0), (1.5, 2.0)])
@pytest.mark.parametrize("by_chance", [True, False])
def test_outliers(engine, image, limit, significant, by_chance):
    image = image - 0.1
    expected, factor = theory.outliers(image, limit, noise(image), significant, by_chance)
    color, spread = to_planes(engine, image), to_planes(engine, noise(image))
    removed, scaled = outliers.scale_outliers(engine, color, spread, limit, significant, by_chance)
    close(to_array(engine, color), expected)
    close(to_array(engine, removed), image - expected, scale=np.abs(image).max())
    close(to_array(engine, scaled), factor)
    close(to_array(engine, spread), noise(image) * factor[..., None] ** 2)


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize(("limit", "significant"), [(1.0, 1.0), (1.1, 4.0), (1.1, np.inf)])
@pytest.mark.parametrize("by_chance", [True, False])
def test_groups_of_outliers(engine, image, limit, significant, by_chance):
    """Of one to six pixels, of one sample each or of many."""
    image, variance = image.copy(), noise(image)
    rng = np.random.default_rng(5)
    for _ in range(1 + image[..., 0].size // 60):
        y, x = (rng.integers(0, n) for n in image.shape[:2])
        where = (slice(y, y + rng.integers(1, 3)), slice(x, x + rng.integers(1, 4)))
        image[where] += 100.0
        variance[where] = rng.choice([1.0, 0.1]) * image[where] ** 2
    expected, factor = theory.outliers(image, limit, variance, significant, by_chance)
    color, spread = to_planes(engine, image), to_planes(engine, variance)
    _, scaled = outliers.scale_outliers(engine, color, spread, limit, significant, by_chance)
    close(to_array(engine, color), expected)
    close(to_array(engine, scaled), factor)


@pytest.mark.parametrize(("deviations", "stays"), [(1.4, False), (1.6, True)])
@pytest.mark.parametrize(("size", "goes"), [((1, 2), True), ((2, 2), True), ((1, 4), True), ((2, 3), False)])
def test_a_group_of_four_at_most_goes_if_it_is_uncertain(engine, size, goes, deviations, stays):
    image = np.full((12, 14, 3), 1, np.float32)
    variance = np.zeros_like(image)
    where = slice(5, 5 + size[0]), slice(6, 6 + size[1])
    image[where] = 101.0
    variance[where] = (100.0 / deviations) ** 2 / 3
    color, spread = to_planes(engine, image), to_planes(engine, variance)
    hold_back_outliers(engine, {"color_variance": None}, color, spread, 1.1)
    after = to_array(engine, color)[where]
    np.testing.assert_allclose(after, 101.0 if stays or not goes else 1.1, rtol=1e-6)


def test_an_outlier_among_negative_pixels_becomes_black(engine):
    image = np.full((5, 20, 3), -0.1, np.float32)
    image[2, 17] = 1.0
    color, spread = to_planes(engine, image), to_planes(engine, noise(image))
    _, factor = outliers.scale_outliers(engine, color, spread, 1.1, np.inf)
    np.testing.assert_array_equal(to_array(engine, factor), image[..., 0] < 0)
    np.testing.assert_array_equal(to_array(engine, color), np.minimum(image, 0))


@pytest.mark.parametrize("names", [("color_variance",), ("color_a", "color_b"), ()], ids=["variance", "halves", "none"])
def test_a_light_stands_out_by_more_than_outliers_do(engine, names):
    """Of 1 beside it, by three of its standard deviations, where these are known."""
    planes = dict.fromkeys(names)
    for deviations, stays in ((2.9, False), (3.1, bool(names))):
        image = np.full((5, 6, 3), 1, np.float32)
        image[2, 3] += 0.01 * deviations
        variance = np.zeros(image.shape, np.float32)
        variance[2, 3] = 0.01**2 / 3
        color, spread = to_planes(engine, image), to_planes(engine, variance)
        hold_back_outliers(engine, planes, color, spread, 1.01)
        assert to_array(engine, color)[2, 3, 0] == pytest.approx(image[2, 3, 0] if stays else 1.01)
    assert theory.significance(names) == (3.0 if names else np.inf)


@pytest.mark.parametrize("image", CASES)
@pytest.mark.parametrize("radius", [1, 5, 31, 32, 50])
def test_spread_removed(engine, image, radius):
    rng = np.random.default_rng(2)
    removed = (image * (rng.random(image.shape[:2]) < 0.2)[..., None]).astype(np.float32)
    out, _ = outliers.spread_removed(engine, to_planes(engine, image), to_planes(engine, removed), radius)
    close(to_array(engine, out), theory.spread_removed(image, removed, radius))


def test_the_energy_of_a_firefly_is_kept(engine):
    image = np.full((80, 80, 3), 0.5, np.float32)
    image[40, 40] = 20.0
    color, spread = to_planes(engine, image), to_planes(engine, np.zeros_like(image))
    removed, _ = outliers.scale_outliers(engine, color, spread, 1.0, np.inf)
    out = to_array(engine, outliers.spread_removed(engine, color, removed, 12)[0])
    assert out.sum() == pytest.approx(image.sum(), rel=1e-3)
    assert out.max() < 0.7
