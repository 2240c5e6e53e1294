"""Files that are not finished: under names of their own beside the final ones, and swept up if their process died."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import secrets
import socket
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

_NAME = re.compile(r"\.mcdenoise-(?P<space>[0-9a-f]{12})-(?P<pid>\d+)-[0-9a-f]{16}\.tmp")
#: Seconds after which an unfinished file is given up whose process cannot be asked for, being on another machine.
OLD = 24 * 3600
_writing: set[str] = set()


@contextlib.contextmanager
def unfinished(final: Path) -> Iterator[Path]:
    """A new empty file beside the final one, which takes its name at the end, or is gone after a failure.

    It is never made over an existing file, and has the permissions of any new file. It is on the disk before it takes
    its name, so that a power cut leaves none cut short, and what a network's disk has no room for is an error here.
    """
    path = final.with_name(f".mcdenoise-{_space()}-{os.getpid()}-{secrets.token_hex(8)}.tmp")
    _writing.add(path.name)
    try:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        try:
            yield path
            _put_on_disk(path)
            path.replace(final)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
    finally:
        _writing.discard(path.name)


def _put_on_disk(path: Path) -> None:
    file = os.open(path, os.O_RDWR)
    try:
        os.fsync(file)
    finally:
        os.close(file)


def sweep(folder: str | os.PathLike[str]) -> None:
    """Delete what processes that were killed have left unfinished in a folder. One that cannot be read is left alone.

    Of other machines, which may share the folder, only files that nobody has written to for a day.
    """
    with contextlib.suppress(OSError, ValueError), os.scandir(folder) as entries:
        for entry in entries:
            match = _NAME.fullmatch(entry.name)
            if match and _is_stale(entry, match["space"], int(match["pid"])):
                with contextlib.suppress(OSError):
                    Path(entry.path).unlink()


def _is_stale(entry: os.DirEntry[str], space: str, pid: int) -> bool:
    if space == _space() and os.name == "posix":
        return entry.name not in _writing if pid == os.getpid() else not _is_alive(pid)
    with contextlib.suppress(OSError):
        return time.time() - entry.stat(follow_symlinks=False).st_mtime > OLD
    return False


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True


@cache
def _space() -> str:
    """Where a process number means a process: the machine, since it was started, and the container."""
    facts = [socket.gethostname()]
    with contextlib.suppress(OSError):
        facts.append(Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii"))
    with contextlib.suppress(OSError):
        facts.append(str(Path("/proc/self/ns/pid").readlink()))
    return hashlib.sha256("\0".join(facts).encode()).hexdigest()[:12]
