"""PoCL's cache of kernels on disk, looked at before PoCL does: where a file in it is damaged or the disk is full, PoCL
ends the process, and where it cannot write there, it has no device.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import struct
import tempfile
from functools import cache
from pathlib import Path

from .errors import DeviceError

VARIABLE = "POCL_CACHE_DIR"
#: Bytes that the kernels of one method may take, with what the linker needs beside them.
ROOM = 32 * 2**20
#: Programs that are looked at, the last used first. A method has about thirty; the cache of a machine that compiles
#: much holds thousands, which would take seconds.
LOOKED_AT = 64


def folder() -> Path | None:
    """Where PoCL keeps its cache, as its documentation says; None where it has no home to keep it in."""
    if os.environ.get(VARIABLE):
        return Path(os.environ[VARIABLE])
    for variable, below in (("XDG_CACHE_HOME", "pocl/kcache"), ("HOME", ".cache/pocl/kcache")):
        if os.environ.get(variable):
            return Path(os.environ[variable]) / below
    return None


@cache
def prepare() -> None:
    """Before PoCL is asked for devices: where it cannot write to its own folder, give it a temporary one."""
    if _has_room(folder()):
        return
    with contextlib.suppress(OSError):
        other = tempfile.mkdtemp(prefix="mcdenoise-pocl-")
        atexit.register(shutil.rmtree, other, ignore_errors=True)
        os.environ[VARIABLE] = other


def check_room() -> None:
    """Before PoCL is used.

    Raises:
        DeviceError: neither its own folder nor a temporary one has room.
    """
    if not _has_room(folder()):
        raise DeviceError(
            f"PoCL keeps the kernels it builds in {folder()}, where it cannot write or less than {ROOM >> 20} MiB are "
            f"free: make room there, or set {VARIABLE} to another folder"
        )


def _has_room(place: Path | None) -> bool:
    if place is None:
        return False
    try:
        place.mkdir(parents=True, exist_ok=True)
        return os.access(place, os.W_OK | os.X_OK) and shutil.disk_usage(place).free >= ROOM
    except OSError:
        return False


@cache
def mend() -> None:
    """Delete, once a process and before PoCL loads any, the kernels and programs that were cut short or overwritten.

    PoCL renames a file to its place when it is whole, so none of them is being written.
    """
    place = folder()
    if place is None:
        return
    programs = sorted(place.glob("*/*/"), key=_last_use, reverse=True)
    for program in programs[:LOOKED_AT]:
        for file in (program / "program.bc", *program.glob("*/*/*.so")):
            with contextlib.suppress(OSError):
                if not (is_whole_bitcode(file) if file.suffix == ".bc" else is_whole_elf(file)):
                    file.unlink()


def _last_use(program: Path) -> float:
    try:
        return (program / "last_accessed").stat().st_mtime
    except OSError:
        return 0.0


def is_whole_elf(path: Path) -> bool:
    """Whether a shared object begins as one and is as long as its header says: the table of sections comes last.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head, size = file.read(64), os.fstat(file.fileno()).st_size
    if len(head) < 64 or head[:4] != b"\x7fELF":
        return False
    if head[4:6] != b"\x02\x01":  # of 32 bits or big-endian, where the header is laid out otherwise
        return True
    start, width, count = *struct.unpack_from("<Q", head, 40), *struct.unpack_from("<HH", head, 58)
    return start + width * count <= size


def is_whole_bitcode(path: Path) -> bool:
    """Whether LLVM bitcode begins as such and its blocks, each of which tells its length, end where the file does.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(4) != b"BC\xc0\xde":
            return False
        at = 4
        while at < size:
            file.seek(at + 4)
            words = file.read(4)
            if len(words) < 4:
                return False
            at += 8 + 4 * int.from_bytes(words, "little")
    return at == size > 4
