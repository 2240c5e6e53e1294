"""Checks the limit to what a filter may change against SciPy, and by what it is for."""

from __future__ import annotations

import numpy as np
import oracle_plausible as ora
import pytest
import scipy.ndimage
from inputs import SIZES, planes
from oracle import pad
from test_oracle import assert_close

#: (height, width): also whole blocks, and one pixel more.
BLOCKS = (*SIZES, (8, 16), (9, 17), (24, 25))

#: Mean of the squared distances that a result may have.
LIKELY = 3.0


def frames(height: int, width: int, kind: str = "uniform") -> tuple[np.ndarray, ...]:
    """A filtered frame with a half difference, its input, the variance and the share."""
    frame = planes(kind, height, width, 4).astype(np.float64)
    rng = np.random.default_rng(0)
    filtered = frame + 0.2 * rng.standard_normal(frame.shape) * frame
    variance = 0.02 * frame[..., :3] ** 2 * rng.random((height, width, 3))
    return filtered, frame, variance, planes("uniform", height, width).astype(np.float64)


def square(image: np.ndarray) -> np.ndarray:
    """What noise is relative to."""
    light = image[..., :3] @ np.array([0.2126, 0.7152, 0.0722])
    return image[..., :3] ** 2 + 9e-4 * light[..., None] ** 2 + 1e-6


