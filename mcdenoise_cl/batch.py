"""Denoise EXR files: one, or many into a folder. Nothing of the user's is lost: inputs are never written to, existing
outputs only when asked, and a file appears under its name only when it is complete.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pyopencl as cl

from .api import Denoiser
from .choose import pick_device
from .details import Report
from .errors import DeviceError, ExrError, FrameError
from .exr import read_exr, write_exr
from .frame import Frame
from .methods import get_method, settle
from .methods.parameters import make
from .quiet import hushed

StrPath = str | os.PathLike[str]


@dataclass(frozen=True)
class Outcome:
    """What became of one file.

    Attributes:
        source, target: the file read and the file written.
        report: what the denoiser did, where it did.
        layers: plane -> the layer it was read from, of the planes the method used.
        error: why the file failed. Where there is neither report nor error it was skipped, as its target existed.
    """

    source: Path
    target: Path
    report: Report | None = None
    layers: Mapping[str, str] = field(default_factory=dict)
    error: Exception | None = None


def find_exrs(folder: StrPath) -> list[Path]:
    """Every EXR directly in a folder, sorted by name; hidden files aside.

    Raises:
        ExrError: the folder cannot be read, or has none.
    """
    try:
        files = sorted(Path(folder).iterdir())
        found = [p for p in files if p.suffix.lower() == ".exr" and not p.name.startswith(".") and p.is_file()]
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{folder} cannot be read ({reason}): give a folder of EXR files") from None
    if not found:
        raise ExrError(f"{folder} holds no EXR file: give a folder with *.exr directly in it")
    return found


def denoise_file(
    source: StrPath,
    target: StrPath,
    *,
    method: str | None = None,
    preset: str | None = None,
    device: str | int | cl.Device | None = None,
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
    overwrite: bool = False,
    max_memory_mb: int | None = None,
    **parameters: Any,
) -> Outcome:
    """Denoise the colour of one EXR file; every other layer is kept.

    Args:
        source, target: the file to read and the file to write, which must not be the same.
        method: a name of `methods()`.
        preset: "fast", "balanced" or "high" instead; "high" if neither is given.
        device: index, part of a name, or `pyopencl.Device`; None: the default device.
        layers, samples_per_pixel: as for `read_exr`.
        overwrite: write over an existing target.
        max_memory_mb: as for `Denoiser`.
        **parameters: the method's, by name.

    Raises:
        ExrError: a file cannot be read or written, or the target exists.
        FrameError: the method needs a plane that the file lacks.
        ParameterError, DeviceError: as for `Denoiser`.

    Example:
        >>> import tempfile, numpy as np
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_exr(folder + "/noisy.exr", np.ones((8, 8, 3), np.float32))
        ...     outcome = denoise_file(folder + "/noisy.exr", folder + "/clean.exr", search_radius=2)
        >>> outcome.report.method, dict(outcome.layers)
        ('auto', {'color': 'RGB'})
    """
    source, target = Path(source), Path(target)
    if _identity(target) in {_identity(source)} - {None}:
        raise ExrError(f"{target} is the input itself, which is never written to: give another output")
    check_target(target, overwrite)
    name, parameters = settle(method, preset, parameters)
    return _denoise(source, target, _Denoisers(name, device, max_memory_mb, parameters), layers, samples_per_pixel)


def denoise_files(
    sources: Iterable[StrPath],
    folder: StrPath,
    *,
    method: str | None = None,
    preset: str | None = None,
    device: str | int | cl.Device | None = None,
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
    overwrite: bool = False,
    on_progress: Callable[[Outcome], None] | None = None,
    max_memory_mb: int | None = None,
    **parameters: Any,
) -> list[Outcome]:
    """Denoise files into a folder, under their own names; one that fails does not stop the others.

    Args:
        sources: the files; `find_exrs` lists those of a folder.
        folder: made where it is missing.
        overwrite: write over existing files there; otherwise their sources are skipped.
        on_progress: called after each file.
        method, preset, device, layers, samples_per_pixel, max_memory_mb, **parameters: as for `denoise_file`, for every
            file.

    Returns:
        An outcome for each source, in order.

    Raises:
        ExrError: a target would be one of the sources or that of two of them, or the folder cannot be made.
        ParameterError: an unknown method or preset, or a parameter that the method refuses.
        DeviceError: there is no such device.
    """
    sources, folder = [Path(source) for source in sources], Path(folder)
    _check_targets(sources, folder)
    name, parameters = settle(method, preset, parameters)
    make(get_method(name).make, name, parameters)
    denoisers = _Denoisers(name, pick_device(device).device, max_memory_mb, parameters)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{folder} cannot be made ({reason}): give another output folder") from None
    outcomes = []
    for source in sources:
        target = folder / source.name
        if _exists(target) and not overwrite:
            outcome = Outcome(source, target)
        else:
            try:
                outcome = _denoise(source, target, denoisers, layers, samples_per_pixel)
            except Exception as error:
                outcome = Outcome(source, target, error=error)
        outcomes.append(outcome)
        if on_progress is not None:
            on_progress(outcome)
    return outcomes


def check_target(target: StrPath, overwrite: bool) -> None:
    """Refuse, before any work, a file that cannot or must not be written.

    Raises:
        ExrError: its folder does not exist, or the file does and `overwrite` is False.
    """
    target = Path(target)
    if os.path.isdir(target):  # noqa: PTH112 (a Path's raises for a name that is too long)
        raise ExrError(f"{target} is a folder: give the name of a file to write")
    if not os.path.isdir(target.parent):  # noqa: PTH112
        raise ExrError(f"{target} cannot be written, as there is no folder {target.parent}: make it first")
    if _exists(target) and not overwrite:
        raise ExrError(
            f"{target} exists already: give another name, or pass --force (overwrite=True in Python) to replace it"
        )


class _Denoisers:
    """Makes the `Denoiser` for a frame, and hands out the last one again where the frame has its size.

    Only the last one is kept: each holds device memory for a whole frame.
    """

    def __init__(self, method: str, device: Any, max_memory_mb: int | None, parameters: Mapping[str, Any]) -> None:
        self._options = {"method": method, "device": device, "max_memory_mb": max_memory_mb, **parameters}
        self._last: Denoiser | None = None

    def for_frame(self, frame: Frame) -> Denoiser:
        last = self._last
        if last is None or (last.height, last.width) != frame.shape:
            self._last = last = None  # its memory goes before the next one asks for its own
            self._last = Denoiser(*frame.shape, **self._options)
        return self._last

    def forget(self) -> None:
        """Make a new one for the next frame: the device of this one failed, but may be back by then."""
        self._last = None


def _denoise(
    source: Path,
    target: Path,
    denoisers: _Denoisers,
    layers: Mapping[str, str] | None,
    samples_per_pixel: int | None,
) -> Outcome:
    with hushed():
        frame = read_exr(source, layers=layers, samples_per_pixel=samples_per_pixel)
    denoiser = denoisers.for_frame(frame)
    try:
        clean, report = denoiser(frame), denoiser.report
    except FrameError as error:
        raise FrameError(f"{source}: {error}") from error
    except DeviceError:
        denoisers.forget()
        raise
    write_exr(target, clean, template=source, layers=layers)
    used = denoiser.method.takes(frame.planes())
    named = {plane: layer for plane, layer in frame.metadata["layers"].items() if plane in used}
    return Outcome(source, target, report, named)


def _check_targets(sources: list[Path], folder: Path) -> None:
    inputs = {_identity(source): source for source in sources}
    taken: dict[str, Path] = {}
    for source in sources:
        target = folder / source.name
        identity = _identity(target)
        if identity is not None and identity in inputs:
            raise ExrError(
                f"{target} would be written but is the input {inputs[identity]} itself: give another output folder"
            )
        if source.name in taken:
            raise ExrError(
                f"{taken[source.name]} and {source} would both become {target}: denoise them into folders of their own"
            )
        taken[source.name] = source


def _identity(path: Path) -> tuple[int, int] | None:
    """What two paths to one file share, links and upper or lower case aside; None where there is no file."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def _exists(path: Path) -> bool:
    """Unlike a Path's own, this raises for no name and no permission: writing or reading then says what is wrong."""
    return os.path.exists(path)  # noqa: PTH110
