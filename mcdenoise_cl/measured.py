"""What was measured once on this machine and is kept in the user's cache folder."""

from __future__ import annotations

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
    path = _path(key)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
            json.dump(value, file)
        Path(file.name).replace(path)
    except OSError:
        return False
    return True


def forget(key: str) -> None:
    """Remember nothing under this key."""
    _path(key).unlink(missing_ok=True)


def folder() -> Path:
    """Where it is kept."""
    return Path(platformdirs.user_cache_dir("mcdenoise-cl"))


def _path(key: str) -> Path:
    return folder() / f"measured-{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
