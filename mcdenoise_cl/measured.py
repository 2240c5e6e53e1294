"""What was found out once on this machine and is kept in the user's cache folder."""

from __future__ import annotations

import contextlib
import hashlib
import json
import tempfile
from pathlib import Path
from typing import Any

import platformdirs


def recall(key: str) -> Any:
    """What was remembered under this key; None if nothing was, or it cannot be read."""
    try:
        return json.loads(_path(key).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def remember(key: str, value: Any) -> bool:
    """Keep a JSON value for later runs, in one step; False where the cache cannot be written (a read-only home)."""
    return put(_path(key), json.dumps(value).encode())


def put(path: Path, data: bytes) -> bool:
    """Make a file of the cache appear whole, or not at all: False where it cannot be written."""
    part = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("wb", dir=path.parent, prefix="part-", delete=False) as file:
            part = Path(file.name)
            file.write(data)
        part.replace(path)
    except OSError:
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()
        return False
    return True


def forget(key: str) -> None:
    """Remember nothing under this key."""
    with contextlib.suppress(OSError):  # there is nothing, or it stays where nothing can be changed
        _path(key).unlink()


def folder() -> Path:
    """Where it is kept."""
    return Path(platformdirs.user_cache_dir("mcdenoise-cl"))


def _path(key: str) -> Path:
    return folder() / f"measured-{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
