"""Which files become which jobs: names alone, so files here are empty."""

from pathlib import Path

import pytest

from mcdenoise_cl.errors import ExrError, ParameterError
from mcdenoise_cl.selection import count_pairs, find_exrs, find_jobs, is_one_file
from mcdenoise_cl.sequence import find_neighbours, parse_frames


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A function that makes empty files, in the working directory."""
    monkeypatch.chdir(tmp_path)

    def make(*names):
        for name in names:
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            Path(name).touch()

    return make


def found(*inputs, out="out", **options):
    """What goes where, as text."""
    return [(job.source.as_posix(), job.target.as_posix()) for job in find_jobs(inputs, out, **options)]


def test_folders_keep_their_structure_when_asked(here):
    here("in/b10.exr", "in/b9.exr", "in/deep/er/b.exr", "in/.hidden/a.exr", "in/deep/.a.exr", "in/notes.txt")
    assert found("in") == [("in/b9.exr", "out/b9.exr"), ("in/b10.exr", "out/b10.exr")]
    assert found("in", recursive=True)[2:] == [("in/deep/er/b.exr", "out/deep/er/b.exr")]
    assert found(Path("in").absolute(), recursive=True)[2][1] == "out/deep/er/b.exr"
    with pytest.raises(ExrError, match=r"in.deep holds no EXR file: give a folder with .* directly in it, or ask for"):
        found("in/deep")


def test_results_within_the_inputs_are_no_inputs(here):
    here("in/a.exr", "in/clean/a.exr", "in/clean/old/a.exr", "in/other/a.exr")
    assert [source for source, _ in found("in", out="in/clean", recursive=True)] == ["in/a.exr", "in/other/a.exr"]
    assert len(find_exrs("in", recursive=True)) == 4


def test_files_folders_and_patterns_together_each_once(here):
    here("one.exr", "in/a.exr", "shots/s1/beauty.exr", "shots/s2/beauty.exr", "shots/s2/z.exr", "shots/s2/deep/q.exr")
    assert found("one.exr", "in", "shots/*/beauty.exr", "in/a.exr", "./one.exr") == [
        ("one.exr", "out/one.exr"),
        ("in/a.exr", "out/a.exr"),
        ("shots/s1/beauty.exr", "out/s1/beauty.exr"),
        ("shots/s2/beauty.exr", "out/s2/beauty.exr"),
    ]
    assert [target for _, target in found("shots/**/[qz].exr")] == ["out/s2/deep/q.exr", "out/s2/z.exr"]
    with pytest.raises(ExrError, match=r"shots/\*.exr matches no EXR file"):
        found("shots/*.exr")


def test_a_file_called_like_a_pattern_is_that_file(here):
    here("a[1].exr", "a1.exr", "shot.##.exr", "shot.07.exr", "100%d.exr")
    for name in ("a[1].exr", "shot.##.exr", "100%d.exr"):
        assert found(name) == [(name, f"out/{name}")] and is_one_file(name)
    assert not is_one_file("a*.exr") and not is_one_file("shot.%02d.exr") and not is_one_file(".")
    assert is_one_file("missing.exr")


def test_sequences(here):
    here("in/shot.0001.exr", "in/shot.0003.exr", "in/shot.12345.exr", "in/shot.12.exr", "in/shot.0001.png")
    assert found("in/shot.####.exr") == [
        (f"in/shot.{number}.exr", f"out/shot.{number}.exr") for number in ("0001", "0003", "12345")
    ]
    for pattern in ("in/shot.####.exr", "in/shot.%04d.exr"):
        names = [source for source, _ in found(pattern, frames="1-3,12345")]
        assert names == [f"in/shot.{number}.exr" for number in ("0001", "0002", "0003", "12345")], "missing ones too"
    assert [source for source, _ in found("in/shot.%d.exr", frames=[12])] == ["in/shot.12.exr"]
    assert found("s.##/f.##.exr", frames="7")[0] == ("s.07/f.07.exr", "out/s.07/f.07.exr")
    with pytest.raises(ExrError, match=r"no file is called in/other.#.exr, with a number in the place of #"):
        found("in/other.#.exr")
    with pytest.raises(ExrError, match="has its number in more than one place: say which frames with --frames"):
        found("s.##/f.##.exr")
    with pytest.raises(ParameterError, match="frames is given but no input is a sequence: give one such as"):
        found("in", frames="1-2")


def test_ranges_of_frames():
    assert parse_frames("1-7x3, 20,-2--1") == [1, 4, 7, 20, -2, -1]
    assert parse_frames("3,1-4") == [3, 1, 2, 4]
    for wrong, words in (
        ("", "something like 1-240"),
        ("1-", "something like"),
        ("1-5x0", "something like"),
        ("5-1", "1 comes before 5"),
        ("1-9999999", "more than 1000000 frames"),
        (5, "text such as '1-240' or whole numbers are needed"),
    ):
        with pytest.raises(ParameterError, match=words):
            parse_frames(wrong)


def test_pairs_only_when_asked(here):
    here("in/s.1.a.exr", "in/s.1.b.exr", "in/s.2.b.exr", "in/whole.exr", "in/S.3.A.EXR", "in/S.3.B.EXR")
    plain = find_jobs(["in"], "out")
    assert len(plain) == 6 and count_pairs(plain) == 2 and all(job.halves is None for job in plain)
    jobs = {job.target.name: job.halves for job in find_jobs(["in"], "out", pairs=True)}
    one, two, three = (Path("in", name) for name in ("s.1.a.exr", "s.2.a.exr", "S.3.A.EXR"))
    assert jobs == {
        "S.3.EXR": (three, Path("in/S.3.B.EXR")),
        "s.1.exr": (one, Path("in/s.1.b.exr")),
        "s.2.exr": (two, Path("in/s.2.b.exr")),  # the first is missing, which reading will say
        "whole.exr": None,
    }
    [job] = find_jobs([("seed7.exr", "seed8.exr")], "out")
    assert (job.source.name, job.target.name, job.halves) == ("seed7.exr", "seed7.exr", tuple(job.inputs))
    here("in/s.1.exr")
    with pytest.raises(ExrError, match=r"s.1.a.exr and in/s.1.exr would both become"):
        find_jobs(["in"], "out", pairs=True)


def test_neighbours_are_the_nearest_that_are_there(here):
    here(*(f"in/shot2.{number:03d}.exr" for number in (1, 3, 5, 9, 10, 11)), "in/shot3.004.exr", "in/still.exr")

    def names(path, count):
        return [neighbour.name[6:9] for neighbour in find_neighbours(Path(path), count)]

    assert names("in/shot2.005.exr", 2) == ["001", "003", "009", "010"]
    assert names("in/shot2.001.exr", 1) == ["003"] and names("in/shot2.005.exr", 0) == []
    assert names("in/still.exr", 2) == []
    jobs = find_jobs(["in/shot2.###.exr"], "out", frames="5", temporal=1)
    assert [path.name for path in jobs[0].neighbours] == ["shot2.003.exr", "shot2.009.exr"], "though not asked for"
    assert find_jobs(["in/shot2.005.exr"], "out")[0].neighbours == ()
    here("p/a.1.a.exr", "p/a.1.b.exr", "p/a.2.a.exr", "p/a.2.b.exr")
    first = find_jobs(["p"], "out", pairs=True, temporal=1)[0]
    assert [path.name for path in first.neighbours] == ["a.2.a.exr"]
    assert [path.name for path in first.inputs] == ["a.1.a.exr", "a.1.b.exr", "a.2.a.exr", "a.2.b.exr"]
