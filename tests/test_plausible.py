"""A filtered frame held to what the noise of its input explains, on the device against the equations in float64."""

from dataclasses import replace

import inputs
import numpy as np
import oracle_plausible as theory
import pyopencl as cl
import pytest
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl.device import context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.stages.plausible import keep_plausible

#: Whole blocks of eight, one pixel more and one less, beside the usual sizes.
SIZES = (*inputs.SIZES, (8, 16), (9, 17), (23, 31), (40, 72))


@pytest.fixture(scope="module", params=[1, 16], ids=lambda width: f"width {width}")
def engine(request, device):
    """Single floats, and vectors longer than a block."""
    engine = Engine(cl.CommandQueue(context_for(device), device))
    engine.shape = replace(engine.shape, width=request.param)
    return engine


def kept(engine, filtered, frame, variance, share=None, likely=3.0):
    """The frame and the share of the input, as the stage leaves them; the share is 0 before if not given."""
    share = np.zeros(frame.shape[:2]) if share is None else share
    planes, parts = to_planes(engine, filtered), to_planes(engine, share)
    given = to_planes(engine, frame), to_planes(engine, variance)
    keep_plausible(engine, planes, *given, parts, likely=likely)
    np.testing.assert_array_equal(to_array(engine, given[0]), frame)
    return to_array(engine, planes), to_array(engine, parts)


def input_of(kind, height, width):
    """A colour and a half difference; `scene` is the synthetic rendering, anything else a kind of image."""
    if kind == "scene":
        color = inputs.features(height, width, seed=1)["color"]
        return np.concatenate([color, 0.1 * inputs.planes("uniform", height, width, 1)], axis=-1)
    return inputs.planes(kind, height, width, 4)


def filter_of(frame, size, part=0.05, seed=2):
    """The frame with errors here and there, normal ones of `size` times the pixel."""
    rng = np.random.default_rng(seed)
    change = size * rng.standard_normal(frame.shape) * (rng.random((*frame.shape[:2], 1)) < part)
    return (frame * (1 + change)).astype(np.float32)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", [*inputs.KINDS, "scene"])
@pytest.mark.parametrize(
    ("deviation", "likely", "part"), [(0.1, 3.0, 0.05), (0.3, 0.5, 0.05), (0.01, 20.0, 0.05), (0.1, 3.0, 1.0)]
)
def test_it_is_the_equation(engine, kind, height, width, deviation, likely, part):
    """Single errors, of which the largest counts, or errors everywhere, of which the mean does."""
    frame = input_of(kind, height, width)
    filtered = filter_of(frame, deviation * np.sqrt(likely * (0.65 if part == 1 else 3.2)), part)
    spread = inputs.planes("uniform", height, width, 3, seed=3)
    variance = (deviation**2 * spread * frame[..., :3] ** 2).astype(np.float32)
    share = inputs.planes("uniform", height, width, seed=4)
    image, new_share = theory.keep_plausible(filtered, frame, variance, share, likely)
    got, got_share = kept(engine, filtered, frame, variance, share, likely)
    np.testing.assert_allclose(got, image, rtol=1e-5, atol=1e-6)
    close(got_share, new_share, scale=1.0)
    if height * width > 500:  # here it is the input, there the filter, and somewhere both
        given = (new_share == 1).mean(), (new_share == share).mean(), ((new_share > share) & (new_share < 1)).mean()
        assert min(given) > 0.01


