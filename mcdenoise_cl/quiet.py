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
