"""Which results are up to date: each carries a stamp, a header attribute that says what it was made of and how."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import __version__
from .errors import ExrError
from .exr import STAMP
from .exr_file import read_header

if TYPE_CHECKING:
    from .job import Job, Recipe


#: The reason of the verdict on a target that was made of these inputs in this way.
UP_TO_DATE = "up to date"


@dataclass(frozen=True)
class Verdict:
    """Whether a job is to be done, and why or why not."""

    needed: bool
    reason: str


def stamp(job: Job, recipe: Recipe) -> str:
    """What the result of a job depends on, as JSON: inputs by name, size and time, the recipe, the version.

    The source is named as seen from the folder of the target: a whole project can be moved, or be seen from another
    machine under another name, and nothing of the layout of disks is given away.

    Raises:
        ExrError: an input cannot be read.
    """
    return json.dumps(_facts(job, recipe), sort_keys=True)


def _facts(job: Job, recipe: Recipe) -> dict[str, Any]:
    facts = {
        "version": __version__,
        "source": _seen_from(job.source, job.target.parent),
        "inputs": [_state(path) for path in (job.inputs if recipe.temporal else job.inputs[: 2 if job.halves else 1])],
        "method": recipe.method,
        "parameters": dict(recipe.parameters),
        "layers": dict(recipe.layers),
        "samples_per_pixel": recipe.samples_per_pixel,
    }
    # Only where they are used, so that a new option does not make old results out of date.
    if recipe.also:
        facts["also"] = recipe.also if isinstance(recipe.also, str) else list(recipe.also)
    if recipe.temporal:
        facts["temporal"] = recipe.temporal
    return facts


def _seen_from(path: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return str(path)


def _state(path: Path) -> list[Any]:
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{path} cannot be read ({reason}): give the path of an EXR file that can be") from None
    return [path.name, status.st_size, status.st_mtime_ns]


def read_stamp(path: Path) -> Mapping[str, Any] | None:
    """The stamp of a file; None where there is none, which includes any file that is not an EXR that can be read."""
    try:
        facts = json.loads(read_header(path)[STAMP])
    except (ExrError, KeyError, TypeError, ValueError):
        return None
    return facts if isinstance(facts, dict) else None


def judge(job: Job, recipe: Recipe, overwrite: bool = False) -> Verdict:
    """Whether a job is to be done.

    A target that is not there is made. One that was made of this source is made again where the source, the recipe or
    the version has changed since. Anything else is somebody's work and stays, unless `overwrite`.

    Raises:
        ExrError: an input cannot be read.
    """
    wanted = json.loads(stamp(job, recipe))
    if not os.path.lexists(job.target):
        return Verdict(True, "new")
    if overwrite:
        return Verdict(True, "overwritten as asked")
    found = read_stamp(job.target)
    if found is not None and _but_source(found) == _but_source(wanted):
        return Verdict(False, UP_TO_DATE)
    if found is None:
        return Verdict(False, "the output exists and is not mcdenoise's: --force (overwrite=True) replaces it")
    if found.get("source") != wanted["source"]:
        return Verdict(False, f"the output was made from {found.get('source')}: --force (overwrite=True) replaces it")
    return Verdict(True, _difference(found, wanted))


def _but_source(facts: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in facts.items() if key != "source"}


def _difference(found: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """In words, the first thing that has changed."""
    for key in ("temporal", "inputs", "method", "parameters", "layers", "samples_per_pixel", "also", "version"):
        old, new = found.get(key), wanted.get(key)
        if old == new:
            continue
        if key == "inputs":
            return "the input has changed"
        if isinstance(old, dict) and isinstance(new, dict):
            key = next(name for name in sorted({*old, *new}) if old.get(name) != new.get(name))
            old, new = old.get(key), new.get(key)
        return f"{key} was {_word(old)} and is {_word(new)}"
    return "it was made otherwise"


def _word(value: Any) -> str:
    return "not set" if value is None else ", ".join(value) if isinstance(value, list) else str(value)