def block_noise(color: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Whole blocks of zeros beyond the image, a maximum each, then that of 3x3 blocks, and back to pixels."""
    height, width = color.shape[:2]
    full = np.zeros((-(-height // 8) * 8, -(-width // 8) * 8, 3))
    full[:height, :width] = variance / square(color)
    blocks = full.reshape(full.shape[0] // 8, 8, full.shape[1] // 8, 8, 3).max(axis=(1, 3))
    around = scipy.ndimage.maximum_filter(blocks, (3, 3, 1), mode="constant", cval=0.0)
    return np.kron(around, np.ones((8, 8, 1)))[:height, :width]


@pytest.mark.parametrize("size", BLOCKS)
@pytest.mark.parametrize("kind", ["uniform", "hdr", "step", "textured"])
def test_it_matches_scipy(kind, size):
    filtered, frame, variance, share = frames(*size, kind)
    noise = block_noise(frame, variance)
    assert_close(ora.noise_around(frame, variance), noise, 1e-6)
    change = (filtered - frame)[..., :3]
    moved = np.max(change**2 / (noise * np.maximum(square(frame), square(filtered)) + 1e-30), axis=-1)
    np.testing.assert_allclose(ora.distances(filtered, frame, variance), moved, rtol=1e-5)
    # SciPy mirrors no image that is smaller than the border.
    padded = pad(moved, 2)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    worst = np.maximum(windows.mean(axis=(2, 3)), windows.max(axis=(2, 3)) / 5.0)
    if min(size) > 2:
        around = [f(moved, 5, mode="mirror") for f in (scipy.ndimage.uniform_filter, scipy.ndimage.maximum_filter)]
        np.testing.assert_allclose(worst, np.maximum(around[0], around[1] / 5.0), rtol=1e-9)
    image, new_share = ora.keep_plausible(filtered, frame, variance, share, LIKELY)
    kept = np.interp(worst, [LIKELY, 1.5 * LIKELY], [1.0, 0.0])
    assert 0.0 < kept.mean() < 1.0 or size[0] * size[1] < 100
    assert_close(image, kept[..., None] * filtered + (1.0 - kept[..., None]) * frame, 1e-4)
    assert_close(new_share, share + (1.0 - share) * (1.0 - kept), 1e-4)


def test_negative_variances_are_none():
    color = np.ones((9, 9, 3))
    assert not ora.noise_around(color, -color).any()
    variance = np.full((9, 9, 3), -1.0)
    variance[8, 8] = 0.1
    np.testing.assert_allclose(ora.noise_around(color, variance), 0.1 / (1.0 + 9e-4 + 1e-6))


def test_noise_reaches_as_far_as_the_next_block():
    variance = np.zeros((40, 48, 3))
    variance[17, 22, 1] = 1e-3
    seen = ora.noise_around(np.ones((40, 48, 3)), variance)
    expected = np.zeros(seen.shape, dtype=bool)
    expected[8:32, 8:32, 1] = True
    assert np.array_equal(seen > 0.0, expected)


def test_noise_is_relative_to_the_brightness():
    """A light beside a dark wall lends the wall its relative noise, not a noise brighter than the wall itself."""
    color = np.ones((8, 16, 3))
    color[:, 8:] = 1000.0
    variance = (0.1 * color) ** 2
    variance[:, :8] = 0.01**2
    np.testing.assert_allclose(ora.noise_around(color, variance), 0.01, rtol=1e-3)
    # In the dark nothing is relative to less than 1e-3, and a colour without red not to less than 3 % of its light.
    np.testing.assert_allclose(ora.relative_to(np.zeros((1, 1, 3))), 1e-6)
    red = ora.relative_to(np.array([[[0.0, 1.0, 1.0]]]))[0, 0, 0]
    np.testing.assert_allclose(red, 9e-4 * 0.7874**2 + 1e-6)


@pytest.mark.parametrize("deviations", [0.5, 2.0, 7.0])
def test_distances_count_variances(deviations):
    """Of a change of one channel, in the noise of a bright frame; the channel of most deviations counts."""
    frame = np.full((5, 6, 4), 100.0)
    sigma = np.array([1.0, 2.0, 4.0])
    variance = np.broadcast_to(sigma**2, (5, 6, 3))
    filtered = frame.copy()
    filtered[2, 3, :3] -= deviations * sigma * np.array([0.3, 1.0, 0.1])
    filtered[..., 3] += 1e6
    moved = ora.distances(filtered, frame, variance)
    np.testing.assert_allclose(moved[2, 3], deviations**2, rtol=2e-3)
    assert np.count_nonzero(moved) == 1


def test_the_brighter_of_both_frames_says_what_a_change_is_relative_to():
    one, other = np.full((3, 3, 3), 0.1), np.full((3, 3, 3), 10.0)
    variance = 0.01 * one**2
    for frame, filtered in ((one, other), (other, one)):
        noise = 0.01 * one[0, 0, 0] ** 2 / ora.relative_to(frame)[0, 0, 0]
        expected = 9.9**2 / (noise * ora.relative_to(other)[0, 0, 0])
        np.testing.assert_allclose(ora.distances(filtered, frame, variance), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("worst", "kept"), [(0.0, 1.0), (0.99, 1.0), (1.25, 0.5), (1.375, 0.25), (1.5, 0.0), (9.0, 0.0)]
)
@pytest.mark.parametrize("everywhere", [True, False])
def test_of_the_filtered_frame_stays_less_from_likely_on(worst, kept, everywhere):
    """Of a change of all pixels by likely variances, or of one of 25 pixels by five times that."""
    frame, variance = np.full((5, 7, 4), 100.0), np.ones((5, 7, 3))
    changed = np.full((5, 7, 1), everywhere)
    changed[2, 3] = True
    filtered = frame - np.sqrt(worst * 4.0 * (1.0 if everywhere else 5.0)) * changed
    before = planes("uniform", 5, 7).astype(np.float64)
    image, share = ora.keep_plausible(filtered, frame, variance, before, likely=4.0)
    near = np.broadcast_to(changed[..., 0], (5, 7)) if everywhere else np.abs(np.arange(7) - 3) <= 2
    part = np.where(near, kept, 1.0) * np.ones((5, 7))
    np.testing.assert_allclose(image, frame + part[..., None] * (filtered - frame), rtol=1e-6)
    np.testing.assert_allclose(1.0 - share, part * (1.0 - before), atol=1e-9)


def test_noise_alone_is_no_reason_to_keep_the_input():
    """Of a mean of 1 and a deviation of 0.01 in one channel, or all of them: the truth itself is plausible."""
    rng = np.random.default_rng(0)
    truth = np.ones((48, 64, 4))
    for shape in ((48, 64, 1), (48, 64, 3)):
        frame = truth.copy()
        frame[..., :3] += 0.01 * rng.standard_normal(shape)
        _, share = ora.keep_plausible(truth, frame, np.full((48, 64, 3), 1e-4), np.zeros((48, 64)), LIKELY)
        assert share.mean() < 0.02


def test_what_is_wrong_takes_two_pixels_around_it_along():
    frame = np.full((12, 13, 4), 0.5)
    filtered = frame + 0.01
    filtered[4, 0] = 5.0
    share = np.full((12, 13), 0.25)
    image, new_share = ora.keep_plausible(filtered, frame, np.full((12, 13, 3), 0.05**2), share, LIKELY)
    back = np.zeros(share.shape, dtype=bool)
    back[2:7, :3] = True
    assert np.array_equal(image[back], frame[back]) and (new_share[back] == 1.0).all()
    np.testing.assert_allclose(image[~back], filtered[~back], rtol=1e-12)
    assert np.array_equal(new_share[~back], share[~back])
