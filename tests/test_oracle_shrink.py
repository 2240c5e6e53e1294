"""Checks the shares of `oracle_shrink` against NumPy's and SciPy's own means, and by what they are for."""

from __future__ import annotations

import numpy as np
import oracle_shrink as ora
import pytest
import scipy.ndimage
from inputs import SIZES, planes

#: (height, width): also whole blocks, and one pixel more.
BLOCKS = (*SIZES, (8, 16), (9, 17), (24, 25))


def as_blocks(image: np.ndarray) -> np.ndarray:
    """Whole blocks, NaN beyond the image: (rows of blocks, 8, blocks, 8, C)."""
    height, width, channels = image.shape
    full = np.full((-(-height // 8) * 8, -(-width // 8) * 8, channels), np.nan)
    full[:height, :width] = image
    return full.reshape(full.shape[0] // 8, 8, full.shape[1] // 8, 8, channels)


@pytest.mark.parametrize("size", BLOCKS)
@pytest.mark.parametrize("kind", ["uniform", "hdr", "step"])
def test_means_and_noise_match_numpy_and_scipy(kind, size):
    frame = planes(kind, *size, 4).astype(np.float64)
    mean = np.nanmean(as_blocks(frame), axis=(1, 3))
    np.testing.assert_allclose(ora.block_mean(frame), mean, rtol=1e-12)
    smooth = scipy.ndimage.convolve1d(mean, [0.25, 0.5, 0.25], axis=0, mode="nearest")
    smooth = scipy.ndimage.convolve1d(smooth, [0.25, 0.5, 0.25], axis=1, mode="nearest")
    np.testing.assert_allclose(ora.around(mean), smooth, rtol=1e-12)
    variance = planes("uniform", *size, 3, seed=1)
    light = frame[..., :3] @ np.array([0.2126, 0.7152, 0.0722])
    v = as_blocks(variance / (frame[..., :3] ** 2 + 9e-4 * light[..., None] ** 2 + 1e-6))
    noise = np.nansum(v**2, axis=(1, 3)) / np.nansum(v, axis=(1, 3))
    most = scipy.ndimage.maximum_filter(noise, (3, 3, 1), mode="nearest")
    np.testing.assert_allclose(ora.block_noise(frame, variance), most, rtol=1e-9)
    most = scipy.ndimage.maximum_filter(np.nanmean(v, axis=(1, 3)), (3, 3, 1), mode="nearest")
    np.testing.assert_allclose(ora.block_noise(frame, variance, quiet=True), most, rtol=1e-9)


@pytest.mark.parametrize("size", BLOCKS)
def test_between_centres_it_is_linear(size):
    height, width = size
    down, across = -(-height // 8), -(-width // 8)
    ramp = np.stack([np.add.outer(3.0 * np.arange(down), np.arange(across))] * 3, axis=-1)
    y, x = np.mgrid[:height, :width]
    expected = 3 * np.clip((y - 3.5) / 8, 0, down - 1) + np.clip((x - 3.5) / 8, 0, across - 1)
    np.testing.assert_allclose(ora.between(ramp, height, width), np.stack([expected] * 3, axis=-1), atol=1e-12)


@pytest.mark.parametrize("kept", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("wrong", [0.0, 0.7, 2.0])
@pytest.mark.parametrize("told", [True, False], ids=["halves", "disturbed"])
def test_the_share_has_the_least_error_of_all(wrong, kept, told):
    """Of a filter that keeps a part of the noise and is wrong by so many deviations, tried at every share.

    Half differences tell how much it keeps, or, where they do not, noise that was added.
    """
    rng = np.random.default_rng(0)
    truth = np.full((160, 160, 3), 0.5)
    noise = 1e-3 * rng.standard_normal(truth.shape)
    half = 1e-3 * rng.standard_normal((160, 160, 1))
    frame = np.concatenate([truth + noise, half], axis=-1)
    bias = 1e-3 * wrong * rng.choice([-1, 1], (160, 160, 1))
    filtered = np.concatenate([truth + kept * noise + bias, kept * half if told else 0 * half], axis=-1)
    step = 3e-4 * rng.standard_normal((160, 160, 1))
    disturbed = None if told else (frame[..., :3] + step, filtered[..., :3] + kept * step)
    a = ora.block_shares(filtered, frame, np.full(truth.shape, 1e-3**2), disturbed).mean()
    shares = np.linspace(0, 1, 101)
    errors = [np.mean((noise + part * (kept * noise + bias - noise)) ** 2) for part in shares]
    best = shares[np.argmin(errors)]
    assert a == pytest.approx(np.clip((best - 0.1) / 0.9, 0, 1), abs=0.04)


def test_a_share_of_the_input_that_was_there_stays():
    frame = planes("uniform", 13, 17, 4).astype(np.float64)
    share = planes("uniform", 13, 17).astype(np.float64)
    image, new = ora.shrink_to_input(frame, frame, np.full((13, 17, 3), 1e-4), share)
    np.testing.assert_array_equal(image, frame)
    assert (new >= share - 1e-12).all() and (new <= 1 + 1e-12).all()
