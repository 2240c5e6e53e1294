"""Whether workers and this process see the same files: a sign in the output folder, and results as written."""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from .errors import ExrError
from .exr import STAMP
from .exr_file import read_header
from .farm_worker import Answer
from .job import Job, Recipe
from .stamp import stamp


@contextlib.contextmanager
def sign_in(jobs: Sequence[Job]) -> Iterator[str]:
    """A file in the folder of all results, by which workers know it; gone at the end. "" where there are no jobs.

    Raises:
        ExrError: it cannot be made there.
    """
    if not jobs:
        yield ""
        return
    folder = Path(os.path.commonpath([os.path.abspath(job.target.parent) for job in jobs]))  # noqa: PTH100
    path = folder / f".mcdenoise-farm-{secrets.token_hex(8)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.touch(exist_ok=False)
    except OSError as error:
        raise ExrError(f"{folder} cannot be written to ({error.strerror}): give another output folder") from None
    try:
        yield str(path)
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def difference(job: Job, recipe: Recipe, answer: Answer) -> str:
    """In what a result that a worker says it has written is not what is seen here; "" where it is.

    It is there, as long as it was written, of the size and with the channels of its source, and up to date.
    """
    if answer.outcome.report is None:  # it says no such thing
        return ""
    target = job.target
    try:
        size = target.stat().st_size
        if size != answer.size:
            return f"{target} has {size} bytes, but {answer.size} were written: the storage is full or not shared"
        result, source = read_header(target), read_header(job.source)
        made, wanted = json.loads(result.get(STAMP, "null")), json.loads(stamp(job, recipe))
    except OSError as error:
        return f"{target} is not there ({error.strerror}): the folder must be the same on all machines"
    except ExrError as error:
        return str(error)
    if not np.array_equal(result["dataWindow"], source["dataWindow"]):
        return f"{target} has another size than {job.source}: do it again"
    if _channels(result) != _channels(source):
        return f"{target} has other channels than {job.source}: do it again"
    if made != wanted:
        return f"{target} was made of something else than {job.source} as it is now: do it again"
    return ""


def _channels(header: dict) -> list[str]:
    return sorted(channel.name for channel in header["channels"])
