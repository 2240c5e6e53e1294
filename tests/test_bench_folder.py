"""`bench/folder.py` on a few tiny frames: that it runs, and that it would notice."""

import numpy as np
import pytest
from test_bench import bench

from mcdenoise_cl import write_exr


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    module = bench("folder")
    source = tmp_path_factory.mktemp("bench") / "in"
    module.make_frames(source, 3, 12, 9, made_up=True)
    return module.Folder(source, "nlm")


def test_a_case_of_the_table(folder, tmp_path):
    what, wrong = bench("folder").missing(folder, tmp_path)
    assert wrong == [] and what == (
        "exit 1: 2 of 3 files denoised; 1 failed; then 0: 1 of 3 files denoised; 2 skipped, being up to date "
        "(--force does them again)"
    )


def test_what_is_wrong_is_noticed(folder, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    names = list(folder.expected)
    write_exr(out / names[0], folder.expected[names[0]])
    write_exr(out / names[1], np.nextafter(folder.expected[names[1]], np.float32(np.inf)))
    (out / ".left.tmp").touch()
    assert folder.wrong(out) == [f"{names[2]} is missing", ".left.tmp is too much", f"{names[1]} has other bits"]
    assert folder.wrong(out, {names[1], names[2]})[0] == ".left.tmp is too much"
