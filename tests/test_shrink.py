"""A filtered frame drawn back to its input, on the device against the equations in float64."""

from dataclasses import replace

import inputs
import numpy as np
import oracle_shrink as theory
import pyopencl as cl
import pytest
from test_stages import close
from transfer import to_array, to_planes

from mcdenoise_cl.device import context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.stages.shrink import shrink_to_input

#: Whole blocks of eight, one pixel more and one less, beside the usual sizes.
SIZES = (*inputs.SIZES, (8, 16), (9, 17), (23, 31), (40, 72))


@pytest.fixture(scope="module", params=[1, 16], ids=lambda width: f"width {width}")
def engine(request, device):
    """Single floats, and vectors longer than a block."""
    engine = Engine(cl.CommandQueue(context_for(device), device))
    engine.shape = replace(engine.shape, width=request.param)
    return engine


def shrunk(engine, filtered, frame, variance, share=None, disturbed=None):
    """The frame and the share of the input, as the stage leaves them; the share is 0 before if not given."""
    share = np.zeros(frame.shape[:2]) if share is None else share
    planes, parts = to_planes(engine, filtered), to_planes(engine, share)
    given = to_planes(engine, frame), to_planes(engine, variance)
    tried = tuple(to_planes(engine, image) for image in disturbed) if disturbed else None
    shrink_to_input(engine, planes, *given, parts, disturbed=tried)
    np.testing.assert_array_equal(to_array(engine, given[0]), frame)
    return to_array(engine, planes), to_array(engine, parts)


def input_of(kind, height, width):
    """A colour and a half difference; `scene` is the synthetic rendering, anything else a kind of image."""
    if kind == "scene":
        color = inputs.features(height, width, seed=1)["color"]
        return np.concatenate([color, 0.1 * inputs.planes("uniform", height, width, 1)], axis=-1)
    return inputs.planes(kind, height, width, 4)


def noisy(truth, deviation, seed=0):
    """The truth with noise, and its variance; three colours whose noise is independent, and a half difference."""
    rng = np.random.default_rng(seed)
    frame = np.empty((*truth.shape[:2], 4))
    frame[..., :3] = truth + deviation * rng.standard_normal(truth.shape)
    frame[..., 3] = deviation.mean(-1) * rng.standard_normal(truth.shape[:2])
    return frame.astype(np.float32), (deviation**2).astype(np.float32)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", [*inputs.KINDS, "scene"])
@pytest.mark.parametrize("size", [0.05, 0.2, 1.0])
def test_it_is_the_equation(engine, kind, height, width, size):
    """Changes as large as the noise, larger and much larger in each channel, with some of the noise left."""
    frame = input_of(kind, height, width)
    rng = np.random.default_rng(2)
    spread = size * np.float32([1, 2, 0.5, 0.3]) * (0.2 + np.mgrid[:height, :width][1] / width)[..., None]
    filtered = (frame * (1 + spread * rng.standard_normal(frame.shape))).astype(np.float32)
    variance = (0.1**2 * inputs.planes("uniform", height, width, 3, seed=3) * frame[..., :3] ** 2).astype(np.float32)
    share = inputs.planes("uniform", height, width, seed=4)
    image, new_share = theory.shrink_to_input(filtered, frame, variance, share)
    got, got_share = shrunk(engine, filtered, frame, variance, share)
    assert (np.abs(got - image) <= 1e-6 + 1e-5 * (np.abs(filtered) + np.abs(frame))).all()
    close(got_share, new_share, scale=1.0, tolerance=1e-4)  # 1 - t is a small difference


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", ["uniform", "constant", "step", "scene"])
@pytest.mark.parametrize("kept", [0.1, 0.6])
def test_it_is_the_equation_where_the_frame_was_disturbed(engine, kind, height, width, kept):
    """What the filter makes of the noise that was added tells how much it keeps, not the half differences."""
    frame = input_of(kind, height, width)
    rng = np.random.default_rng(3)
    filtered = (frame * (1 + 0.1 * rng.standard_normal(frame.shape))).astype(np.float32)
    variance = (0.1**2 * inputs.planes("uniform", height, width, 3, seed=3) * frame[..., :3] ** 2).astype(np.float32)
    step = np.sqrt(variance) * rng.standard_normal((height, width, 1))
    changed = kept * step * rng.uniform(0.5, 1.5, (height, width, 1))
    disturbed = tuple((a[..., :3] + b).astype(np.float32) for a, b in ((frame, step), (filtered, changed)))
    share = inputs.planes("uniform", height, width, seed=4)
    image, new_share = theory.shrink_to_input(filtered, frame, variance, share, disturbed)
    without, _ = theory.shrink_to_input(filtered, frame, variance, share)
    assert kind == "constant" or height * width < 100 or not np.allclose(image, without, rtol=1e-3)
    got, got_share = shrunk(engine, filtered, frame, variance, share, disturbed)
    assert (np.abs(got - image) <= 1e-6 + 1e-5 * (np.abs(filtered) + np.abs(frame))).all()
    close(got_share, new_share, scale=1.0, tolerance=1e-4)


