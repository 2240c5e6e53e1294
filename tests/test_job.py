"""One job at a time, here and in another process; and the frames that a sequence shares."""

import multiprocessing
import pickle
from collections import Counter
from dataclasses import replace
from pathlib import Path

import inputs
import numpy as np
import pytest

from mcdenoise_cl import denoisers, read_exr, write_exr
from mcdenoise_cl import job as jobs
from mcdenoise_cl.api import denoise
from mcdenoise_cl.batch import denoise_files
from mcdenoise_cl.errors import ExrError, ParameterError
from mcdenoise_cl.job import Job, Recipe, portable, run_job

SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
SIZE = (9, 12)


def test_in_another_process(tmp_path):
    """As a farm does: everything that goes over is pickled; nothing is shared but the files."""
    write_exr(tmp_path / "a.exr", inputs.planes("uniform", *SIZE, 3))
    work = [Job(tmp_path / name, tmp_path / "out" / name) for name in ("a.exr", "missing.exr")]
    recipe = Recipe.of(**SMALL)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        done, failed = pool.starmap(run_job, [(job, recipe) for job in work])
        [again] = pool.starmap(run_job, [(work[0], recipe)])
    assert (done.status, failed.status, again.status) == ("done", "failed", "skipped")
    assert done.report.method == "nlm" and "missing.exr cannot be read" in str(failed.error)
    np.testing.assert_array_equal(read_exr(work[0].target).color, denoise(read_exr(work[0].source), **SMALL))


def test_recipes():
    recipe = Recipe.of(**SMALL, layers={"depth": "none", "albedo": "DiffCol"})
    assert recipe == Recipe.of(**SMALL | {"patch_sigma": None}, layers={"albedo": "DiffCol", "depth": "none"})
    assert hash(recipe) == hash(pickle.loads(pickle.dumps(recipe)))
    assert dict(recipe.parameters)["h_factor"] == 1.5, "defaults too: another version may have others"
    assert Recipe.of(also="auto").also == "auto" and Recipe.of(also=["a", "b"]).also == ("a", "b")
    for wrong in ({"temporal": -1}, {"temporal": 1.5}, {"temporal": True}, {"method": "no"}, {"preset": "no"}):
        with pytest.raises(ParameterError):
            Recipe.of(**wrong)


def test_errors_travel():
    class Local(Exception):
        pass

    ours = ExrError("a.exr cannot be read")
    assert portable(ours) is ours
    assert str(portable(Local("one\ntwo"))) == "unexpected Local: one\ntwo"
    pickle.dumps(portable(Local(lambda: None)))


@pytest.fixture
def sequence(tmp_path):
    for number in range(1, 8):
        path = tmp_path / "in" / f"shot.{number:02d}.exr"
        path.parent.mkdir(exist_ok=True)
        write_exr(path, inputs.planes("uniform", *SIZE, 3, number))
    return tmp_path / "in"


@pytest.fixture
def seen(monkeypatch):
    """Frame -> its neighbours, and how often each file was read; denoised without them."""
    neighbours, reads = {}, Counter()
    real, load = denoisers.Denoisers.denoise, jobs.load

    def name(frame):
        return Path(frame.metadata["source"]).name[5:7]

    def denoise(self, material, recipe):
        neighbours[name(material.frame)] = [name(frame) for frame in material.neighbours]
        return real(self, replace(material, neighbours=()), recipe)

    def count(path):
        reads[Path(path).name[5:7]] += 1
        return load(path)

    monkeypatch.setattr(denoisers.Denoisers, "denoise", denoise)
    monkeypatch.setattr(jobs, "load", count)
    return neighbours, reads


def test_neighbours_are_read_once(sequence, tmp_path, seen):
    neighbours, reads = seen
    outcomes = denoise_files(sequence, tmp_path / "out", temporal=2, **SMALL)
    assert [outcome.status for outcome in outcomes] == ["done"] * 7
    assert neighbours["01"] == ["02", "03"] and neighbours["04"] == ["02", "03", "05", "06"]
    assert set(reads.values()) == {1} and len(reads) == 7
    # A frame that changes makes those out of date that it is a neighbour of, and no other.
    write_exr(sequence / "shot.01.exr", inputs.planes("uniform", *SIZE, 3, 9))
    again = denoise_files(sequence, tmp_path / "out", temporal=2, **SMALL)
    assert [outcome.status for outcome in again] == ["done"] * 3 + ["skipped"] * 4
    assert (
        denoise_files(sequence / "shot.02.exr", tmp_path / "out", **SMALL)[0].reason == "temporal was 2 and is not set"
    )


def test_a_neighbour_that_cannot_be_used_is_left_out(sequence, tmp_path, seen):
    (sequence / "shot.03.exr").write_bytes(b"broken")
    write_exr(sequence / "shot.05.exr", np.ones((4, 4, 3), np.float32))
    outcomes = denoise_files(sequence, tmp_path / "out", temporal=1, **SMALL)
    assert [outcome.status for outcome in outcomes] == ["done"] * 2 + ["failed"] + ["done"] * 4
    assert seen[0] == {"01": ["02"], "02": ["01"], "04": [], "05": [], "06": ["07"], "07": ["06"]}
    [note] = outcomes[1].notes
    assert "done without its neighbour" in note and "shot.03.exr is not an EXR file" in note
    assert any("which is (4, 4) and not (9, 12)" in note for note in outcomes[3].notes)
