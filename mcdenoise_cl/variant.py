"""Which Mitsuba variant runs on this machine: LLVM where a library suits it, else plain C++."""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

from .errors import RenderError
from .quiet import hushed

PROBE = """
import sys, mitsuba as mi
mi.set_variant(sys.argv[1])
film = {"type": "hdrfilm", "width": 4, "height": 4}
camera = {"type": "perspective", "film": film}
scene = {"type": "scene", "integrator": {"type": "path"}, "camera": camera, "sphere": {"type": "sphere"}}
mi.render(mi.load_dict(scene | {"sky": {"type": "constant"}}), spp=1).numpy()
print(sys.modules["drjit"].detail.llvm_version())
"""


def pick_variant(variant: str | None = None) -> str:
    """The Mitsuba variant to render with.

    Args:
        variant: one of Mitsuba's RGB variants, which is tried; None picks `llvm_ad_rgb` where LLVM works and else
            `scalar_rgb`. For LLVM the library that Dr.Jit finds by itself is tried first, then others in the usual
            folders; what works is remembered in `DRJIT_LIBLLVM_PATH`, the only way to tell Dr.Jit.

    Raises:
        RenderError: Mitsuba is missing, or `variant` is unknown or does not work here.
    """
    mi = import_mitsuba()
    known = [name for name in mi.variants() if name.endswith("_rgb")]
    if variant is None:
        return "llvm_ad_rgb" if "llvm_ad_rgb" in known and _llvm_works() else "scalar_rgb"
    if variant not in known:
        raise RenderError(
            f"variant is {variant!r} but this Mitsuba renders RGB with {', '.join(known)}: pass one of these"
        )
    if variant.startswith("llvm") and not _llvm_works():
        raise RenderError(
            f"variant is {variant!r} but no LLVM library that works was found: install LLVM 16 or newer, "
            "set DRJIT_LIBLLVM_PATH to its libLLVM, or use 'scalar_rgb'"
        )
    if variant.startswith("cuda") and _probe(variant, None) is None:
        raise RenderError(
            f"variant is {variant!r} but it does not run on this machine: use 'scalar_rgb' or leave it out"
        )
    return variant


def import_mitsuba() -> Any:
    """Mitsuba, imported only after Dr.Jit was shown an LLVM that works."""
    missing = "rendering needs Mitsuba, which {}: pip install 'mcdenoise-cl[render]'"
    if importlib.util.find_spec("mitsuba") is None:
        raise RenderError(missing.format("is not installed"))
    _llvm_works()
    try:
        with hushed():  # without any LLVM the import says so, and scalar variants do not care
            return importlib.import_module("mitsuba")
    except ImportError as error:
        raise RenderError(missing.format(f"cannot be imported ({error})")) from error


@cache
def _llvm_works() -> bool:
    """Whether `llvm_ad_rgb` runs, after pointing Dr.Jit at a library that suits it.

    Dr.Jit loads LLVM when it is imported, and ends the process when it later compiles with one that does not suit it.
    So this is asked before the import, in a process of its own; after an import it is too late to choose.
    """
    imported = sys.modules.get("drjit")
    libraries = [None, *_llvm_libraries()]
    if imported or "DRJIT_LIBLLVM_PATH" in os.environ:
        libraries = [None]
    for library in libraries:
        version = _probe("llvm_ad_rgb", library)
        if version is not None:
            if library is not None:
                os.environ["DRJIT_LIBLLVM_PATH"] = library
            return not imported or version == str(imported.detail.llvm_version())
    return False


def _llvm_libraries() -> list[str]:
    """LLVM libraries in the usual folders, newest first; those whose name says they are older than 16 left out."""
    folders = (
        "/usr/lib/*-linux-gnu",
        "/usr/lib64",
        "/usr/lib/llvm*/lib",
        "/usr/local/lib",
        "/opt/homebrew/opt/llvm*/lib",
    )
    found = {}
    for pattern in (*folders, f"{sys.prefix}/lib"):
        for path in Path("/").glob(f"{pattern}/libLLVM*".lstrip("/")):
            version = re.fullmatch(r"libLLVM(?:(?:-|\.so\.|\.)(\d+).*?)?(?:\.so.*|\.dylib)?", path.name)
            if version:
                found.setdefault(path.resolve(), int(version[1] or 0))
    recent = [path for path, version in found.items() if not 0 < version < 16]
    return [str(path) for path in sorted(recent, key=lambda path: -found[path])]


def _probe(variant: str, library: str | None) -> str | None:
    """Render a few pixels in another process: the LLVM version that did it, or None."""
    environment = os.environ | ({} if library is None else {"DRJIT_LIBLLVM_PATH": library})
    command = [sys.executable, "-c", PROBE, variant]
    try:
        result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() if result.returncode == 0 else None