def test_the_equation_gives_the_input_here_and_the_filter_there():
    """That the test above sees every case: none, some and all of the filtered frame."""
    frame = input_of("scene", 37, 101).astype(np.float64)
    clean = np.concatenate([frame[..., :3], 0 * frame[..., 3:]], axis=-1)
    for size, low, high in ((0.05, 1.0, 1.0), (0.15, 0.3, 0.6), (1.0, 0.0, 0.0)):
        changed = clean * (1 + size)
        a = theory.block_shares(changed, frame, 0.1**2 * frame[..., :3] ** 2)
        assert low <= a.min() and a.max() <= high


def test_dark_pixels_and_negative_ones(engine):
    """Faint channels are relative to 3 % of the luminance, black to 1e-3; a variance below 0 is none."""
    rng = np.random.default_rng(6)
    scale = np.repeat(np.float32([1e-4, 1e-3, 1e-2, 1.0]), 12)[None, :, None]
    part = np.float32([1, 1, 0.01, 1])
    frame = (scale * part * rng.standard_normal((24, 48, 4))).astype(np.float32)
    filtered = (frame + 5e-3 * scale * part * rng.standard_normal(frame.shape)).astype(np.float32)
    filtered[..., 3] = 0
    variance = np.full((24, 48, 3), 1e-7, np.float32)
    variance[::3] = -1
    variance[:, 24:] = -1
    share = np.zeros((24, 48), np.float32)
    image, new_share = theory.shrink_to_input(filtered, frame, variance, share)
    got, got_share = shrunk(engine, filtered, frame, variance, share)
    assert (new_share[:, 40:] == 1).all() and (new_share[:, :16] < 1).all()
    np.testing.assert_allclose(got, image, rtol=1e-5, atol=1e-9)
    close(got_share, new_share, scale=1.0)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("level", [0.0, 1e-4, 1e6, 3e38])
def test_equal_frames_stay(engine, height, width, level):
    frame = input_of("hdr", height, width)
    got, _ = shrunk(engine, frame, frame, np.full((height, width, 3), level))
    np.testing.assert_array_equal(got, frame)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("size", [1e-5, 1e-2, 1e3])
def test_without_any_noise_the_input_comes_back(engine, height, width, size):
    """Whatever the filter changed, in the last bits or by a lot; the last bits of it are lost."""
    frame = input_of("textured", height, width) + np.float32(0.5)
    filtered = frame * np.float32(1 + size)
    got, share = shrunk(engine, filtered, frame, np.zeros((height, width, 3)))
    np.testing.assert_array_equal(got[..., :3], frame[..., :3])
    np.testing.assert_array_equal(share, 1)


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", [*inputs.KINDS, "scene"])
def test_much_noise_leaves_the_filtered_frame_as_it_is(engine, kind, height, width):
    frame, filtered = input_of("hdr", height, width), input_of(kind, height, width)
    filtered[..., 3] = 0
    share = inputs.planes("uniform", height, width, seed=7)
    got, got_share = shrunk(engine, filtered, frame, np.full((height, width, 3), 1e12), share)
    np.testing.assert_array_equal(got, filtered)
    np.testing.assert_array_equal(got_share, share)


@pytest.mark.parametrize("level", [1e-4, 1e-2, 0.1])
@pytest.mark.parametrize("seed", range(3))
def test_noise_alone_is_no_reason_to_keep_the_input(engine, level, seed):
    """A filtered frame that is the truth lies off the input by the noise."""
    truth = inputs.features(64, 96, noise=0.0)["color"].astype(np.float64)
    frame, variance = noisy(truth, level * truth, seed)
    clean = np.concatenate([truth, np.zeros((64, 96, 1))], axis=-1).astype(np.float32)
    got, share = shrunk(engine, clean, frame, variance)
    assert share.mean() < 0.05
    assert np.mean((got[..., :3] - truth) ** 2) < 0.01 * np.mean((frame[..., :3] - truth) ** 2)


