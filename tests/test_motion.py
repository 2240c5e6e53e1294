"""Motion vectors: in files, along a sequence, and what right and wrong ones do to a picture."""

from dataclasses import replace

import numpy as np
import pytest
from moving import planes_at
from test_exr import CYCLES, make, part, rgb
from test_temporal import error

from mcdenoise_cl import Frame, cli, denoise, denoise_files, read_exr, with_motion, write_exr
from mcdenoise_cl.errors import ExrError, FrameError
from mcdenoise_cl.halves import mean_of_halves

SIZE = (48, 64)
FAST = {"method": "guided"}


def vectors(shape=SIZE, seed=0, dtype=np.float32):
    return np.random.default_rng(seed).uniform(-9, 9, (*shape, 2)).astype(dtype)


def cycles(planes, to_previous, to_next):
    """Channels as Blender writes them: vectors with y upwards, from the frame before to here to the frame after."""
    names = {
        "Noisy Image": ("color", "RGB"),
        "Denoising Albedo": ("albedo", "RGB"),
        "Denoising Normal": ("normal", "XYZ"),
    }
    channels = {
        f"ViewLayer.{name}.{c}": planes[plane][..., i] for name, (plane, cs) in names.items() for i, c in enumerate(cs)
    }
    channels["ViewLayer.Denoising Depth.Z"] = planes["depth"]
    pairs = (("X", to_previous[..., 0]), ("Y", -to_previous[..., 1]), ("Z", -to_next[..., 0]), ("W", to_next[..., 1]))
    return channels | {f"ViewLayer.Vector.{c}": plane.astype(np.float32) for c, plane in pairs}


# ------------------------------------------------------------------------------------------------------------- in files


def test_the_pass_vector_of_blender(tmp_path):
    before, after = vectors(seed=1), vectors(seed=2)
    path = make(tmp_path / "a.exr", part(cycles(planes_at(*SIZE)[0], before, after)))
    frame = read_exr(path)
    np.testing.assert_array_equal(frame.to_previous, before)
    np.testing.assert_array_equal(frame.to_next, after)
    assert frame.metadata["motion"] == "ViewLayer.Vector" and "motion" not in frame.planes()
    without = read_exr(path, layers={"motion": "none"})
    assert without.to_previous is without.to_next is None and "motion" not in without.metadata


@pytest.mark.parametrize("dtype", ["f2", "f4"])
def test_own_vectors_round_trip(tmp_path, dtype):
    frame = Frame(planes_at(*SIZE)[0]["color"], to_next=vectors(dtype=dtype))
    write_exr(tmp_path / "a.exr", frame)
    back = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(back.to_next, frame.to_next)
    assert back.to_next.dtype == dtype and back.to_previous is None and back.metadata["motion"] == "motion.next"


@pytest.mark.parametrize(
    ("channels", "expected"),
    [
        ([*CYCLES, *rgb("Other.Vector", suffix="XYZW")], "ViewLayer.Vector"),  # of the view layer of the colour
        ([*rgb("", "motionvector"), "motionvector.A"], None),  # Arnold, whose unit is not in the file
        ([*rgb(""), *rgb("Vector", suffix="XYZ")], None),
        ([*rgb(""), *rgb("a.Vector", "b.Vector", suffix="XYZW")], None),
        ([*rgb(""), "motion.prev.X", "motion.next.X", "motion.next.Y"], "motion.next"),
        ([*rgb(""), *rgb("Vector", suffix="XYZW"), "motion.prev.X", "motion.prev.Y"], "motion.prev"),
    ],
)
def test_only_what_is_sure_is_taken(tmp_path, channels, expected):
    frame = read_exr(make(tmp_path / "a.exr", part(channels)))
    assert frame.metadata.get("motion") == expected
    assert (frame.to_previous is None and frame.to_next is None) == (expected is None)


def test_vectors_cannot_be_chosen(tmp_path):
    write_exr(tmp_path / "a.exr", np.ones((4, 4, 3), np.float32))
    with pytest.raises(ExrError, match=r"motion=Vector is given, but motion vectors are recognised by name alone"):
        read_exr(tmp_path / "a.exr", layers={"motion": "Vector"})
    assert cli.main(["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--layer", "motion=none"]) == 0


# ---------------------------------------------------------------------------------------------------- along a sequence


def still(**given):
    return Frame(np.ones((6, 9, 3), np.float32), **given)


