"""What `fuzz_exr.py` found, and what a fuzzer should find at once: damaged EXR files become an error of our own."""

import struct
from pathlib import Path

import fuzz_exr
import numpy as np
import OpenEXR
import pytest

from mcdenoise_cl import exr_file
from mcdenoise_cl.errors import ExrError
from mcdenoise_cl.exr import read_exr, write_exr

FINDINGS = sorted((Path(__file__).parent / "fuzz_findings").iterdir())


@pytest.mark.parametrize("path", FINDINGS, ids=lambda path: path.stem)
def test_findings(tmp_path, path):
    (tmp_path / "in.exr").write_bytes(path.read_bytes())
    before = fuzz_exr.peak()
    said = fuzz_exr.door(tmp_path / "in.exr")
    assert "in.exr is damaged" in said and said.count("\n") == 0
    assert fuzz_exr.peak() - before < fuzz_exr.ROOM


def test_the_seeds_are_whole(tmp_path):
    fuzz_exr.seeds(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) > 20
    for name in names:
        said = fuzz_exr.door(tmp_path / name)
        assert said == "frame", f"{name}: {said}"


@pytest.mark.parametrize("name", ["layers", "parts-tiledimage-ZIP", "dwaa", "deep"])
def test_cut_short_anywhere(tmp_path, name, capfd):
    fuzz_exr.seeds(tmp_path)
    whole = (tmp_path / f"{name}.exr").read_bytes()
    path = tmp_path / "in.exr"
    for length in (*range(0, len(whole), 5), *range(len(whole) - 20, len(whole))):
        path.write_bytes(whole[:length])
        with pytest.raises(ExrError) as error:
            read_exr(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value)
    capfd.readouterr()


def patched(path, target, name, layout, *values):
    """The file with other values in an attribute of its first header."""
    data = path.read_bytes()
    at = data.index(name) + len(name) + 4  # past the name, its zeros and the size
    target.write_bytes(data[:at] + struct.pack(layout, *values) + data[at + struct.calcsize(layout) :])
    return target


WINDOW, TILES = b"dataWindow\0box2i\0", b"tiles\0tiledesc\0"


@pytest.mark.parametrize("storage", ["scanlineimage", "tiledimage"])
@pytest.mark.parametrize("corner", [(2**30, 1), (46340, 46340), (1, 2**30), (2**31 - 2, 2**31 - 2), (-3, 4)])
def test_a_header_of_too_many_pixels(tmp_path, storage, corner, capfd):
    fuzz_exr.seeds(tmp_path)
    path = patched(tmp_path / f"{storage}-ZIP.exr", tmp_path / "in.exr", WINDOW, "<4i", 0, 0, *corner)
    before = fuzz_exr.peak()
    with pytest.raises(ExrError, match=r"in.exr (is damaged: its header tells of|cannot be read, it is damaged)"):
        read_exr(path)
    with pytest.raises(ExrError):
        write_exr(tmp_path / "out.exr", np.ones((4, 4, 3), np.float32), template=path)
    assert fuzz_exr.peak() - before < 2**26 and not (tmp_path / "out.exr").exists()
    capfd.readouterr()


def test_tiles_may_be_wider_than_the_image_but_not_by_much(tmp_path):
    fuzz_exr.seeds(tmp_path)
    whole = tmp_path / "tiledimage-NO.exr"
    channels = {c: np.ones((5, 7), np.float32) for c in "RGB"}
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    header["tiles"].xSize = header["tiles"].ySize = 256
    OpenEXR.File([OpenEXR.Part(header, channels, "")]).write(str(tmp_path / "wide.exr"))
    assert read_exr(tmp_path / "wide.exr").shape == (5, 7)
    path = patched(whole, tmp_path / "in.exr", TILES, "<II", 5000, 3)
    with pytest.raises(
        ExrError, match=r"in.exr is damaged: its header tells of tiles of 5000 x 3 pixels in an image of 7"
    ):
        read_exr(path)


def test_a_whole_file_for_which_there_is_no_memory_is_not_called_damaged(tmp_path, monkeypatch):
    write_exr(tmp_path / "a.exr", np.ones((4, 4, 3), np.float32))

    def full(*_):
        raise MemoryError

    monkeypatch.setattr(exr_file.np, "empty", full)
    with pytest.raises(
        ExrError, match=r"a.exr has pixels of at least .* GiB, for which there is no memory: read it on"
    ):
        read_exr(tmp_path / "a.exr")
    monkeypatch.undo()
    assert read_exr(tmp_path / "a.exr").shape == (4, 4)


def test_the_densest_file_that_openexr_writes_is_read(tmp_path):
    """The bound on what a byte of a file can stand for leaves room above a constant image."""
    write_exr(tmp_path / "a.exr", np.zeros((512, 2048, 3), np.float32), compression="htj2k256")
    ratio = 2 * 3 * 512 * 2048 / (tmp_path / "a.exr").stat().st_size
    assert 1000 < ratio < exr_file.DENSEST / 10
    assert read_exr(tmp_path / "a.exr").shape == (512, 2048)
