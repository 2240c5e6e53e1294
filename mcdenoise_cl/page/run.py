"""From EXR files to a page: read, denoise where no clean images are given, and write."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..api import Denoiser
from ..batch import check_target
from ..details import Denoised
from ..errors import ExrError, FrameError
from ..exr import read_exr
from ..frame import Frame
from ..methods import PRESETS
from ..quiet import hushed
from .content import FEATURES, INPUT, REFERENCE, Entry
from .write import Page, write_page

StrPath = str | os.PathLike[str]
#: A method is timed until it has run so often or so long, seconds.
RUNS, LONG = 3, 4.0


def report_files(
    noisy: StrPath,
    target: StrPath,
    *,
    clean: Sequence[StrPath] = (),
    reference: StrPath | None = None,
    methods: Sequence[str] = (),
    presets: Sequence[str] = (),
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
    device: Any = None,
    title: str | None = None,
    max_mb: float | None = None,
    overwrite: bool = False,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Page:
    """Write a page that compares a noisy EXR file with clean ones.

    Args:
        noisy: the file with the noisy frame.
        target: the HTML file to write.
        clean: files with results of it, from whatever denoiser.
        reference: a file with the truth.
        methods, presets: what to denoise the frame with; where there is neither one of them nor a clean file, all
            presets.
        layers, samples_per_pixel: as for `read_exr`, of the noisy file.
        device: index, part of a name, or `pyopencl.Device`; None: the default device.
        title: of the page; None: the name of the noisy file.
        max_mb: as for `make_page`.
        overwrite: write over an existing target.
        on_progress: called with the name of what is being done, and how much of how much is done.

    Raises:
        ExrError: a file cannot be read, the target cannot be written, exists or is one of the files.
        FrameError: sizes differ, or a method needs a plane that the noisy file lacks.
        ParameterError, DeviceError: as for `Denoiser` and `make_page`.
    """
    noisy, target, clean = Path(noisy), Path(target), [Path(path) for path in clean]
    sources = [noisy, *clean, *([] if reference is None else [Path(reference)])]
    _check(target, sources, overwrite)
    progress = on_progress or (lambda stage, done, total: None)
    frames = {}
    for path in sources:
        frames[path] = _read(path, layers, samples_per_pixel) if path == noisy else _read(path)
        if frames[path].shape != frames[noisy].shape:
            theirs, ours = (" x ".join(map(str, frames[p].shape[::-1])) for p in (path, noisy))
            raise FrameError(f"{path} is {theirs} pixels but {noisy} is {ours}: pass images of one size")

    names = _names(clean)
    results = {name: Entry(frames[path].color) for name, path in names.items()}
    wanted = {name: {"method": name} for name in methods} | {name: {"preset": name} for name in presets}
    if not clean and not wanted:
        wanted = {name: {"preset": name} for name in PRESETS}
    for number, (name, choice) in enumerate(wanted.items()):
        progress("denoising", number, len(wanted))
        denoiser = Denoiser(*frames[noisy].shape, device=device, **choice)
        image, seconds = timed(denoiser, frames[noisy])
        details = Denoised(image, denoiser.model_map, denoiser.error_map, denoiser.report)
        results[name if name not in results else f"{name}, made here"] = Entry(image, seconds, details)
    if wanted:
        progress("denoising", len(wanted), len(wanted))

    about = {INPUT: str(noisy)} | {name: str(path) for name, path in names.items() if name != path.name}
    if reference is not None:
        about[REFERENCE] = str(reference)
    truth = None if reference is None else frames[Path(reference)]
    return write_page(
        target,
        frames[noisy],
        results,
        reference=truth,
        title=noisy.name if title is None else title,
        about=about,
        max_mb=max_mb,
        on_progress=progress,
    )


def timed(denoiser: Denoiser, frame: Frame) -> tuple[np.ndarray, float]:
    """The image, and the median seconds of up to three runs after one that builds the kernels."""
    image = denoiser(frame)
    seconds: list[float] = []
    while len(seconds) < RUNS and sum(seconds) < LONG:
        start = time.perf_counter()
        denoiser(frame, out=image)
        seconds.append(time.perf_counter() - start)
    return image, statistics.median(seconds)


def _check(target: Path, sources: Sequence[Path], overwrite: bool) -> None:
    """Before any work."""
    if target.suffix.lower() not in (".html", ".htm"):
        raise ExrError(f"{target} is no name of a page: give one that ends with .html")
    check_target(target, overwrite)
    for path in sources:
        if target.exists() and path.exists() and target.samefile(path):
            raise ExrError(f"{target} is one of the inputs, which are never written to: give another output")


def _read(path: Path, layers: Mapping[str, str] | None = None, samples: int | None = None) -> Frame:
    with hushed():
        return read_exr(path, layers=layers, samples_per_pixel=samples)


def _names(paths: Sequence[Path]) -> dict[str, Path]:
    """The shortest names that tell files apart, other than those that the page uses itself."""
    names: dict[str, Path] = {}
    stems = [path.stem for path in paths]
    for path in paths:
        options = [path.stem] if stems.count(path.stem) == 1 else []
        options += [path.name, str(path)]
        taken = {INPUT, REFERENCE, *FEATURES, *names}
        free = [option for option in options if option not in taken]
        name = free[0] if free else f"{path} ({len(names) + 1})"
        names[name] = path
    return names
