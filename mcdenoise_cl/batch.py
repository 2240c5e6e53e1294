"""Denoise EXR files: one, or many into a folder. Nothing of the user's is lost: inputs are never written to, existing
outputs only when asked or out of date, and a file appears under its name only when it is complete.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import pyopencl as cl

from .choose import pick_devices
from .errors import ExrError
from .job import Job, Outcome, Recipe, run_job
from .pipeline import run_jobs
from .selection import Input, StrPath, find_exrs, find_jobs, one_job
from .stamp import UP_TO_DATE, Verdict, judge
from .temporary import sweep

__all__ = [
    "Outcome",
    "check_job",
    "check_target",
    "denoise_file",
    "denoise_files",
    "do",
    "find_exrs",
    "plan",
    "prepare",
]


def denoise_file(
    source: Input,
    target: StrPath,
    *,
    method: str | None = None,
    preset: str | None = None,
    device: str | int | cl.Device | None = None,
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
    overwrite: bool = False,
    max_memory_mb: int | None = None,
    also: Sequence[str] | Literal["auto"] = (),
    temporal: int = 0,
    **parameters: Any,
) -> Outcome:
    """Denoise the colour of one EXR file; every other layer is kept.

    Args:
        source, target: the file to read and the file to write, which must not be the same. A tuple of two files to
            read: two renderings of the frame with different seeds; other layers are those of the first.
        method: a name of `methods()`.
        preset: "fast", "balanced" or "high" instead; "high" if neither is given.
        device: index, part of a name, or `pyopencl.Device`; None: the default device.
        layers, samples_per_pixel: as for `read_exr`.
        overwrite: write over an existing target. Without it the target is refused, unless it was made of this very
            file in this very way: then there is nothing to do.
        max_memory_mb: as for `Denoiser`.
        also, temporal: as for `denoise_files`.
        **parameters: the method's, by name.

    Raises:
        ExrError: a file cannot be read or written, or the target exists.
        FrameError: the method needs a plane that the file lacks.
        ParameterError, DeviceError: as for `Denoiser`.

    Example:
        >>> import tempfile, numpy as np
        >>> from mcdenoise_cl import write_exr
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_exr(folder + "/noisy.exr", np.ones((8, 8, 3), np.float32))
        ...     outcome = denoise_file(folder + "/noisy.exr", folder + "/clean.exr", search_radius=2)
        >>> outcome.report.method, dict(outcome.layers)
        ('auto', {'color': 'RGB'})
    """
    recipe = Recipe.of(
        method,
        preset,
        layers=layers,
        samples_per_pixel=samples_per_pixel,
        max_memory_mb=max_memory_mb,
        also=also,
        temporal=temporal,
        **parameters,
    )
    job = one_job(source, target, temporal)
    check_job(job, recipe, overwrite)
    return do(job, recipe, device=device, overwrite=overwrite)


def do(job: Job, recipe: Recipe, *, device: str | int | cl.Device | None = None, overwrite: bool = False) -> Outcome:
    """One job that has been checked; raises what went wrong."""
    sweep(job.target.parent)
    outcome = run_job(job, recipe, device=device, overwrite=overwrite)
    if outcome.error is not None:
        raise outcome.error
    return outcome


def denoise_files(
    paths: Input | Iterable[Input],
    out_dir: StrPath,
    *,
    method: str | None = None,
    preset: str | None = None,
    device: Any = None,
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
    overwrite: bool = False,
    on_progress: Callable[[Outcome], None] | None = None,
    max_memory_mb: int | None = None,
    recursive: bool = False,
    frames: str | Iterable[int] | None = None,
    pairs: bool = False,
    also: Sequence[str] | Literal["auto"] = (),
    temporal: int = 0,
    dask: Any = None,
    **parameters: Any,
) -> list[Outcome]:
    """Denoise frames into a folder; one that fails does not stop the others.

    Reading, denoising and writing overlap, in memory that does not grow with the number of frames. What is there and
    up to date is skipped: that was made of the same files (by size and time) with the same method, parameters, layers,
    samples and version, which every result keeps in its header. A result that is out of date is made again; a file
    that was not written here, or was made of another file, stays as it is and is reported.

    Args:
        paths: files, folders, patterns such as "shots/*/beauty.exr", sequences such as "shot.####.exr"; tuples of two
            files that are halves of one frame. One of them, or many.
        out_dir: made where it is missing. Files go there under their own names; what is found in a folder or by a
            pattern keeps its place below it.
        method, preset, layers, samples_per_pixel, max_memory_mb, **parameters: as for `denoise_file`, for every file.
        device: as for `denoise_file`; or "all", or a list of devices, to share the frames.
        overwrite: do every frame, and write over what is there.
        on_progress: called after each frame with its `Outcome`, in the calling thread, in the order in which they
            finish. What it raises ends the work: frames that are being written are finished, others are given up.
        recursive: look into folders in folders too.
        frames: which frames of sequences, such as "1-240", "1-240x2" or numbers; one that is missing fails.
        pairs: `name.a.exr` and `name.b.exr` are halves of one frame and become `name.exr`.
        also: further layers to filter like the colour, or "auto".
        temporal: how many frames before and after each to use.
        dask: do it on a Dask cluster, a frame a task: the address of its scheduler, "local" for one of all devices of
            this machine, or a `dask.distributed.Client`. `device` is then looked up on each worker. See `farm`.

    Returns:
        An outcome for each frame, in order: its `status` is "done", "skipped" or "failed", and `reason` or `error` say
        why.

    Raises:
        ExrError: there are no such files, a target would be one of the sources or that of two of them, or the folder
            cannot be made.
        ParameterError: an unknown method or preset, a parameter that the method refuses, or frames that are none.
        DeviceError: there is no such device.
        FarmError: the Dask cluster cannot be used.

    Example:
        >>> import tempfile, numpy as np
        >>> from mcdenoise_cl import write_exr
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for number in (1, 2, 3):
        ...         write_exr(f"{folder}/shot.{number:04d}.exr", np.full((8, 8, 3), number, np.float32))
        ...     shot, clean = f"{folder}/shot.####.exr", f"{folder}/clean"
        ...     first = denoise_files(shot, clean, frames="1-2", method="nlm")
        ...     second = denoise_files(shot, clean, frames="1-4", method="nlm")
        >>> [outcome.status for outcome in first], [outcome.status for outcome in second]
        (['done', 'done'], ['skipped', 'skipped', 'done', 'failed'])
    """
    recipe = Recipe.of(
        method,
        preset,
        layers=layers,
        samples_per_pixel=samples_per_pixel,
        max_memory_mb=max_memory_mb,
        also=also,
        temporal=temporal,
        **parameters,
    )
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    jobs = find_jobs(given, out_dir, recursive=recursive, frames=frames, pairs=pairs, temporal=temporal)
    if dask is not None:
        from . import farm  # what it needs is an extra

        prepare(jobs, out_dir)
        return farm.run_jobs(jobs, recipe, dask, device=device, overwrite=overwrite, on_progress=on_progress)
    devices = [info.device for info in pick_devices(device)]
    prepare(jobs, out_dir)
    return run_jobs(jobs, recipe, devices, overwrite=overwrite, on_progress=on_progress)


def plan(jobs: Sequence[Job], recipe: Recipe, overwrite: bool = False) -> list[tuple[Job, Verdict | Exception]]:
    """What would be done and why, or the reason for which it would fail; no pixels are read."""

    def verdict(job: Job) -> Verdict | Exception:
        try:
            return judge(job, recipe, overwrite)
        except ExrError as error:
            return error

    return [(job, verdict(job)) for job in jobs]


def prepare(jobs: Sequence[Job], out_dir: StrPath) -> None:
    """Make the output folder, and sweep up what runs that were killed have left in it.

    Raises:
        ExrError: it cannot be made.
    """
    try:
        Path(out_dir).mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{out_dir} cannot be made ({reason}): give another output folder") from None
    for folder in {job.target.parent for job in jobs}:
        sweep(folder)


def check_job(job: Job, recipe: Recipe, overwrite: bool) -> None:
    """Refuse, before any work, a target that is an input, cannot be written, or is there and not up to date.

    Raises:
        ExrError: it is one of these.
    """
    if any(_is_same(job.target, path) for path in job.inputs):
        raise ExrError(f"{job.target} is the input itself, which is never written to: give another output")
    exists = os.path.isfile(job.target)  # noqa: PTH113
    if not (exists and judge(job, recipe).reason == UP_TO_DATE):
        check_target(job.target, overwrite)


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
    if os.path.exists(target) and not overwrite:  # noqa: PTH110
        raise ExrError(
            f"{target} exists already: give another name, or pass --force (overwrite=True in Python) to replace it"
        )


def _is_same(one: Path, other: Path) -> bool:
    """Whether two paths lead to one file, by links or upper and lower case."""
    try:
        return os.path.samefile(one, other)  # noqa: PTH121
    except (OSError, ValueError):
        return False
