"""Caches that are damaged, full, or not to be written: the next process does as well without them."""

import os
import shutil
import sqlite3

import numpy as np
import pytest
from processes import Place, is_whole

from mcdenoise_cl import DeviceError, choose, measured, pocl_cache
from mcdenoise_cl.device import identity, shape_as_text, shape_for, shapes

DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "garbage": lambda data: np.random.default_rng(0).bytes(max(len(data), 100)),
}


@pytest.mark.parametrize("first", DAMAGES)
def test_a_damaged_database_of_pyopencl_is_made_again(warm, digest, first):
    [database] = warm.files("*invoker*.sqlite")
    database.write_bytes(DAMAGES[first](database.read_bytes()))
    assert warm.run() == warm.run() == digest
    with sqlite3.connect(database) as check:
        assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.parametrize(
    ("pattern", "whole"),
    [("*.so", pocl_cache.is_whole_elf), ("program.bc", pocl_cache.is_whole_bitcode), ("program-*.bin", is_whole)],
)
def test_damaged_programs_are_built_again(warm, digest, pattern, whole):
    files = warm.files(pattern)
    assert len(files) > 3 and all(map(whole, files))
    for number, path in enumerate(files):  # one is empty, the next cut short, the next overwritten, and so on
        path.write_bytes(list(DAMAGES.values())[number % 3](path.read_bytes()))
    assert not any(map(whole, files))
    assert warm.run(**({"OWN_CACHE": "1"} if pattern == "program-*.bin" else {})) == digest
    assert warm.files(pattern) and all(map(whole, warm.files(pattern)))


@pytest.mark.parametrize("damage", [*DAMAGES, "other JSON"])
def test_damaged_measurements_are_made_again(damage, monkeypatch, tmp_path, pocl):
    monkeypatch.setattr(measured, "folder", lambda: tmp_path)
    monkeypatch.delenv("MCDENOISE_DEVICE", raising=False)
    monkeypatch.setattr(choose, "list_devices", lambda: [pocl, pocl])
    monkeypatch.setattr(choose, "_time", lambda device: 1.0)
    last = shapes(pocl.device)[-1]
    measured.remember(identity(pocl), shape_as_text(last))
    assert choose.pick_device() == pocl and shape_for(pocl.device) == last
    files = list(tmp_path.iterdir())
    assert len(files) == 2
    for path in files:
        path.write_bytes(b'{"a": [1, null]}' if damage == "other JSON" else DAMAGES[damage](path.read_bytes()))
    assert choose.pick_device() == pocl and shape_for(pocl.device) == shapes(pocl.device)[0]


def test_without_any_folder_for_caches(tmp_path, pocl, digest):
    process = Place(tmp_path / "place", pocl).start(XDG_CACHE_HOME=os.devnull, POCL_CACHE_DIR=os.devnull)
    out, err = process.communicate()
    assert (process.returncode, out.strip(), err) == (0, digest, "")


def test_without_room_for_the_kernels_of_pocl(device, monkeypatch, tmp_path):
    monkeypatch.setenv(pocl_cache.VARIABLE, str(tmp_path))
    pocl_cache.check_room()
    usage = shutil.disk_usage(tmp_path)._replace(free=pocl_cache.ROOM - 1)
    monkeypatch.setattr(pocl_cache.shutil, "disk_usage", lambda folder: usage)
    with pytest.raises(
        DeviceError, match=rf"in {tmp_path}, where .* less than 32 MiB are free: make room there, or set"
    ):
        pocl_cache.check_room()


def test_a_full_disk_under_our_own_cache(monkeypatch, tmp_path):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(measured, "folder", lambda: tmp_path)
    monkeypatch.setattr(measured.Path, "replace", full)
    assert not measured.remember("a", 1) and list(tmp_path.iterdir()) == []
    monkeypatch.setattr(measured.tempfile, "NamedTemporaryFile", full)
    assert not measured.remember("a", 1) and measured.recall("a") is None
    measured.forget("a")
