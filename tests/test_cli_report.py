"""`mcdenoise report`: from EXR files to a page."""

import json
import re

import inputs
import numpy as np
import pytest
from test_cli import H, W, error, notes, quick_error, write_frame

from mcdenoise_cl import Frame, write_exr
from mcdenoise_cl.cli import main
from mcdenoise_cl.page import run as page_run


@pytest.fixture
def noisy(tmp_path):
    return write_frame(tmp_path / "noisy.exr")


@pytest.fixture
def reference(tmp_path):
    path = tmp_path / "truth" / "reference.exr"
    path.parent.mkdir()
    write_exr(path, Frame(inputs.features(H, W, noise=0.0)["color"]))
    return path


def facts(path):
    return json.loads(re.search(r'id="facts">(.*)</script>', path.read_text("utf-8"))[1])


def names(path):
    return [plane["name"] for plane in facts(path)["planes"]]


def test_every_preset_by_default(noisy, reference, tmp_path):
    target = tmp_path / "report.html"
    said = notes("report", noisy, "--reference", reference, "-o", target).splitlines()
    assert re.fullmatch(
        rf"{target}: 0\.\d MB, light within 0\.\d+%, 0\.\d+% on average; open it in a browser", said[-1]
    )
    assert names(target) == [
        "input", "fast", "balanced", "high", "reference", "albedo", "normal", "depth", "estimated error of high",
        "model map of high",
    ]  # fmt: skip
    text = target.read_text("utf-8")
    assert "<title>noisy.exr</title>" in text and text.count("<summary>") == 4 and "<svg" in text
    assert sorted(path.name for path in tmp_path.iterdir()) == ["noisy.exr", "report.html", "truth"]


def test_clean_files_are_shown_as_they_are(noisy, reference, tmp_path):
    """Without a device being asked for anything."""
    target = tmp_path / "report.html"
    clean = [write_frame(tmp_path / folder / "clean.exr", seed) for seed, folder in enumerate(("", "truth"), 1)]
    said = notes("report", noisy, *clean, reference, "-o", target, "--title", "<Mine>", "--device", "none such")
    assert "denoising" not in said
    assert names(target)[:4] == ["input", "clean.exr", str(clean[1]), "reference.exr"]
    text = target.read_text("utf-8")
    assert "<title>&lt;Mine&gt;</title>" in text and "<h2>Scores</h2>" not in text


def test_methods_beside_clean_files(noisy, tmp_path):
    target, clean = tmp_path / "report.html", write_frame(tmp_path / "nlm.exr", 1)
    notes("report", noisy, clean, "-o", target, "--method", "nlm", "--max-mb", "1")
    assert names(target)[:3] == ["input", "nlm", "nlm, made here"]


def test_refusals_come_before_work_and_leave_nothing(noisy, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(page_run, "Denoiser", None)
    monkeypatch.setattr(page_run, "read_exr", None)
    old = tmp_path / "old.html"
    old.write_text("mine")
    for arguments, code, text in (
        ((noisy, "-o", old), 1, "exists already: give another name, or pass --force"),
        ((noisy, "-o", noisy, "--force"), 1, "noisy.exr is no name of a page: give one that ends with .html"),
        ((noisy, "-o", tmp_path / "no" / "a.html"), 1, "there is no folder"),
        ((old, "-o", old, "--force"), 1, "is one of the inputs, which are never written to"),
        ((noisy,), 2, "Missing option '-o'"),
        ((noisy, "-o", tmp_path / "a.html", "--max-mb", "0.5"), 2, "--max-mb"),
        ((noisy, "-o", tmp_path / "a.html", "--device", "none such"), 2, "none such"),
        ((noisy, "-o", tmp_path / "a.html", "--layer", "albedo"), 2, "PLANE=NAME is needed"),
    ):
        assert text in quick_error(capsys, "report", *arguments, code=code), arguments
    assert old.read_text() == "mine" and sorted(path.name for path in tmp_path.iterdir()) == ["noisy.exr", "old.html"]


def test_files_that_cannot_be_shown(noisy, tmp_path):
    target, text = tmp_path / "a.html", tmp_path / "text.exr"
    text.write_text("no picture")
    small = write_frame(tmp_path / "small.exr", size=(H - 1, W))
    assert "is not an EXR file" in error("report", text, "-o", target, code=1)
    for arguments in ((noisy, small), (noisy, noisy, "--reference", small)):
        said = error("report", *arguments, "-o", target, code=1)
        assert said == f"{small} is 32 x 23 pixels but {noisy} is 32 x 24: pass images of one size"
    assert not target.exists()


def test_force_replaces_and_not_finite_is_told(noisy, tmp_path, capsys):
    color = inputs.features(H, W)["color"]
    color[2, 3] = np.nan
    broken, target = tmp_path / "broken.exr", tmp_path / "a.html"
    write_exr(broken, Frame(color))
    target.write_text("old")
    assert main(["report", str(broken), str(noisy), "--reference", str(noisy), "-o", str(target), "--force"]) == 0
    said = capsys.readouterr().err
    assert "note: input has no scores: input has 1 of 768 pixels that are not finite" in said
    assert names(target)[:3] == ["input", "noisy", "reference"]
