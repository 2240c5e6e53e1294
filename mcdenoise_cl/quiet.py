"""Native libraries that write to the terminal where our own errors say it in one sentence."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Keep a library quiet: OpenEXR tells of a damaged file in dozens of lines, Dr.Jit of an LLVM that is not there.

    The streams belong to the whole process, so this does nothing where another thread could be writing.
    """
    if threading.active_count() > 1 or sys.stderr is None:
        yield
        return
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(io.StringIO()):
        kept = os.dup(2)  # its C core knows nothing of sys.stderr
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


@contextlib.contextmanager
def quiet_libraries() -> Iterator[None]:
    """Keep native libraries quiet in all threads, for a command that has the process to itself.

    What Python writes to stderr still gets there; of stdout whoever needs it keeps hold before.
    """
    with contextlib.redirect_stdout(io.StringIO()), _quiet_stderr():
        yield


@contextlib.contextmanager
def _quiet_stderr() -> Iterator[None]:
    try:
        ours = sys.stderr is not None and sys.stderr.fileno() == 2
    except (OSError, ValueError):
        ours = False
    if not ours:  # somebody else's, as under a test
        yield
        return
    sys.stderr.flush()
    before, kept = sys.stderr, os.dup(2)
    with Path(os.devnull).open("w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
    sys.stderr = os.fdopen(os.dup(kept), "w", encoding=before.encoding, errors=before.errors, buffering=1)
    try:
        yield
    finally:
        sys.stderr.close()
        sys.stderr = before
        os.dup2(kept, 2)
        os.close(kept)