@pytest.mark.parametrize("kind", ["hdr", "scene"])
def test_it_is_the_equation_with_noise_of_its_own_everywhere(engine, kind):
    """What a filter makes of a noisy frame: the truth, at the noise of few samples, known from two halves."""
    truth, frame = input_of("scene", 37, 101), input_of(kind, 37, 101)
    truth[..., :3] = inputs.features(37, 101, noise=0.0)["color"]
    other = frame * inputs.planes("uniform", 37, 101, 1, seed=5)
    variance = ((frame - other)[..., :3] ** 2 / 4).astype(np.float32)
    variance[:9, :30] = 0
    frame = (frame + other) / 2
    share = np.zeros((37, 101), np.float32)
    image, new_share = theory.keep_plausible(truth, frame, variance, share, 3.0)
    got, got_share = kept(engine, truth, frame, variance, share)
    # To the rounding of the step between the two, which fireflies are part of.
    assert (np.abs(got - image) <= 1e-6 + 1e-5 * (np.abs(truth) + np.abs(frame))).all()
    close(got_share, new_share, scale=1.0)


def test_dark_pixels_and_negative_ones(engine):
    """Faint channels are relative to 3 % of the luminance, black to 1e-3; a variance below 0 is none."""
    rng = np.random.default_rng(6)
    scale = np.float32([1e-4, 1e-3, 1e-2, 1.0])[rng.integers(4, size=(24, 48, 1))]
    part = np.float32([1, 1, 0.01, 1])
    frame = (scale * part * rng.standard_normal((24, 48, 4))).astype(np.float32)
    change = 5e-3 * scale * part * rng.standard_normal(frame.shape)
    filtered = (frame + change * (rng.random((24, 48, 1)) < 0.2)).astype(np.float32)
    variance = np.full((24, 48, 3), 1e-10, np.float32)
    variance[::3] = -1
    variance[:, 24:] = -1
    share = np.zeros((24, 48), np.float32)
    image, new_share = theory.keep_plausible(filtered, frame, variance, share, 3.0)
    assert (new_share[:, :30] == 0).mean() > 0.1 and (new_share[:, :30] == 1).mean() > 0.1
    got, got_share = kept(engine, filtered, frame, variance, share)
    np.testing.assert_allclose(got, image, rtol=1e-5, atol=1e-9)
    close(got_share, new_share, scale=1.0)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("level", [0.0, 1e-4, 1e6])
def test_equal_frames_stay(engine, height, width, level):
    frame, share = input_of("hdr", height, width), inputs.planes("uniform", height, width)
    got, got_share = kept(engine, frame, frame, np.full((height, width, 3), level), share)
    np.testing.assert_array_equal(got, frame)
    np.testing.assert_array_equal(got_share, share)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", ["hdr", "textured"])
def test_without_any_noise_the_input_comes_back(engine, kind, height, width):
    """However little the filter changed: here and there, in the last bits or by a lot."""
    frame = input_of(kind, height, width)
    for size in (1e-5, 1e-2, 1e3):
        filtered = filter_of(frame, size)
        got, got_share = kept(engine, filtered, frame, np.zeros((height, width, 3)))
        np.testing.assert_array_equal(got[..., :3], frame[..., :3])
        differ = (filtered != frame)[..., :3].any(-1)
        assert (got_share[differ] == 1).all()
        np.testing.assert_array_equal(got[differ], frame[differ])


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", [*inputs.KINDS, "scene"])
def test_much_noise_leaves_the_filtered_frame_as_it_is(engine, kind, height, width):
    frame, filtered = input_of("hdr", height, width), input_of(kind, height, width)
    share = inputs.planes("uniform", height, width, seed=7)
    got, got_share = kept(engine, filtered, frame, np.full((height, width, 3), 1e12), share)
    np.testing.assert_array_equal(got, filtered)
    np.testing.assert_array_equal(got_share, share)


@pytest.mark.parametrize("channel", range(3))
@pytest.mark.parametrize("at", [(13, 19), (0, 0), (1, 38), (23, 39), (16, 15)])
def test_a_wrong_pixel_goes_back_with_those_within_two(engine, at, channel):
    rng = np.random.default_rng(8)
    frame = input_of("textured", 24, 40) + np.float32(0.5)
    filtered = (frame * (1 + 0.01 * rng.standard_normal(frame.shape))).astype(np.float32)
    filtered[(*at, channel)] += 3.0
    share = np.full((24, 40), 0.25, np.float32)
    got, got_share = kept(engine, filtered, frame, 0.01 * frame[..., :3] ** 2, share)
    y, x = np.mgrid[:24, :40]
    near = (abs(y - at[0]) <= 2) & (abs(x - at[1]) <= 2)
    np.testing.assert_array_equal(got, np.where(near[..., None], frame, filtered))
    np.testing.assert_array_equal(got_share, np.where(near, 1, share))


