"""OpenCL programs: found in the package or the checkout, built once, with errors that can be acted on.

Sources are handed to the compiler whole, headers pasted in, so that every cache below (this process's, ours on disk,
the driver's own) is keyed by everything that went into the build: a changed file is never served stale.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
import sqlite3
import threading
import warnings
from functools import cache
from pathlib import Path

import platformdirs
import pyopencl as cl
from pyopencl.characterize import has_src_build_cache

from . import pocl_cache
from .errors import DeviceError
from .measured import folder as cache_folder
from .measured import put

_INCLUDE = re.compile(r'^#include "([^"]+)"$', re.MULTILINE)
_programs: dict[tuple, cl.Program] = {}
_lock = threading.Lock()


@cache
def kernel_folder() -> Path:
    """Where the `.cl` files are: inside an installed package, or beside the package in a checkout."""
    package = Path(__file__).resolve().parent
    for folder in (package / "kernels", package.parent / "kernels"):
        if (folder / "common.h").is_file():
            return folder
    raise DeviceError(f"the kernels are missing from {package}: reinstall mcdenoise-cl")


def source(file: str, folder: Path | None = None) -> str:
    """The text of a kernel file with its headers pasted in, each once."""
    folder = folder or kernel_folder()
    seen: set[str] = set()

    def paste(name: str) -> str:
        if name in seen:
            return ""
        seen.add(name)
        return _INCLUDE.sub(lambda match: paste(match[1]), (folder / name).read_text(encoding="utf-8"))

    return paste(file)


def build(context: cl.Context, file: str, defines: dict[str, int | None], folder: Path | None = None) -> cl.Program:
    """Build a kernel file for the one device of a context; the same text and defines are built once a process.

    Raises:
        DeviceError: the compiler refused it; the message holds the device, the options and the build log.
    """
    text = source(file, folder)
    options = [f"-D{name}" if value is None else f"-D{name}={value}" for name, value in sorted(defines.items())]
    options.insert(0, "-cl-std=CL1.2")
    key = (context, text, tuple(options))
    with _lock:
        if key not in _programs:
            with warnings.catch_warnings():
                # PyOpenCL warns of any compiler chatter; what matters comes as an error.
                warnings.simplefilter("ignore", cl.CompilerWarning)
                try:
                    _programs[key] = _build(context, text, options)
                except cl.RuntimeError as error:
                    device = context.devices[0]
                    raise DeviceError(
                        f"kernel file {file} does not build on {device.name.strip()} ({device.platform.name.strip()}, "
                        f"{device.version.strip()}) with options {' '.join(options)}; the build log says:\n{error}"
                    ) from error
        return _programs[key]


def _build(context: cl.Context, text: str, options: list[str]) -> cl.Program:
    """From the source where the driver keeps what it built, else from what we kept of an earlier build.

    PyOpenCL has a cache too, but a process that is killed while it writes there leaves a lock, for which every later
    one waits a minute before it fails.
    """
    device, *others = context.devices
    if "PoCL" in device.version:
        pocl_cache.mend()
    if others or has_src_build_cache(device):
        return cl.Program(context, text).build(options, cache_dir=False)
    facts = (device.platform.name, device.platform.version, device.name, device.version, device.driver_version)
    digest = hashlib.sha256("\0".join((*facts, *options, text)).encode()).hexdigest()
    path = cache_folder() / f"program-{digest[:32]}.bin"
    with contextlib.suppress(OSError, cl.Error):
        kept = path.read_bytes()
        if hashlib.sha256(kept[32:]).digest() == kept[:32]:
            program = cl.Program(context, [device], [kept[32:]])
            program._source = text  # PyOpenCL looks for it, and else asks the driver for a kernel of that name
            return program.build(options)
    program = cl.Program(context, text).build(options, cache_dir=False)
    [binary] = program.get_info(cl.program_info.BINARIES)
    put(path, hashlib.sha256(binary).digest() + binary)
    return program


def make_kernel(program: cl.Program, name: str) -> cl.Kernel:
    """A kernel of a program, even where the database in which PyOpenCL keeps how to call kernels is of no use.

    Such a database is deleted if it is damaged, and left alone if it cannot be read or written; this process then does
    without.
    """
    _check_database_folder()
    try:
        return cl.Kernel(program, name)
    except cl.Error:
        raise
    except Exception as error:  # of SQLite, of the file system, or of what unpickles an entry
        if getattr(cl, "_PYOPENCL_NO_CACHE", True):
            raise
        cl._PYOPENCL_NO_CACHE = True
        if not isinstance(error, OSError | sqlite3.OperationalError):
            for database in _database_folder().glob("*pyopencl-invoker-cache*"):
                with contextlib.suppress(OSError):
                    database.unlink()
        return cl.Kernel(program, name)


def _database_folder() -> Path:
    return Path(platformdirs.user_cache_dir("pytools", "pytools"))


@cache
def _check_database_folder() -> None:
    """PyOpenCL would not only fail without a folder for its database, but also say so on stderr."""
    try:
        _database_folder().mkdir(parents=True, exist_ok=True)
    except OSError:
        cl._PYOPENCL_NO_CACHE = True
