"""Two renderings of one frame with different seeds: the arithmetic, and from file to file."""

import inputs
import numpy as np
import pytest

from mcdenoise_cl import FrameError, denoise_files, read_exr, write_exr
from mcdenoise_cl.api import denoise
from mcdenoise_cl.batch import denoise_file
from mcdenoise_cl.frame import Frame
from mcdenoise_cl.halves import mean_of_halves

SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
SIZE = (9, 12)


def half(seed, samples=None, **planes):
    planes = inputs.features(*SIZE, seed=seed) | planes
    return Frame(**planes, metadata={} if samples is None else {"samples_per_pixel": samples})


def test_means_and_variances_are_those_of_independent_renderings():
    """Against the definition, by drawing: the variance of the mean is what the mean varies by."""
    rng = np.random.default_rng(3)
    sigma, draws = np.array([0.5, 2.0], np.float32), 4000
    frames = []
    for width, samples in zip(sigma, (30, 10), strict=True):
        color = (5 + width * rng.standard_normal((draws, 1, 3))).astype(np.float32)
        variance = np.full_like(color, width**2)
        depth = (2 + width * rng.standard_normal((draws, 1))).astype(np.float32)
        planes = {"color_variance": variance, "depth": depth, "depth_variance": variance[..., 0]}
        frames.append(Frame(color, **planes, metadata={"samples_per_pixel": samples}))
    for pair in (frames, [Frame(**frame.planes()) for frame in frames]):  # with samples, and without
        mean = mean_of_halves(*pair)
        assert abs(mean.color.mean() - 5) < 0.05 and abs(mean.depth.mean() - 2) < 0.1
        assert mean.color_variance[0, 0, 0] == pytest.approx(mean.color.var(), rel=0.05)
        assert mean.depth_variance[0, 0] == pytest.approx(mean.depth.var(), rel=0.1)
    plain = mean_of_halves(*[Frame(**frame.planes()) for frame in frames])
    np.testing.assert_allclose(plain.color_variance, (0.25 + 4) / 4)
    np.testing.assert_array_equal(plain.color_a, frames[0].color)
    np.testing.assert_array_equal(plain.color_b, frames[1].color)


def test_planes_that_only_one_has():
    a, b = half(1), half(2, albedo=None, normal=None)
    ones = np.ones((*SIZE, 3), np.float32)
    a = Frame(**a.planes() | {"albedo_variance": ones, "color_variance": ones, "color_a": ones, "color_b": ones})
    for one, other in ((a, b), (b, a)):
        mean = mean_of_halves(one, other)
        np.testing.assert_array_equal(mean.albedo, a.albedo)
        np.testing.assert_array_equal(mean.albedo_variance, ones)
        np.testing.assert_allclose(mean.depth, (a.depth + b.depth) / 2)
        assert mean.color_variance is None, "that of one says nothing of the other"
        np.testing.assert_array_equal(mean.color_a, one.color)  # not the halves of a half


def test_halves_that_are_none():
    with pytest.raises(FrameError, match=r"a is \(9, 12\) but b is \(9, 11\): two halves share height and width"):
        mean_of_halves(half(1), Frame(np.ones((9, 11, 3), np.float32)))
    with pytest.raises(FrameError, match="hold the same pixels: render two halves with different seeds"):
        mean_of_halves(half(1), half(1))
    black = Frame(np.zeros((4, 4, 3), np.float32))
    assert not mean_of_halves(black, black).color.any(), "where there is no light, no seed makes a difference"


def test_half_floats_and_the_infinite():
    planes = [np.full((2, 2, 3), value, np.float16) for value in (60032, 50016)]
    planes[1][0, 0] = np.inf
    mean = mean_of_halves(*(Frame(plane, depth=np.full((2, 2), np.inf, np.float16)) for plane in planes))
    assert mean.color.dtype == np.float32 and mean.color[1, 1, 0] == 55024 and np.isinf(mean.color[0, 0]).all()
    assert np.isinf(mean.depth).all()


@pytest.fixture
def pair(tmp_path):
    paths = []
    for letter, seed, samples in (("a", 1, 8), ("b", 2, 24)):
        paths.append(tmp_path / "in" / f"s.1.{letter}.exr")
        paths[-1].parent.mkdir(exist_ok=True)
        write_exr(paths[-1], half(seed, samples))
    return tuple(paths)


def test_from_file_to_file(pair, tmp_path):
    whole = mean_of_halves(*(read_exr(path) for path in pair))
    np.testing.assert_allclose(whole.color, 0.25 * half(1).color + 0.75 * half(2).color, rtol=1e-6)
    expected = denoise(whole, **SMALL)
    denoise_file(pair, tmp_path / "clean.exr", **SMALL)
    [outcome] = denoise_files(tmp_path / "in", tmp_path / "out", pairs=True, **SMALL)
    assert outcome.target == tmp_path / "out" / "s.1.exr"
    for path in (tmp_path / "clean.exr", outcome.target):
        clean = read_exr(path)
        np.testing.assert_array_equal(clean.color, expected)
        np.testing.assert_array_equal(clean.albedo, read_exr(pair[0]).albedo)
    # Either of them, when it changes, makes the result out of date.
    write_exr(pair[1], half(5, 24))
    [again] = denoise_files(tmp_path / "in", tmp_path / "out", pairs=True, **SMALL)
    assert (again.status, again.reason) == ("done", "the input has changed")


def test_a_half_that_is_missing_or_does_not_fit(pair, tmp_path):
    write_exr(tmp_path / "in" / "s.2.a.exr", half(3))
    write_exr(tmp_path / "in" / "s.3.a.exr", half(3))
    write_exr(tmp_path / "in" / "s.3.b.exr", np.ones((4, 4, 3), np.float32))
    first, second, third = denoise_files(tmp_path / "in", tmp_path / "out", pairs=True, **SMALL)
    assert first.status == "done" and [path.name for path in (tmp_path / "out").iterdir()] == ["s.1.exr"]
    assert "s.2.b.exr cannot be read (No such file" in str(second.error)
    assert "s.3.a.exr is (9, 12) but" in str(third.error) and "s.3.b.exr is (4, 4)" in str(third.error)
