"""How much of its noise a frame keeps: whether it is looked for, what is added, and that the answer tells."""

import inputs
import numpy as np
import oracle_auto
import oracle_regression
import pytest
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl.stages.response import PART, disturb, disturb_by_halves, look_for_noise
from mcdenoise_cl.stages.rows import Rows, cut

#: Rows longer than a work-item counts, besides the usual sizes.
SIZES = (*inputs.SIZES, (3, 300), (2, 513))


def noisy_planes(height, width, size, noise):
    """Colours, of which some are dark, and planes that tell this much noise; none, or none known, here and there."""
    color = inputs.planes("textured", height, width, 3) + np.float32(1e-3)
    rng = np.random.default_rng([height, width])
    deviation = size * color * rng.uniform(0.5, 1.5, (height, width, 1))
    deviation[rng.random((height, width)) < 0.3] = 0
    if noise == "variance":
        variance = (deviation**2).astype(np.float32)
        variance[rng.random((height, width)) < 0.2] = -1
        return color, {"color_variance": variance}
    return color, {"color_a": (color + deviation).astype("f4"), "color_b": (color - deviation).astype("f4")}


def asked(engine, color, planes, most):
    """What is said of a frame that comes in bands of so many rows."""
    bands = []
    for rows in cut(color.shape[0], most, 0, 1):
        own = slice(rows.start, rows.stop)
        noise = [to_planes(engine, plane[own]) for plane in planes.values()]
        bands.append((to_planes(engine, color[own]), noise, rows))
    return look_for_noise(engine, bands)()


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("noise", ["variance", "halves"])
@pytest.mark.parametrize("size", [0.01, 0.029, 0.031, 0.1])
def test_a_frame_is_quiet_where_most_of_its_noise_is_little(engine, height, width, size, noise):
    color, planes = noisy_planes(height, width, size, noise)
    expected = oracle_auto.is_quiet(color, planes)
    assert expected == {0.01: True, 0.1: False}.get(size, expected) or height * width < 20
    assert asked(engine, color, planes, height) == expected
    assert asked(engine, color, planes, 2) == expected


def test_without_noise_there_is_nothing_to_look_for(engine):
    color = inputs.planes("uniform", 13, 17, 3)
    for nothing in (0.0, -1.0):
        assert not asked(engine, color, {"color_variance": np.full_like(color, nothing)}, 13)
    assert not asked(engine, color, {"color_a": color, "color_b": color}, 13)


def test_rows_around_a_band_are_not_counted(engine):
    color, loud, low = np.ones((8, 9, 3)), np.full((8, 9, 3), 0.1), np.full((8, 9, 3), 1e-6)
    variance = np.concatenate([loud[:3], low[:2], loud[:3]])
    bands = [(to_planes(engine, color), [to_planes(engine, variance)], Rows(10, 18, 13, 15))]
    assert look_for_noise(engine, bands)()


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", ["uniform", "hdr"])
def test_what_is_added_is_a_part_of_the_noise(engine, height, width, kind):
    color, variance = inputs.planes(kind, height, width, 3), inputs.planes(kind, height, width, 3, seed=1) - 0.1
    got = to_array(engine, disturb(engine, to_planes(engine, color), to_planes(engine, variance)))
    close(got, oracle_auto.disturb(color.astype(np.float64), variance.astype(np.float64)))
    below = to_array(engine, disturb(engine, to_planes(engine, color[2:]), to_planes(engine, variance[2:]), 2))
    np.testing.assert_array_equal(below, got[2:])


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_halves_tell_what_noise_looks_like(engine, height, width):
    color, a, b = (inputs.planes("hdr", height, width, 3, seed=seed) for seed in range(3))
    factor = inputs.planes("uniform", height, width)
    given = [to_planes(engine, plane) for plane in (color, a, b, factor)]
    got = to_array(engine, disturb_by_halves(engine, *given, engine.constant([0.3])))
    close(got, oracle_auto.disturb_by_halves(color.astype(np.float64), a, b, 0.3 * factor.astype(np.float64)))


def test_the_answer_is_what_a_pixel_does_to_its_own_result():
    """The trace of the derivatives, found by moving one pixel after the other, in float64."""
    rng = np.random.default_rng(0)
    grain = 1 + 0.03 * rng.standard_normal((12, 14, 1))
    color, variance = 0.5 * grain * np.ones(3), np.full((12, 14, 1), 3 * 0.01**2)
    window = {"search_radius": 3, "patch_radius": 1, "k": 0.72}
    ridges = {"ridge": 0.02, "noise_ridge": 5.0, "position_ridge": 0.1}

    def fitted(image):
        return oracle_regression.first_order_regression(image, variance, None, None, image, **window, **ridges)[0][
            ..., 0
        ]

    before, trace, step = fitted(color), 0.0, 1e-4
    for y, x in np.ndindex(12, 14):
        moved = color.copy()
        moved[y, x] += step
        trace += (fitted(moved) - before)[y, x] / step
    kept, tries = 0.0, 60
    for _ in range(tries):
        added = PART * 0.01 * rng.standard_normal((12, 14, 1))
        kept += np.sum((fitted(color + added) - before) * added[..., 0]) / np.sum(added**2) / tries
    assert 0.1 < kept < 0.95
    assert kept == pytest.approx(trace / before.size, rel=0.05)
