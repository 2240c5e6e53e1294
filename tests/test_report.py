import errno
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mcdenoise_cl import report
from mcdenoise_cl.errors import McdenoiseError, ParameterError
from mcdenoise_cl.metrics import Scores
from mcdenoise_cl.pictures import side_by_side


def table(*arguments):
    lines = report.scores_table(*arguments).splitlines()
    assert len({len(line) for line in lines}) == 1, "the table is not aligned"
    return [[text.strip() for text in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]


ROWS = {
    "noisy": Scores(12.344, 0.0583, 123.4, 0.9, 0.1, 0.4),
    "joint | NLM": Scores(30.0, 0.001, 0.01239, -1e-5, 0.9, None),
    "median": Scores(30.001, 0.002, 1234.5, 2.0),
}


def test_scores_table():
    head, rule, noisy, nlm, median = table(ROWS, {"joint | NLM": 0.01234, "noisy": 1.5})
    assert head == ["image", "PSNR, dB", "MSE", "relMSE", "relMSE, trimmed", "SSIM", "FLIP", "time, ms"]
    assert all(re.fullmatch(r":-+" if i == 0 else r"-+:", text) for i, text in enumerate(rule))
    assert noisy == ["noisy", "12.34", "0.0583", "123", "0.900", "0.1000", "0.4000", "1500.0"]
    assert nlm == [
        r"joint \| NLM",
        "**30.00**",
        "**0.00100**",
        "**0.0124**",
        "**-1.00e-05**",
        "**0.9000**",
        "-",
        "**12.3**",
    ]
    assert median == ["median", "**30.00**", "0.00200", "1.23e+03", "2.00", "-", "-", "-"]


def test_scores_table_without_times_or_rivals():
    assert [len(row) for row in table(ROWS)] == [7] * 5
    assert table({"a": Scores(math.inf, 0.0, 0.0, 0.0)})[2] == ["a", "inf", "0.00", "0.00", "0.00", "-", "-"]
    assert table({"a": Scores(math.inf, 0, 0, 0), "b": Scores(20, 0.01, 1, 1)})[2][1] == "**inf**"
    assert table({"a": Scores(math.nan, 0, 0, 0), "b": Scores(20, 0.01, 1, 1)})[2][1] == "nan"
    assert len(table({})) == 2


def test_scores_table_refuses_times_of_nothing():
    with pytest.raises(ParameterError, match="times has 'nml' but rows has not: name the times after the rows"):
        report.scores_table(ROWS, {"nml": 1.0})


def test_write_report(tmp_path):
    rng = np.random.default_rng(3)
    images = {name: rng.random((9, 16, 3), np.float32) for name in ("noisy", "denoised")}
    pictures = {"Noisy & denoised": side_by_side(images), "***": images["noisy"], "éé": images["denoised"]}
    path = report.write_report(
        tmp_path / "new" / "report", ROWS, times={"noisy": 1}, pictures=pictures, device="PoCL <3>"
    )
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# Denoising report\n\nDevice: PoCL \\<3\\>\n\n| image")
    assert report.scores_table(ROWS, {"noisy": 1}) in text
    links = re.findall(r"!\[.*\]\((.*)\)", text)
    assert links == ["01-noisy-denoised.png", "02-picture.png", "03-picture.png"]
    assert sorted(file.name for file in path.parent.iterdir()) == sorted([*links, "report.md"])
    with Image.open(path.parent / links[0]) as read:
        np.testing.assert_array_equal(np.asarray(read), pictures["Noisy & denoised"])


def test_write_report_of_numbers_alone(tmp_path):
    text = report.write_report(tmp_path, ROWS, title="Two\nlines", text="*So* it is.").read_text(encoding="utf-8")
    assert text == f"# Two lines\n\n*So* it is.\n\n{report.scores_table(ROWS)}\n"


@pytest.mark.parametrize("code", [errno.EACCES, errno.ENOSPC])
@pytest.mark.parametrize("call", ["mkdir", "write_bytes", "replace"])
def test_a_folder_that_takes_nothing(tmp_path, monkeypatch, call, code):
    """No permission, or a full disk: one sentence, and of the files none in part."""

    def fails(self, *arguments, **options):
        raise OSError(code, os.strerror(code), str(self))

    with monkeypatch.context() as patch:
        patch.setattr(Path, call, fails)
        with pytest.raises(McdenoiseError, match=os.strerror(code)) as caught:
            report.write_report(tmp_path / "new", ROWS, pictures={"one": np.zeros((4, 4, 3))})
    assert "\n" not in str(caught.value)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


@pytest.mark.parametrize("name", ["file/below", "x" * 300, "a\0b"])
def test_a_folder_that_cannot_be(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(McdenoiseError, match="cannot be made"):
        report.write_report(tmp_path / name, ROWS)
    assert (tmp_path / "file").read_text() == "mine" and len(list(tmp_path.iterdir())) == 1
