"""Folders of frames: what is up to date, what goes wrong, what is stopped; every output as `denoise` makes it alone."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import inputs
import numpy as np
import pytest

from mcdenoise_cl import denoise_files, exr_file, pipeline, read_exr, write_exr
from mcdenoise_cl.api import denoise
from mcdenoise_cl.batch import denoise_file
from mcdenoise_cl.cli import main
from mcdenoise_cl.errors import ExrError
from mcdenoise_cl.exr import STAMP
from mcdenoise_cl.exr_file import load, read_header, save
from mcdenoise_cl.frame import Frame
from mcdenoise_cl.temporary import sweep

SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
OPTIONS = ["--method", "nlm", "--set", "search_radius=1", "--set", "patch_radius=1"]
SIZE, COUNT = (9, 12), 6


@pytest.fixture(scope="session")
def frames(tmp_path_factory):
    """Six frames of two sizes; not to be written to."""
    folder = tmp_path_factory.mktemp("frames")
    for number in range(COUNT):
        size = SIZE if number % 3 else (7, 5)
        write_exr(folder / f"shot.{number:04d}.exr", Frame(**inputs.features(*size, seed=number)))
    return folder


@pytest.fixture
def folder(frames, tmp_path):
    """The same, to do anything with."""
    return shutil.copytree(frames, tmp_path / "in")


@pytest.fixture(scope="session")
def expected(frames):
    """What each becomes alone."""
    return {path.name: denoise(read_exr(path), **SMALL) for path in sorted(frames.iterdir())}


def check(out, expected, but=()):
    """Every output is there but some, to the bit, and nothing else."""
    names = sorted(set(expected) - set(but))
    assert sorted(path.name for path in out.iterdir()) == names
    check_some(out, expected, names)


def check_some(out, expected, names):
    for name in names:
        np.testing.assert_array_equal(read_exr(out / name).color, expected[name], err_msg=name)


def statuses(outcomes):
    return [outcome.status for outcome in outcomes]


def test_as_frame_by_frame(folder, tmp_path, expected, monkeypatch):
    kept = threads_at_once(monkeypatch)
    outcomes = denoise_files(folder, tmp_path / "out", **SMALL)
    assert statuses(outcomes) == ["done"] * COUNT and [o.source.name for o in outcomes] == sorted(expected)
    assert all(set(o.seconds) == {"read", "denoise", "write"} and o.reason == "new" for o in outcomes)
    check(tmp_path / "out", expected)
    assert kept() <= sum(pipeline.helpers()) + 2, "memory grows with the number of frames"


def threads_at_once(monkeypatch):
    """The most frames that have been read and not yet written."""
    alive, most = 0, 0
    real_read, real_write = pipeline.read_job, pipeline.write_job

    def read(*arguments):
        nonlocal alive, most
        alive += 1
        most = max(most, alive)
        return real_read(*arguments)

    def write(*arguments):
        nonlocal alive
        time.sleep(0.05)  # slower than all else, so that frames pile up if they can
        real_write(*arguments)
        alive -= 1

    monkeypatch.setattr(pipeline, "read_job", read)
    monkeypatch.setattr(pipeline, "write_job", write)
    return lambda: most


def test_what_is_up_to_date_is_skipped_and_what_is_not_is_done_again(folder, tmp_path, expected):
    out = tmp_path / "out"
    denoise_files(folder, out, **SMALL)
    before = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    again = denoise_files(folder, out, **SMALL, max_memory_mb=1000, patch_sigma=None)
    assert statuses(again) == ["skipped"] * COUNT and {o.reason for o in again} == {"up to date"}
    assert {path: path.stat().st_mtime_ns for path in out.iterdir()} == before
    os.utime(folder / "shot.0002.exr")
    shutil.copy2(folder / "shot.0004.exr", folder / "shot.0005.exr")
    (out / "shot.0001.exr").unlink()
    again = denoise_files(folder, out, **SMALL)
    assert statuses(again) == ["skipped", "done", "done", "skipped", "skipped", "done"]
    assert [o.reason for o in again if o.report] == ["new", "the input has changed", "the input has changed"]
    check(out, expected | {"shot.0005.exr": expected["shot.0004.exr"]})
    for options, reason in (
        (SMALL | {"h_factor": 2.0}, "h_factor was 1.5 and is 2.0"),
        (SMALL, "h_factor was 2.0 and is 1.5"),
        ({**SMALL, "layers": {"depth": "none"}}, "depth was not set and is none"),
        ({**SMALL, "samples_per_pixel": 4}, "depth was none and is not set"),
        ({"preset": "fast"}, "method was nlm and is guided"),
    ):
        again = denoise_files(folder / "shot.0002.exr", out, **options)
        assert [(o.status, o.reason) for o in again] == [("done", reason)]
    assert statuses(denoise_files(folder, out, overwrite=True, **SMALL)) == ["done"] * COUNT


def test_another_version_does_it_again(folder, tmp_path, monkeypatch):
    denoise_files(folder, tmp_path / "out", **SMALL)
    monkeypatch.setattr("mcdenoise_cl.stamp.__version__", "99.0")
    [first, *_] = denoise_files(folder, tmp_path / "out", **SMALL)
    assert first.reason == "version was 0.1.0 and is 99.0"


def test_a_moved_project_is_still_up_to_date(folder, tmp_path):
    denoise_files(folder, tmp_path / "out", **SMALL)
    (tmp_path / "moved").mkdir()
    for name in ("in", "out"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    again = denoise_files(tmp_path / "moved" / "in", tmp_path / "moved" / "out", **SMALL)
    assert statuses(again) == ["skipped"] * COUNT


def test_nothing_of_anybody_else_is_replaced(folder, tmp_path, capsys):
    out, other = tmp_path / "out", tmp_path / "other"
    out.mkdir()
    (out / "shot.0000.exr").write_text("mine")
    write_exr(out / "shot.0001.exr", np.ones((*SIZE, 3), np.float32))
    denoise_files(folder / "shot.0002.exr", out, **SMALL)
    # The same with something painted over: whoever saves it with write_exr makes it his own.
    write_exr(out / "shot.0002.exr", np.zeros((*SIZE, 3), np.float32), template=out / "shot.0002.exr")
    other.mkdir()
    write_exr(other / "shot.0003.exr", np.ones((*SIZE, 3), np.float32))
    denoise_files(other, out, **SMALL)  # another shot, whose frames are called the same
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    outcomes = denoise_files(folder, out, **SMALL)
    assert statuses(outcomes) == ["skipped"] * 4 + ["done"] * 2
    reasons = [outcome.reason for outcome in outcomes]
    assert all("exists and is not mcdenoise's: --force" in reason for reason in reasons[:3])
    assert reasons[3].startswith("the output was made from ../other/shot.0003.exr: --force")
    assert {name: (out / name).read_bytes() for name in before} == before
    assert main(["denoise", str(folder), "-o", str(out), *OPTIONS]) == 0
    said = capsys.readouterr().err
    assert "2 skipped, being up to date" in said and "4 skipped, as something else is there" in said
    assert f"note: {out / 'shot.0003.exr'} was skipped: the output was made from ../other" in said
    assert statuses(denoise_files(folder, out, overwrite=True, **SMALL)) == ["done"] * COUNT


def test_the_stamp_changes_nothing_else_in_the_header(folder, tmp_path):
    source = folder / "shot.0001.exr"
    parts = load(source)
    extra = {"owner": "A. N. Artist", "mcdenoise": "of an earlier time", "exposureScale": 2.0}
    parts[0] = exr_file.Part(parts[0].header | extra, parts[0].channels, False)
    save(source, parts)
    denoise_files(source, tmp_path / "out", **SMALL)
    old, new = read_header(source), read_header(tmp_path / "out" / source.name)
    assert set(new) == set(old) and new["owner"] == "A. N. Artist" and new["exposureScale"] == old["exposureScale"]
    facts = json.loads(new[STAMP])
    assert facts["method"] == "nlm" and facts["source"] == "../in/shot.0001.exr"
    assert facts["inputs"] == [[source.name, source.stat().st_size, source.stat().st_mtime_ns]]


def test_a_single_file_is_refused_unless_up_to_date(folder, tmp_path, capsys):
    source, target = folder / "shot.0001.exr", tmp_path / "clean.exr"
    assert denoise_file(source, target, **SMALL).status == "done"
    assert denoise_file(source, target, **SMALL).reason == "up to date"
    with pytest.raises(ExrError, match="exists already"):
        denoise_file(source, target, **SMALL | {"h_factor": 2.0})
    assert main(["denoise", str(source), "-o", str(target), *OPTIONS]) == 0
    assert capsys.readouterr().err == f"{target}: up to date, so nothing was done (--force does it again)\n"
    assert denoise_file(source, target, overwrite=True, **SMALL).status == "done"


def test_a_corrupt_file_and_a_missing_frame(folder, tmp_path, expected, capsys):
    (folder / "shot.0002.exr").write_bytes((folder / "shot.0002.exr").read_bytes()[:900])
    arguments = ["denoise", str(folder / "shot.####.exr"), "--frames", "0-6", "-o", str(tmp_path / "out"), *OPTIONS]
    assert main(arguments) == 1
    said = capsys.readouterr().err
    assert "5 of 7 files denoised" in said and "; 2 failed\n" in said
    assert "shot.0002.exr" in said and "shot.0006.exr cannot be read (No such file or directory)" in said
    check(tmp_path / "out", expected, but=["shot.0002.exr"])


def test_json_lines_and_a_dry_run(folder, tmp_path, capfd):
    out = tmp_path / "out"
    (folder / "shot.0003.exr").write_bytes(b"no picture")
    denoise_files(folder / "shot.0001.exr", out, **SMALL)
    (out / "shot.0002.exr").touch()
    (folder / "sub").mkdir()
    shutil.copy(folder / "shot.0000.exr", folder / "sub" / "a.exr")
    arguments = ["denoise", str(folder), "--recursive", "-o", str(out), *OPTIONS, "--json"]
    before = sorted(out.rglob("*"))
    assert main([*arguments, "--dry-run"]) == 0
    plan = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [event["action"] for event in plan] == ["denoise", "skip", "skip", *["denoise"] * 4]
    assert plan[1]["reason"] == "up to date" and plan[6]["target"] == str(out / "sub" / "a.exr")
    assert sorted(out.rglob("*")) == before
    assert main(arguments) == 1
    start, *files, end = (json.loads(line) for line in capfd.readouterr().out.splitlines())
    assert (start["event"], start["files"], start["method"]) == ("start", 7, "nlm")
    assert start["parameters"]["search_radius"] == 1 and start["version"]
    by_name = {os.path.relpath(event["source"], folder): event for event in files}
    assert len(by_name) == 7 and {event["event"] for event in files} == {"file"}
    assert by_name["shot.0001.exr"]["status"] == by_name["shot.0002.exr"]["status"] == "skipped"
    assert by_name["shot.0003.exr"]["status"] == "failed"
    assert "is not an EXR file" in by_name["shot.0003.exr"]["reason"]
    done = by_name["sub/a.exr"]
    assert done["status"] == "done" and set(done["seconds"]) == {"read", "denoise", "write"} and done["device"]
    assert (end["event"], end["done"], end["skipped"], end["failed"], end["left"]) == ("end", 4, 2, 1, 0)
    assert main(["denoise", str(folder / "shot.0000.exr"), str(folder / "no.exr"), "-o", str(out), "--dry-run"]) == 1
    said = capfd.readouterr()
    assert "no.exr cannot be read" in said.out and "1 would fail" in said.err


def test_the_same_file_alone_in_json(folder, tmp_path, capfd):
    target = tmp_path / "new.exr"
    assert main(["denoise", str(folder / "shot.0001.exr"), "-o", str(target), *OPTIONS, "--json"]) == 0
    events = [json.loads(line)["event"] for line in capfd.readouterr().out.splitlines()]
    assert events == ["start", "file", "end"] and target.is_file()


def test_noise_of_libraries_stays_out_of_json(folder, tmp_path):
    """In a process of its own: OpenEXR writes past Python. Halved pixels make it say the most."""
    whole = (folder / "shot.0001.exr").read_bytes()
    (folder / "shot.0001.exr").write_bytes(whole[: len(whole) // 2])
    code = "import sys; from mcdenoise_cl.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "denoise", str(folder), "-o", str(tmp_path / "out"), *OPTIONS, "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1
    assert [json.loads(line)["event"] for line in done.stdout.splitlines()] == ["start", *["file"] * COUNT, "end"]
    assert len(done.stderr.splitlines()) == 3 and "EXR_ERR" not in done.stderr, done.stderr


KILLED = """
import os, sys, signal
from mcdenoise_cl import exr_file, denoise_files
real, left = exr_file._write, int(sys.argv[4])
def write(path, parts):
    global left
    left -= 1
    real(path, parts)
    if left == 0:
        if sys.argv[3] == "half":
            os.truncate(path, os.path.getsize(path) // 2)
        os.kill(os.getpid(), signal.SIGKILL)
exr_file._write = write
denoise_files(sys.argv[1], sys.argv[2], method="nlm", search_radius=1, patch_radius=1)
"""


@pytest.mark.skipif(os.name != "posix", reason="there is no kill -9")
@pytest.mark.parametrize("how", ["half", "whole"])
def test_killed_and_run_again(folder, tmp_path, expected, how):
    """While the third file is being written, and between writing and renaming it."""
    undisturbed, out = tmp_path / "undisturbed", tmp_path / "out"
    denoise_files(folder, undisturbed, **SMALL)
    done = subprocess.run([sys.executable, "-c", KILLED, folder, out, how, "3"])
    assert done.returncode == -signal.SIGKILL
    left = sorted(path.name for path in out.iterdir())
    whole = [name for name in left if name.endswith(".exr")]
    check_some(out, expected, whole)
    assert 0 < len(whole) <= 2 and len(left) > len(whole), "of three begun, the last was under its name"
    outcomes = denoise_files(folder, out, **SMALL)
    assert statuses(outcomes).count("skipped") == len(whole)
    assert statuses(outcomes).count("done") == COUNT - len(whole)
    check(out, expected)
    assert {p.name: p.read_bytes() for p in out.iterdir()} == {p.name: p.read_bytes() for p in undisturbed.iterdir()}


def test_only_what_the_dead_left_is_swept_up(tmp_path):
    with pytest.raises(KeyError), exr_file.unfinished(tmp_path / "a.exr") as mine:
        space = mine.name.split("-")[1]
        dead = subprocess.Popen([sys.executable, "-c", ""])
        dead.wait()
        names = {
            "dead": f".mcdenoise-{space}-{dead.pid}-{'0' * 16}.tmp",
            "alive": f".mcdenoise-{space}-{os.getppid()}-{'0' * 16}.tmp",
            "recycled": f".mcdenoise-{space}-{os.getpid()}-{'0' * 16}.tmp",
            "elsewhere": f".mcdenoise-{'0' * 12}-{dead.pid}-{'0' * 16}.tmp",
            "long ago": f".mcdenoise-{'1' * 12}-{dead.pid}-{'0' * 16}.tmp",
            "other": ".mcdenoise-notes.tmp",
        }
        for name in names.values():
            (tmp_path / name).touch()
        os.utime(tmp_path / names["long ago"], (0, 0))
        sweep(tmp_path)
        left = {path.name for path in tmp_path.iterdir()}
        assert left == {mine.name, names["alive"], names["elsewhere"], names["other"]}
        raise KeyError
    assert not mine.exists()
    sweep(tmp_path / "no such folder")


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 64 KiB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if os.name != "posix" or os.geteuid() != 0:
        pytest.skip("only root may mount a small file system")
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
    yield disk
    subprocess.run(["umount", disk], check=True)


def test_a_full_disk(folder, tmp_path, expected, small_disk):
    (small_disk / "ballast").write_bytes(bytes(40_000))
    outcomes = denoise_files(folder, small_disk / "out", **SMALL)
    failed = [outcome for outcome in outcomes if outcome.error]
    assert 0 < len(failed) < COUNT and all("cannot be written" in str(outcome.error) for outcome in failed)
    check(small_disk / "out", expected, but=[outcome.source.name for outcome in failed])
    (small_disk / "ballast").unlink()
    again = denoise_files(folder, small_disk / "out", **SMALL)
    assert sorted(statuses(again)) == ["done"] * len(failed) + ["skipped"] * (COUNT - len(failed))
    check(small_disk / "out", expected)


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_ends_the_json_too(folder, tmp_path, capfd, monkeypatch):
    real, count = pipeline.write_job, 0

    def write(*arguments):
        nonlocal count
        count += 1
        if count == 2:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)  # the main thread hears of it while this frame is being written
        return real(*arguments)

    monkeypatch.setattr(pipeline, "write_job", write)
    assert main(["denoise", str(folder), "-o", str(tmp_path / "out"), *OPTIONS, "--json"]) == 130
    end = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert end["event"] == "end" and end["interrupted"] and end["left"] > 0
    files = sorted((tmp_path / "out").iterdir())
    assert 2 <= len(files) < COUNT and all(read_exr(path).shape for path in files), "the frame in flight is finished"
