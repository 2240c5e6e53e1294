"""Which frames are to be denoised: files, folders, patterns and sequences become jobs. No pixels are read."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .errors import ExrError, ParameterError
from .halves import half_of, partner, whole_name
from .job import Job
from .sequence import expand, find_frames, find_neighbours, is_sequence, parse_frames

StrPath = str | os.PathLike[str]
#: A file, folder, pattern or sequence; or two files that are halves of one frame.
Input = StrPath | tuple[StrPath, StrPath]


@dataclass(frozen=True)
class _Found:
    """A file and where its result goes, seen from the output folder."""

    path: Path
    place: Path
    second: Path | None = None


def find_exrs(folder: StrPath, recursive: bool = False, without: StrPath | None = None) -> list[Path]:
    """Every EXR directly in a folder, or anywhere below it, in the order of names and numbers; hidden ones aside.

    Args:
        without: a folder to leave out, such as that of the results.

    Raises:
        ExrError: a folder cannot be read, or there is none.
    """

    def refuse(error: Exception) -> None:
        reason = getattr(error, "strerror", None) or error
        where = getattr(error, "filename", None) or folder
        raise ExrError(f"{where} cannot be read ({reason}): give a folder of EXR files") from None

    left_out, found = None if without is None else _identity(Path(without)), []
    try:
        for here, folders, names in os.walk(folder, onerror=refuse):
            visible = sorted((name for name in folders if not name.startswith(".")), key=_natural)
            folders[:] = [n for n in visible if left_out is None or _identity(Path(here, n)) != left_out]
            if not recursive:
                folders.clear()
            paths = [Path(here, name) for name in sorted(names, key=_natural)]
            found += [path for path in paths if _is_exr(path)]
    except (OSError, ValueError) as error:  # a ValueError: there is a zero in the name
        refuse(error)
    if not found:
        where, hint = ("anywhere below it", "") if recursive else ("directly in it", ", or ask for --recursive")
        raise ExrError(f"{folder} holds no EXR file: give a folder with *.exr {where}{hint}")
    return found


def is_one_file(given: Input) -> bool:
    """Whether an input stands for one frame: a file, there or not, or two halves."""
    return isinstance(given, tuple) or not (_is_folder(given) or _is_pattern(given) or _is_sequence(given))


def one_job(given: Input, target: StrPath, temporal: int = 0) -> Job:
    """The job of one file or of two halves, under any name."""
    first, second = given if isinstance(given, tuple) else (given, None)
    source = Path(first)
    halves = None if second is None else (source, Path(second))
    return Job(source, Path(target), halves, find_neighbours(source, temporal) if halves is None else ())


def find_jobs(
    inputs: Iterable[Input],
    folder: StrPath,
    *,
    recursive: bool = False,
    frames: str | Iterable[int] | None = None,
    pairs: bool = False,
    temporal: int = 0,
) -> list[Job]:
    """The jobs for inputs of any kind, in their order, each frame once; results go below `folder`.

    A file goes under its own name. What is found in a folder, or by a pattern, keeps its place below that folder, or
    below the part of the pattern that is fixed. What is there under the very name given is that, whatever signs are in
    the name.

    Args:
        inputs: files; folders; patterns such as `shots/*/beauty.*.exr`, with `**` for any folders; sequences such as
            `shot.####.exr` or `shot.%04d.exr`; tuples of two files that are halves of one frame.
        recursive: look into folders in folders too.
        frames: which frames of the sequences, such as "1-240", "1-240x2" or numbers; None: those that are there. Those
            asked for that are not there become jobs that fail.
        pairs: `name.a.exr` and `name.b.exr` are halves of `name.exr`. Not guessed from the names alone, which could
            as well be two versions of a frame.
        temporal: how many frames before and after each are its neighbours.

    Raises:
        ExrError: a folder cannot be read, a folder or pattern or sequence has no files, a target would be one of the
            inputs, or that of two of them.
        ParameterError: `frames` is not understood, or given without a sequence.
    """
    inputs, folder = list(inputs), Path(folder)
    numbers = None if frames is None else parse_frames(frames)
    if numbers is not None and not any(not isinstance(given, tuple) and _is_sequence(given) for given in inputs):
        raise ParameterError("frames is given but no input is a sequence: give one such as shot.####.exr")
    found: dict[Path, _Found] = {}
    for given in inputs:
        for one in _find(given, folder, recursive, numbers):
            found.setdefault(one.path, one)
    chosen = _pair(list(found.values())) if pairs else list(found.values())
    listing: dict[Path, list[str]] = {}
    jobs = []
    for one in chosen:
        halves = None if one.second is None else (one.path, one.second)
        alone = halves is not None and not (pairs and half_of(one.path))  # two names that follow no rule
        beside = () if alone else find_neighbours(one.path, temporal, listing)
        jobs.append(Job(one.path, folder / one.place, halves, beside))
    _check(jobs)
    return jobs


def count_pairs(jobs: Sequence[Job]) -> int:
    """How many jobs look as if they were meant to be `pairs`."""
    names = {job.source for job in jobs if job.halves is None}
    return sum(half_of(path) == "a" and partner(path) in names for path in names)


def _find(given: Input, folder: Path, recursive: bool, numbers: list[int] | None) -> list[_Found]:
    if isinstance(given, tuple):
        first, second = map(Path, given)
        return [_Found(first, Path(whole_name(first)), second)]
    text = os.fspath(given)
    if _is_folder(given):
        return [_Found(path, path.relative_to(text)) for path in find_exrs(text, recursive, folder)]
    if _is_sequence(given):
        paths = find_frames(text) if numbers is None else expand(text, numbers)
        return [_Found(path, path.relative_to(_fixed(text, is_sequence))) for path in paths]
    if _is_pattern(given):
        paths = [path for path in map(Path, glob.glob(text, recursive=True)) if _is_exr(path)]  # noqa: PTH207
        if not paths:
            raise ExrError(f"{text} matches no EXR file: look at the pattern, and where it is searched from")
        return [_Found(p, p.relative_to(_fixed(text, glob.has_magic))) for p in sorted(paths, key=_natural)]
    return [_Found(Path(text), Path(Path(text).name))]


def _fixed(text: str, is_open: object) -> Path:
    """The folders at the start of a pattern in which nothing is open."""
    parts = Path(text).parts[:-1]
    until = next((i for i, part in enumerate(parts) if is_open(part)), len(parts))
    return Path(*parts[:until])


def _pair(found: list[_Found]) -> list[_Found]:
    """Two halves become one; a half whose other is missing stays, and fails when it is read."""
    result: dict[Path, _Found] = {}
    for one in found:
        half = half_of(one.path) if one.second is None else None
        if half is None:
            result[one.path] = one
            continue
        first, second = (one.path, partner(one.path)) if half == "a" else (partner(one.path), one.path)
        result.setdefault(first, _Found(first, one.place.with_name(whole_name(one.path)), second))
    return list(result.values())


def _check(jobs: Sequence[Job]) -> None:
    """Nothing that is read may be written to, and nothing may be written twice."""
    inputs = {_identity(path): path for path in {path for job in jobs for path in job.inputs}} if jobs else {}
    taken: dict[Path, Path] = {}
    for job in jobs:
        identity = _identity(job.target)
        if identity is not None and identity in inputs:
            raise ExrError(
                f"{job.target} would be written but is the input {inputs[identity]} itself: give another output folder"
            )
        if job.target in taken:
            raise ExrError(
                f"{taken[job.target]} and {job.source} would both become {job.target}: denoise them into folders of "
                "their own"
            )
        taken[job.target] = job.source


def _identity(path: Path) -> tuple[int, int] | None:
    """What two paths to one file share, links and upper or lower case aside; None where there is no file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def _is_exr(path: Path) -> bool:
    return path.suffix.lower() == ".exr" and not path.name.startswith(".") and path.is_file()


# Unlike a Path's own, those of os.path raise for no name.
def _is_folder(given: StrPath) -> bool:
    return os.path.isdir(given)  # noqa: PTH112


def _is_sequence(given: StrPath) -> bool:
    return is_sequence(os.fspath(given)) and not os.path.lexists(given)


def _is_pattern(given: StrPath) -> bool:
    return glob.has_magic(os.fspath(given)) and not os.path.lexists(given) and not is_sequence(os.fspath(given))


def _natural(path: StrPath) -> list[tuple[bool, int, str]]:
    """An order in which frame 9 comes before frame 10."""
    words = re.split(r"(\d+)", os.fspath(path))
    return [(word.isdecimal(), int(word) if word.isdecimal() else 0, word) for word in words]