@pytest.mark.parametrize("wrong", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("channel", range(3))
def test_of_a_channel_that_is_wrong_as_much_is_kept_as_is_best(engine, wrong, channel):
    """Off by a bias of so many deviations, without noise: 1 / (1 + wrong²) is left of the noise's part."""
    truth = np.full((96, 128, 3), 0.5)
    frame, variance = noisy(truth, np.full(truth.shape, 0.01))
    clean = np.concatenate([truth, np.zeros((96, 128, 1))], axis=-1)
    clean[..., channel] += 0.01 * wrong
    got, _ = shrunk(engine, clean.astype(np.float32), frame, variance)
    error = np.mean((got[..., :3] - truth) ** 2, axis=(0, 1)) / 0.01**2
    best = wrong**2 / (1 + wrong**2)
    assert error[channel] == pytest.approx(best, rel=0.2)
    assert np.delete(error, channel).max() < 0.02


def test_the_part_of_its_noise_that_a_filter_keeps_counts(engine):
    """Half way to the truth, the filtered frame is as near to its input as one that is right, and half as good."""
    truth = np.full((96, 128, 3), 0.5)
    frame, variance = noisy(truth, np.full(truth.shape, 0.01))
    half = frame.copy()
    half[..., :3] = 0.5 * (frame[..., :3] + truth)
    half[..., 3] *= 0.5
    half[..., 0] += 0.01  # and wrong besides
    a = theory.block_shares(half, frame, variance)
    assert a[..., 0].mean() == pytest.approx((0.5 / (0.25 + 1) - 0.1) / 0.9, rel=0.1)
    got, _ = shrunk(engine, half, frame, variance)
    np.testing.assert_array_equal(got[..., 1:3], half[..., 1:3])


def test_noise_of_the_next_block_explains_a_change_and_that_of_the_one_after_does_not(engine):
    frame = np.full((8, 56, 4), 0.5, np.float32)
    frame[..., 3] = 0
    filtered = frame * np.float32(1.1)
    variance = np.zeros((8, 56, 3))
    variance[4, 25] = 1.0
    got, share = shrunk(engine, filtered, frame, variance)
    np.testing.assert_array_equal(got[:, 20:36], filtered[:, 20:36])
    np.testing.assert_array_equal(got[:, :12], frame[:, :12])
    np.testing.assert_array_equal(got[:, 44:], frame[:, 44:])
    np.testing.assert_array_equal(share[:, 20:36], 0)
    assert ((share[:, 12:20] > 0) & (share[:, 12:20] < 1)).all()


@pytest.mark.parametrize("light", [1e3, 1e6])
def test_a_pixel_taken_for_the_light_beside_it_does_not_bring_the_noise_of_its_block_back(engine, light):
    """A filter that is right but for one dark pixel, which it made bright and noisy: that says nothing of the rest."""
    truth = np.full((48, 48, 3), 0.3)
    frame, variance = noisy(truth, 0.5 * truth)
    clean = np.concatenate([truth, np.zeros((48, 48, 1))], axis=-1).astype(np.float32)
    clean[20, 20] = light * np.float32([1, 1, 1, np.sign(frame[20, 20, 3])])
    got, share = shrunk(engine, clean, frame, variance)
    np.testing.assert_array_equal(got, clean)
    np.testing.assert_array_equal(share, 0)


def test_where_few_samples_have_found_the_light_the_noise_is_theirs(engine):
    """One pixel in eight of eight times the truth, the rest black and, as it seems, exact: the mean is right."""
    rng = np.random.default_rng(5)
    lit = rng.random((64, 96)) < 0.125
    frame = np.zeros((64, 96, 4), np.float32)
    frame[lit, :3] = 8.0
    frame[..., 3] = frame[..., 0] * rng.choice([-1, 1], lit.shape)
    clean = np.full_like(frame, 1.0)
    clean[..., 3] = 0
    got, _ = shrunk(engine, clean, frame, frame[..., :3] ** 2)
    np.testing.assert_array_equal(got, clean)


def test_what_lies_in_memory_beyond_the_image_is_not_read(engine):
    """Of an image of 13 x 19 in the corner of a larger one, whose rest is wild."""
    frame = input_of("scene", 24, 40)
    filtered = (frame * np.float32(1.2)).astype(np.float32)
    variance = (0.01 * frame[..., :3] ** 2).astype(np.float32)
    variance[13:], variance[:, 19:] = 1e6, 1e6
    filtered[13:], filtered[:, 19:] = 1e6, np.nan
    filtered[..., 3] = 0
    large = [to_planes(engine, image) for image in (filtered, frame, variance, np.zeros((24, 40)))]
    small = [replace(planes, height=13, width=19) for planes in large]
    shrink_to_input(engine, *small)
    corner = np.s_[:13, :19]
    image, share = shrunk(engine, filtered[corner], frame[corner], variance[corner])
    np.testing.assert_array_equal(to_array(engine, small[0]), image)
    np.testing.assert_array_equal(to_array(engine, small[3]), share)
    assert 0.1 < share.mean() < 0.9
