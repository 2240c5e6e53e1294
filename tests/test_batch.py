import os
import threading

import inputs
import numpy as np
import pytest

from mcdenoise_cl import batch, denoisers
from mcdenoise_cl.api import denoise
from mcdenoise_cl.errors import DeviceError, ExrError, FrameError, ParameterError
from mcdenoise_cl.exr import read_exr, write_exr
from mcdenoise_cl.frame import Frame
from mcdenoise_cl.methods import DEFAULT_PRESET, PRESETS
from mcdenoise_cl.quiet import hushed

H, W = 31, 40
SMALL = {"search_radius": 1, "patch_radius": 1}
FAST = {"method": "ssim-nlm"} | SMALL


def write_frame(path, *, size=(H, W), seed=0, features=True):
    planes = inputs.features(*size, seed=seed)
    frame = Frame(**planes) if features else Frame(planes["color"])
    write_exr(path, frame)
    return path


@pytest.fixture
def folder(tmp_path):
    """Three frames, the second broken."""
    folder = tmp_path / "in"
    folder.mkdir()
    write_frame(folder / "a.exr", seed=1)
    write_frame(folder / "b.exr", seed=2)
    whole = (folder / "b.exr").read_bytes()
    (folder / "b.exr").write_bytes(whole[: len(whole) // 2])
    write_frame(folder / "c.exr", seed=3)
    return folder


def test_find_exrs(tmp_path):
    for name in ("b.exr", "a.EXR", "c.ExR", "d.exr.png", ".hidden.exr", "exr"):
        (tmp_path / name).touch()
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "folder.exr" / "deeper.exr").touch()
    assert [path.name for path in batch.find_exrs(str(tmp_path))] == ["a.EXR", "b.exr", "c.ExR"]
    with pytest.raises(ExrError, match=r"folder.exr.deeper.exr cannot be read \(Not a directory\): give a folder"):
        batch.find_exrs(tmp_path / "folder.exr" / "deeper.exr")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ExrError, match="empty holds no EXR file: give a folder with"):
        batch.find_exrs(tmp_path / "empty")


def test_denoise_file_is_denoise_with_files(tmp_path):
    source, target = write_frame(tmp_path / "in.exr"), tmp_path / "out.exr"
    before = source.read_bytes()
    outcome = batch.denoise_file(str(source), str(target), **FAST)
    assert (outcome.source, outcome.target, outcome.error) == (source, target, None)
    assert outcome.report.method == "ssim-nlm" and outcome.report.parameters["search_radius"] == 1
    assert outcome.layers == {"color": "RGB", "albedo": "albedo", "normal": "N"}
    noisy, clean = read_exr(source), read_exr(target)
    np.testing.assert_array_equal(clean.color, denoise(noisy, **FAST))
    for plane in ("albedo", "normal", "depth"):
        np.testing.assert_array_equal(getattr(clean, plane), getattr(noisy, plane))
    assert source.read_bytes() == before


def test_denoise_file_takes_other_layers(tmp_path):
    source = write_frame(tmp_path / "in.exr")
    outcome = batch.denoise_file(
        source, tmp_path / "a.exr", layers=dict.fromkeys(("albedo", "normal", "depth"), "none")
    )
    assert (outcome.report.method, outcome.layers) == (PRESETS[DEFAULT_PRESET].method, {"color": "RGB"})
    batch.denoise_file(source, tmp_path / "b.exr", layers={"color": "albedo"}, method="nlm", **SMALL)
    noisy, clean = read_exr(source), read_exr(tmp_path / "b.exr")
    np.testing.assert_array_equal(clean.color, noisy.color)
    np.testing.assert_array_equal(clean.albedo, denoise(noisy.albedo, method="nlm", **SMALL))


def test_denoise_file_keeps_what_exists(tmp_path):
    source, target = write_frame(tmp_path / "in.exr"), write_frame(tmp_path / "out.exr", seed=5)
    old = target.read_bytes()
    with pytest.raises(ExrError, match=r"out.exr exists already: .* --force \(overwrite=True in Python\)"):
        batch.denoise_file(source, target, **FAST)
    assert target.read_bytes() == old
    batch.denoise_file(source, target, overwrite=True, **FAST)
    assert target.read_bytes() != old


def test_inputs_are_never_outputs(tmp_path):
    source = write_frame(tmp_path / "in.exr")
    before = source.read_bytes()
    (tmp_path / "link.exr").symlink_to(source)
    (tmp_path / "hard.exr").hardlink_to(source)
    for target in (source, tmp_path / "." / "in.exr", tmp_path / "link.exr", tmp_path / "hard.exr"):
        with pytest.raises(ExrError, match="is the input itself, which is never written to: give another output"):
            batch.denoise_file(source, target, overwrite=True)
    with pytest.raises(ExrError, match=r"in.exr would be written but is the input .*in.exr itself: give another"):
        batch.denoise_files([source], tmp_path, overwrite=True)
    (tmp_path / "other").mkdir()
    other = write_frame(tmp_path / "other" / "in.exr")
    with pytest.raises(ExrError, match="would both become"):
        batch.denoise_files([source, other], tmp_path / "new", overwrite=True)
    with pytest.raises(ExrError, match="is the input"):  # the output of one would replace another
        batch.denoise_files([source, other], tmp_path, overwrite=True)
    assert source.read_bytes() == before and not (tmp_path / "new").exists()


