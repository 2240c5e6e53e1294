"""Names and kinds of files that nobody means to pass: one sentence for each, and the files beside them are done."""

import os
import shutil

import inputs
import numpy as np
import pytest

from mcdenoise_cl import DeviceError, batch, read_exr, write_exr
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.cli import main
from mcdenoise_cl.errors import ExrError, McdenoiseError
from mcdenoise_cl.pictures import replace_file

IMAGE = inputs.planes("uniform", 9, 12, 3)
FAST = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
LONG = "x" * 300 + ".exr"
ZERO = "a\0b.exr"


@pytest.fixture
def good(tmp_path):
    write_exr(tmp_path / "good.exr", IMAGE)
    return tmp_path / "good.exr"


def only(folder, *names):
    return sorted(path.name for path in folder.iterdir()) == sorted(names)


@pytest.mark.parametrize(("name", "words"), [(LONG, "File name too long"), (ZERO, "null byte"), ("", "folder|regular")])
def test_names_that_no_file_can_have(good, tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    for call in (
        lambda: write_exr(name, IMAGE),
        lambda: batch.denoise_file(good, name, **FAST),
        lambda: batch.denoise_file(good, name, overwrite=True, **FAST),
    ):
        with pytest.raises(ExrError, match=words):
            call()
    if name:
        for call in (lambda: read_exr(name), lambda: batch.find_exrs(name), lambda: batch.denoise_files([good], name)):
            with pytest.raises(ExrError, match=words):
                call()
        first, second = batch.denoise_files([name, good], tmp_path / "out", **FAST)
        assert isinstance(first.error, ExrError) and second.error is None
        assert only(tmp_path / "out", "good.exr")
        shutil.rmtree(tmp_path / "out")
    assert only(tmp_path, "good.exr")


def test_a_name_that_is_too_long_on_the_command_line(good, tmp_path, capsys):
    for arguments in ([good, "-o", tmp_path / LONG], [tmp_path / LONG, "-o", tmp_path / "a.exr"]):
        assert main(["denoise", *map(str, arguments), "--method", "nlm"]) == 1
        said = capsys.readouterr().err
        assert "File name too long" in said and said.startswith("mcdenoise: ") and said.count("\n") == 1
    assert only(tmp_path, "good.exr")


def test_a_name_in_latin_1(good, tmp_path):
    """File systems of Unix take any bytes; OpenEXR takes UTF-8."""
    try:
        odd = tmp_path / os.fsdecode(b"b\xe9\xff.exr")
        shutil.copy(good, odd)
    except (OSError, UnicodeError):
        pytest.skip("this file system has only names in Unicode")
    np.testing.assert_array_equal(read_exr(odd).color, IMAGE)
    [outcome] = batch.denoise_files([odd], tmp_path / "out", **FAST)
    assert outcome.error is None and only(tmp_path / "out", odd.name)


def test_a_pipe_is_not_waited_for(good, tmp_path):
    os.mkfifo(tmp_path / "pipe.exr")
    with pytest.raises(ExrError, match=r"pipe.exr is not an EXR file, whatever its name"):
        read_exr(tmp_path / "pipe.exr")
    with pytest.raises(ExrError, match="is not an EXR file"):
        write_exr(tmp_path / "out.exr", IMAGE, template=tmp_path / "pipe.exr")
    assert batch.find_exrs(tmp_path) == [good] and only(tmp_path, "good.exr", "pipe.exr")


def test_a_link_to_itself(tmp_path):
    (tmp_path / "loop.exr").symlink_to(tmp_path / "loop.exr")
    with pytest.raises(ExrError, match="Too many levels of symbolic links"):
        read_exr(tmp_path / "loop.exr")


def refuse(*_, **__):
    raise PermissionError(13, "Permission denied")


def test_no_permission_to_look_into_a_folder(good, tmp_path, monkeypatch):
    """As `os.stat` then says; root, who may run the tests, is refused nothing."""
    real = os.stat

    def stat(path, *arguments, **options):
        if os.fspath(path) != tmp_path and "closed" in os.fspath(path):
            refuse()
        return real(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", stat)
    with pytest.raises(ExrError, match=r"closed.a.exr cannot be read \(Permission denied\)"):
        read_exr(tmp_path / "closed" / "a.exr")
    with pytest.raises(ExrError, match="closed"):
        batch.denoise_file(good, tmp_path / "closed" / "a.exr", **FAST)
    first, second = batch.denoise_files([tmp_path / "closed" / "a.exr", good], tmp_path / "out", **FAST)
    assert isinstance(first.error, ExrError) and second.error is None
    monkeypatch.setattr(os, "scandir", refuse)
    monkeypatch.setattr(os, "listdir", refuse)
    with pytest.raises(ExrError, match=r"cannot be read \(Permission denied\): give a folder"):
        batch.find_exrs(tmp_path)


@pytest.mark.parametrize("full", ["while writing", "while renaming"])
def test_a_batch_on_a_full_disk(good, tmp_path, monkeypatch, full):
    """The file that does not fit is reported and leaves nothing; the next one may fit."""
    shutil.copy(good, tmp_path / "later.exr")
    resource = pytest.importorskip("resource")
    if full == "while writing":
        noise = np.random.default_rng(0).random((90, 120, 3), np.float32)
        write_exr(good, noise)
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        undo = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limits)  # noqa: E731
        batch.denoise_files(
            [good, tmp_path / "later.exr"], tmp_path / "warm", **FAST
        )  # the driver writes kernels of its own
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limits[1]))
    else:
        real = type(good).replace

        def replace(path, target):
            if target.name == "good.exr":
                raise OSError(28, "No space left on device")
            return real(path, target)

        monkeypatch.setattr(type(good), "replace", replace)
        undo = monkeypatch.undo
    try:
        outcomes = batch.denoise_files([good, tmp_path / "later.exr"], tmp_path / "out", **FAST)
    finally:
        undo()
    assert "good.exr cannot be written" in str(outcomes[0].error) and "free space" in str(outcomes[0].error)
    assert outcomes[1].error is None and only(tmp_path / "out", "later.exr")


def test_pictures_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "a.png").write_bytes(b"old")
    with pytest.raises(McdenoiseError, match="File name too long"):
        replace_file(tmp_path / LONG, b"new")
    (tmp_path / "folder").mkdir()
    with pytest.raises(McdenoiseError, match="folder cannot be written"):
        replace_file(tmp_path / "folder", b"new")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(tmp_path), "replace", full)
    with pytest.raises(McdenoiseError, match=r"a.png cannot be written \(No space left on device\): check the folder"):
        replace_file(tmp_path / "a.png", b"new")
    assert (tmp_path / "a.png").read_bytes() == b"old" and only(tmp_path, "a.png", "folder")


@pytest.mark.parametrize("choice", ["²", "--5", "-1", "", "  ", "1e9", b"x", True, 10**400, []])
def test_devices_that_are_none(choice, monkeypatch):
    monkeypatch.delenv("MCDENOISE_DEVICE", raising=False)
    with pytest.raises(DeviceError, match="is none of the devices here: choose one of 0: "):
        pick_device(choice)
