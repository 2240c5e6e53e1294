"""What the workers of a farm run: a look at what they are and can do, and one frame. Needs nothing of Dask."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import platform
import secrets
import signal
import socket
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__
from .choose import pick_devices
from .device import context_for
from .errors import ExrError, McdenoiseError
from .job import Job, Outcome, Recipe, portable, run_job
from .program import kernel_folder
from .temporary import sweep

#: Environment variables that show a process only some of a machine's GPUs, so that number 0 is another one to each.
MASKS = (
    "CUDA_VISIBLE_DEVICES",
    "ROCR_VISIBLE_DEVICES",
    "HIP_VISIBLE_DEVICES",
    "GPU_DEVICE_ORDINAL",
    "ZE_AFFINITY_MASK",
)


class UnseenError(ExrError):
    """A worker does not see an input."""


@dataclass(frozen=True)
class Found:
    """A device that a worker may use.

    Attributes:
        index: its number there, as `device=` takes it.
        name: device and runtime.
        key: the same for two processes that mean the same device of the same machine.
    """

    index: int
    name: str
    key: tuple[Any, ...]


@dataclass(frozen=True)
class Look:
    """What a worker says of itself.

    Attributes:
        host: the name of its machine.
        devices: those it may use.
        problem: why it cannot be used; "" where it can.
    """

    host: str
    devices: tuple[Found, ...] = ()
    problem: str = ""


@dataclass(frozen=True)
class Answer:
    """What a worker says of a frame: what became of it, and how many bytes the file has that it wrote or found."""

    outcome: Outcome
    size: int | None = None


@cache
def versions() -> tuple[tuple[str, str], ...]:
    """Of what decides about results, and whether two machines understand each other.

    The code counts by its content too: clones of one repository may share a version and not be the same.
    """
    package, content = Path(__file__).parent, hashlib.sha256()
    for folder in (package, kernel_folder()):
        for path in sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".cl", ".h")):
            content.update(path.relative_to(folder).as_posix().encode())
            content.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return (
        ("mcdenoise_cl", __version__),
        ("code of mcdenoise_cl", content.hexdigest()[:8]),
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        ("NumPy", np.__version__),
        ("dask.distributed", metadata.version("distributed")),
    )


def look(choice: Any, sign: str, sources: Sequence[str]) -> Look:
    """Whether this process can do frames.

    Args:
        choice: as for `pick_devices`.
        sign: a file that the client has just made in the output folder.
        sources: files that the client sees.
    """
    host, found = socket.gethostname(), ()
    try:
        for path in map(Path, sources):
            if not path.is_file():
                raise UnseenError(_unseen(path))
        _check_folder(Path(sign))
        devices = pick_devices(choice)
        for info in devices:
            context_for(info.device)
        masks = tuple(os.environ.get(name) for name in MASKS)
        found = tuple(
            Found(info.index, f"{info.name} ({info.runtime})", (host, info.index, info.name, masks)) for info in devices
        )
    except McdenoiseError as error:
        return Look(host, problem=str(error))
    return Look(host, found)


def _check_folder(sign: Path) -> None:
    """Whether this is the client's output folder and can be written to. What killed workers left there goes."""
    if not sign.is_file():
        raise ExrError(
            f"it does not see {sign.parent} as the client does: mount the shared storage there under the same path"
        )
    sweep(sign.parent)
    mine = sign.with_name(f"{sign.name}-{secrets.token_hex(8)}")
    try:
        mine.touch(exist_ok=False)
        mine.unlink()
    except OSError as error:
        raise ExrError(
            f"it cannot write to {sign.parent} ({error.strerror}): start it as a user who can, or make room"
        ) from None


def _unseen(path: Path) -> str:
    return (
        f"{path} is not seen by {socket.gethostname()}: every worker needs the shared storage mounted under the same "
        "path"
    )


_changed = threading.Condition()
_running: Counter[str] = Counter()
_ended: set[str] = set()


def do(run: str, job: Job, recipe: Recipe, device: int, overwrite: bool, again: bool) -> Answer:
    """One frame, unless the run has been ended.

    Args:
        run: which run it belongs to.
        device: the number of a device here.
        again: whether it may have been begun before, by a worker that was lost.
    """
    with _changed:
        if run in _ended:
            return Answer(Outcome(job.source, job.target, reason="the run was ended"))
        _running[run] += 1
    try:
        return _do(job, recipe, device, overwrite, again)
    except Exception as error:
        return Answer(Outcome(job.source, job.target, error=portable(error)))
    finally:
        with _changed:
            _running[run] -= 1
            if not _running[run]:
                del _running[run]
            _changed.notify_all()


def _do(job: Job, recipe: Recipe, device: int, overwrite: bool, again: bool) -> Answer:
    missing = next((path for path in (job.halves or (job.source,)) if not os.path.lexists(path)), None)
    if missing is not None:
        return Answer(Outcome(job.source, job.target, error=UnseenError(_unseen(missing))))
    if again:
        sweep(job.target.parent)
    outcome = run_job(job, recipe, device=device, overwrite=overwrite)
    if outcome.error is not None:
        return Answer(replace(outcome, error=named(outcome.error, socket.gethostname())))
    size = None
    with contextlib.suppress(OSError):
        size = job.target.stat().st_size
    return Answer(outcome, size)


def named(error: Exception, place: str) -> Exception:
    """An error of ours that says where it happened; others as they are."""
    return type(error)(f"{error} (on {place})") if isinstance(error, McdenoiseError) else error


def dask_setup(_: Any) -> None:
    """Called by Dask in the workers of a cluster of our own: Ctrl-C reaches them too, but is for the client to obey."""
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)


async def end(run: str) -> None:
    """Begin no more frames of a run, and wait for those that are being done."""
    _ended.add(run)

    def wait() -> None:
        with _changed:
            while _running[run]:
                _changed.wait()
            del _running[run]

    await asyncio.get_running_loop().run_in_executor(None, wait)
