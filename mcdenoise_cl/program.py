"""OpenCL programs: found in the package or the checkout, built once, with errors that can be acted on.

Sources are handed to the compiler whole, headers pasted in, so that every cache below (this process's, PyOpenCL's
on disk, the driver's own) is keyed by everything that went into the build: a changed file is never served stale.
"""

from __future__ import annotations

import re
import threading
import warnings
from functools import cache
from pathlib import Path

import pyopencl as cl

from .errors import DeviceError

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
                    _programs[key] = cl.Program(context, text).build(options)
                except cl.RuntimeError as error:
                    device = context.devices[0]
                    raise DeviceError(
                        f"kernel file {file} does not build on {device.name.strip()} ({device.platform.name.strip()}, "
                        f"{device.version.strip()}) with options {' '.join(options)}; the build log says:\n{error}"
                    ) from error
        return _programs[key]