def test_noise_of_the_next_block_explains_a_change_and_that_of_the_one_after_does_not(engine):
    frame = np.full((8, 56, 4), 0.5, np.float32)
    filtered = frame * np.float32(1.1)
    variance = np.zeros((8, 56, 3))
    variance[4, 25] = 1.0
    got, got_share = kept(engine, filtered, frame, variance)
    near = np.zeros((8, 56), bool)
    near[:, 16 + 2 : 40 - 2] = True  # blocks two to four, but for what lies beside the others
    np.testing.assert_array_equal(got, np.where(near[..., None], filtered, frame))
    np.testing.assert_array_equal(got_share, ~near)


def test_what_lies_in_memory_beyond_the_image_is_no_noise(engine):
    """Of an image of 13 x 19 in the corner of a larger one, whose rest is very noisy."""
    frame = input_of("scene", 24, 40)
    filtered = filter_of(frame, 0.5)
    variance = (0.01 * frame[..., :3] ** 2).astype(np.float32)
    variance[13:], variance[:, 19:] = 1e6, 1e6
    large = [to_planes(engine, image) for image in (filtered, frame, variance, np.zeros((24, 40)))]
    small = [replace(planes, height=13, width=19) for planes in large]
    keep_plausible(engine, *small, likely=3.0)
    corner = np.s_[:13, :19]
    image, share = kept(engine, filtered[corner], frame[corner], variance[corner])
    np.testing.assert_array_equal(to_array(engine, small[0]), image)
    np.testing.assert_array_equal(to_array(engine, small[3]), share)
    assert 0.1 < share.mean() < 0.9


@pytest.mark.parametrize(("worst", "share"), [(0.95, 0.2), (1.25, 0.6), (1.375, 0.8), (1.55, 1.0)])
@pytest.mark.parametrize("everywhere", [True, False])
def test_between_likely_and_half_as_much_again_both_are_mixed(engine, worst, share, everywhere):
    """By a darkening in one channel, everywhere or of one pixel; the half difference goes with it."""
    frame = np.full((5, 21, 4), 2.0, np.float32)
    deviations = np.full((5, 21, 1), np.sqrt(worst * 3 * (1 if everywhere else 5)), np.float32)
    near = np.ones((5, 21), bool)
    if not everywhere:
        deviations[np.mgrid[:5, :21][1] != 10] = 0
        near[:, :8] = near[:, 13:] = False
    filtered = frame - np.float32([0.0, 0.01, 0.0, 0.5]) * deviations
    before = np.full((5, 21), 0.2)
    if not everywhere:
        filtered[[0, 1, 3, 4]] = frame[0]
    got, got_share = kept(engine, filtered, frame, np.full((5, 21, 3), 0.01**2), before)
    left = np.where(near, (1 - share) / (1 - 0.2), 1)[..., None]
    np.testing.assert_allclose(got, frame + left * (filtered - frame), atol=2e-3)
    np.testing.assert_allclose(got_share, np.where(near, share, 0.2), atol=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_is_no_reason_to_keep_the_input(engine, seed):
    """The truth lies off the input by the noise: one pixel in 20 by two deviations, and no window by much."""
    rng = np.random.default_rng(seed)
    truth = input_of("scene", 64, 96)
    truth[..., :3] = inputs.features(64, 96, noise=0.0)["color"]
    deviation = 0.01 * truth[..., :3]
    frame = truth.copy()
    frame[..., :3] += deviation * rng.standard_normal(deviation.shape)
    _, share = kept(engine, truth, frame, deviation**2)
    assert share.mean() < 0.02