def test_denoise_file_errors(tmp_path):
    source = write_frame(tmp_path / "in.exr", features=False)
    with pytest.raises(FrameError, match=r"in.exr: method 'ssim-nlm' needs albedo, which is missing"):
        batch.denoise_file(source, tmp_path / "out.exr", method="ssim-nlm")
    with pytest.raises(ParameterError, match="has no parameter 'stabilised'"):
        batch.denoise_file(source, tmp_path / "out.exr", method="nlm", stabilised=True)
    with pytest.raises(ExrError, match=r"none.exr cannot be read \(No such file"):
        batch.denoise_file(tmp_path / "none.exr", tmp_path / "out.exr")
    with pytest.raises(ExrError, match=r"there is no folder .*no: make it first"):
        batch.denoise_file(source, tmp_path / "no" / "out.exr")
    with pytest.raises(ExrError, match="is a folder: give the name of a file to write"):
        batch.denoise_file(source, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["in.exr"]


def test_one_broken_file_does_not_stop_the_others(folder, tmp_path):
    out, seen = tmp_path / "new" / "out", []
    outcomes = batch.denoise_files(batch.find_exrs(folder), out, on_progress=seen.append, **FAST)
    assert sorted(seen, key=lambda outcome: outcome.source) == outcomes, "each once, as they finish"
    assert [outcome.target for outcome in outcomes] == [out / name for name in ("a.exr", "b.exr", "c.exr")]
    assert [outcome.report is not None for outcome in outcomes] == [True, False, True]
    assert isinstance(outcomes[1].error, ExrError) and "b.exr is damaged or cut short" in str(outcomes[1].error)
    assert sorted(path.name for path in out.iterdir()) == ["a.exr", "c.exr"]
    np.testing.assert_array_equal(read_exr(out / "c.exr").color, denoise(read_exr(folder / "c.exr"), **FAST))


def test_existing_outputs_are_skipped(folder, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.exr").write_bytes(b"mine")
    first, _, third = batch.denoise_files(batch.find_exrs(folder), out, **FAST)
    assert (first.report, first.error) == (None, None) and third.report is not None
    assert (out / "a.exr").read_bytes() == b"mine"
    first, _, _ = batch.denoise_files(batch.find_exrs(folder), out, overwrite=True, **FAST)
    assert first.report is not None and read_exr(out / "a.exr").shape == (H, W)


def test_one_denoiser_for_frames_alike(tmp_path, monkeypatch):
    sizes = [(H, W), (H, W), (9, 11), (9, 11), (9, 11)]
    sources = [write_frame(tmp_path / f"{i}.exr", size=size, seed=i, features=i != 4) for i, size in enumerate(sizes)]
    made = []

    class Counted(denoisers.Denoiser):
        def __init__(self, *size, method, **options):
            made.append((*size, method))
            super().__init__(*size, method=method, **options)

    monkeypatch.setattr(denoisers, "Denoiser", Counted)
    outcomes = batch.denoise_files(sources, tmp_path / "out")
    assert made == [(H, W, PRESETS[DEFAULT_PRESET].method), (9, 11, PRESETS[DEFAULT_PRESET].method)]
    for outcome in outcomes:
        np.testing.assert_array_equal(read_exr(outcome.target).color, denoise(read_exr(outcome.source)))


def test_what_is_wrong_with_all_is_said_at_once(folder, tmp_path):
    sources = batch.find_exrs(folder)
    with pytest.raises(ParameterError, match="search_radius is -1"):
        batch.denoise_files(sources, tmp_path / "out", method="nlm", search_radius=-1)
    with pytest.raises(ParameterError, match="method is 'no'"):
        batch.denoise_files(sources, tmp_path / "out", method="no")
    with pytest.raises(DeviceError, match="'no such device'"):
        batch.denoise_files(sources, tmp_path / "out", device="no such device")
    assert not (tmp_path / "out").exists()
    (tmp_path / "file").touch()
    with pytest.raises(ExrError, match=r"file.out cannot be made \(Not a directory\): give another output folder"):
        batch.denoise_files(sources, tmp_path / "file" / "out")


def test_interruption_leaves_whole_files(folder, tmp_path):
    def interrupt(outcome):
        if outcome.status == "done":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch.denoise_files(batch.find_exrs(folder), tmp_path / "out", on_progress=interrupt, **FAST)
    left = sorted((tmp_path / "out").iterdir())
    assert left and {path.name for path in left} <= {"a.exr", "c.exr"}, "no part of a file"
    assert all(read_exr(path).shape == (H, W) for path in left)


def test_replaced_pixels_are_reported(tmp_path):
    color = inputs.planes("textured", H, W, 3)
    color[3, 4], color[5, 6, 1] = np.nan, np.inf
    write_exr(tmp_path / "in.exr", color)
    outcome = batch.denoise_file(tmp_path / "in.exr", tmp_path / "out.exr")
    assert outcome.report.replaced == {"color": 2}
    assert np.isfinite(read_exr(tmp_path / "out.exr").color).all()


def test_hushed(capfd, monkeypatch):
    monkeypatch.setattr(threading, "active_count", lambda: 1)  # pytest-xdist has threads of its own
    with hushed():
        print("to stdout")
        os.write(2, b"to stderr")
    os.write(2, b"after")
    print("after")
    assert tuple(capfd.readouterr()) == ("after\n", "after")


def test_hushed_leaves_other_threads_their_streams(capfd):
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    try:
        with hushed():
            os.write(2, b"heard")
    finally:
        stop.set()
        thread.join()
    assert capfd.readouterr().err == "heard"