def test_a_chain_of_vectors_leads_on():
    """The vectors of the next frame are those of the place that was moved to, as far as the chain goes."""
    first, second = np.zeros((6, 9, 2), np.float32), np.zeros((6, 9, 2), np.float32)
    first[2, 3], second[3, 5] = (1.6, 0.8), (0.5, -2)
    frame, near = still(to_next=first, to_previous=second), still(to_next=second)
    one, two, four, before, far = with_motion(frame, [near, near, near, still(), near], [1, 2, 4, -1, None])
    np.testing.assert_array_equal(one.motion, first)
    np.testing.assert_allclose(two.motion[2, 3], (2.1, -1.2), atol=1e-6)
    np.testing.assert_array_equal(before.motion, second)
    assert four.motion is far.motion is None
    with pytest.raises(FrameError, match="2 neighbours and 1 offsets"):
        with_motion(frame, [near, near], [1])


def test_vectors_of_halves():
    a, b = (still().color * k for k in (1, 2))
    a[0, 0], b[0, 0] = 3, 4
    mean = mean_of_halves(Frame(a), Frame(b, to_next=vectors((6, 9)), metadata={"motion": "V"}))
    np.testing.assert_array_equal(mean.to_next, vectors((6, 9)))
    assert mean.metadata["motion"] == "V"


def moving(move, numbers=(1, 2, 3)):
    """Frames of a camera that moves so far a frame, the truth of the middle one, and how far its pixels move on."""
    frames = [planes_at(*SIZE, (k * move[0], k * move[1]), seed=k + 5, margin=16)[0] for k in (-1, 0, 1)]
    on = np.broadcast_to(-np.array(move, np.float32), (*SIZE, 2))
    return frames, planes_at(*SIZE, seed=5, margin=16)[1], on


def test_files_of_blender(tmp_path):
    """`temporal=1` is `neighbours` with the vectors of the frame's own file. Across a gap these lead nowhere."""
    frames, truth, on = moving((12, 0))
    paths = [tmp_path / f"shot.{number:04d}.exr" for number in (1, 2, 3)]
    for path, planes in zip(paths, frames, strict=True):
        make(path, part(cycles(planes, -on, on)))
    outcomes = denoise_files(tmp_path, tmp_path / "out", temporal=1, **FAST)
    assert [outcome.layers["motion"] for outcome in outcomes] == ["ViewLayer.Vector"] * 3
    before, frame, after = (read_exr(path) for path in paths)
    near = [replace(before, motion=frame.to_previous), replace(after, motion=frame.to_next)]
    known = read_exr(tmp_path / "out" / paths[1].name)
    np.testing.assert_array_equal(known.color, denoise(frame, neighbours=near, **FAST))
    np.testing.assert_array_equal(known.to_next, on)  # the file keeps its other layers
    searched = denoise(frame, neighbours=[before, after], **FAST)
    assert error(known.color, truth) < 0.75 * min(error(searched, truth), error(denoise(frame, **FAST), truth))
    paths[2].rename(tmp_path / "shot.0004.exr")
    paths[0].unlink()
    [outcome] = denoise_files(paths[1], tmp_path / "gap", temporal=1, **FAST)
    assert "motion" not in outcome.layers
    written = read_exr(tmp_path / "gap" / paths[1].name).color
    np.testing.assert_array_equal(written, denoise(frame, neighbours=[after], **FAST))


@pytest.mark.parametrize("move", [(12, 0), (2, 1)], ids=["fast", "slow"])
@pytest.mark.parametrize("kind", ["wrong sign", "none", "noise", "far", "out of the picture", "not finite"])
def test_wrong_vectors_do_no_harm(move, kind):
    """Never worse than without them, nor than the frame alone, by more than a hundredth."""
    (before, frame, after), truth, on = moving(move)
    wrong = {
        "wrong sign": on,
        "none": np.zeros_like(on),
        "noise": vectors(),
        "far": 7 * vectors(),
        "out of the picture": np.full_like(on, 1e30),
        "not finite": np.full_like(on, np.nan),
    }[kind]
    frame, near = Frame(**frame), [Frame(**before), Frame(**after)]
    given = [replace(near[0], motion=wrong), replace(near[1], motion=-wrong)]
    alone, found = (error(denoise(frame, neighbours=beside, **FAST), truth) for beside in ([], given))
    assert found < 1.01 * alone
    if kind != "out of the picture":
        assert found < 1.01 * error(denoise(frame, neighbours=near, **FAST), truth)
