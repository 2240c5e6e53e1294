"""One frame from file to file: what there is to do (`Job`), how (`Recipe`), the doing (`run_job`) and what became of it
(`Outcome`). All of them can be pickled, so that the same function serves a loop, threads and other machines.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyopencl as cl

from .denoisers import Clean, Material, denoisers_on
from .details import Report
from .errors import ExrError, FrameError, McdenoiseError, ParameterError
from .exr import STAMP, frame_of, replace_color
from .exr_also import also_of, replace_also
from .exr_file import Part, load, save
from .frame import Frame
from .halves import mean_of_halves, partner, weighted_sum, weights_of_halves
from .methods import get_method, settle
from .methods.parameters import make, shown
from .motion import with_motion
from .quiet import hushed
from .sequence import frames_between
from .stamp import judge, stamp


@dataclass(frozen=True)
class Job:
    """One frame to denoise.

    Attributes:
        source: the EXR file to read; with `halves` the first of them. All its other layers are kept.
        target: the EXR file to write, in a folder that is made where it is missing.
        halves: two renderings of the frame with different seeds, whose mean is denoised; None: `source` alone.
        neighbours: the frames before and after, in order, for a recipe with `temporal`. With `halves` each is the
            first of two, `shot.0002.a.exr`, and the second is found by its name.
    """

    source: Path
    target: Path
    halves: tuple[Path, Path] | None = None
    neighbours: tuple[Path, ...] = ()

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Every file that the result depends on, `source` first."""
        beside = self.neighbours
        if self.halves is not None:
            beside = tuple(path for first in beside for path in (first, partner(first)))
        return (*(self.halves or (self.source,)), *beside)


@dataclass(frozen=True)
class Recipe:
    """How frames are denoised; make it with `Recipe.of`, which checks it.

    Attributes:
        method: a name of `methods()`.
        parameters: name and value of every parameter, defaults included.
        layers: plane and layer, as for `read_exr`.
        samples_per_pixel: as for `read_exr`.
        max_memory_mb: as for `Denoiser`; has no influence on the result.
        also: names of further layers to filter with what is found for the colour, or "auto": those that in groups
            sum to it.
        temporal: how many frames before and after are used.

    Example:
        >>> recipe = Recipe.of(preset="fast", layers={"depth": "none"})
        >>> recipe.method, recipe.layers, pickle.loads(pickle.dumps(recipe)) == recipe
        ('guided', (('depth', 'none'),), True)
    """

    method: str
    parameters: tuple[tuple[str, Any], ...] = ()
    layers: tuple[tuple[str, str], ...] = ()
    samples_per_pixel: int | None = None
    max_memory_mb: int | None = None
    also: tuple[str, ...] | Literal["auto"] = ()
    temporal: int = 0

    @classmethod
    def of(
        cls,
        method: str | None = None,
        preset: str | None = None,
        *,
        layers: Mapping[str, str] | None = None,
        samples_per_pixel: int | None = None,
        max_memory_mb: int | None = None,
        also: Sequence[str] | Literal["auto"] = (),
        temporal: int = 0,
        **parameters: Any,
    ) -> Recipe:
        """A recipe from what users give.

        Raises:
            ParameterError: an unknown method or preset, both of them, a parameter that the method refuses, or
                `temporal` below 0, or both `temporal` and `also`.
        """
        if isinstance(temporal, bool) or not isinstance(temporal, int | np.integer) or temporal < 0:
            raise ParameterError(f"temporal is {shown(temporal)} but a whole number of frames, 0 or more, is needed")
        if temporal and also:
            raise ParameterError(
                "temporal and also are both given, but only the colour is merged with neighbours: leave one of them out"
            )
        name, parameters = settle(method, preset, parameters)
        values = asdict(make(get_method(name).make, name, parameters))
        return cls(
            name,
            tuple(values.items()),
            tuple(sorted((layers or {}).items())),
            samples_per_pixel,
            max_memory_mb,
            also if isinstance(also, str) else tuple(also),
            int(temporal),
        )


@dataclass(frozen=True)
class Outcome:
    """What became of one file.

    Attributes:
        source, target: the file read and the file written.
        report: what the denoiser did, where it did.
        layers: plane -> the layer it was read from, of the planes the method used; under "also" the names of the layers
            that were filtered with the colour.
        error: why the file failed. Where there is neither report nor error it was skipped.
        reason: why it was done, or skipped.
        notes: what its user may not expect.
        seconds: how long "read", "denoise" and "write" took.
    """

    source: Path
    target: Path
    report: Report | None = None
    layers: Mapping[str, str] = field(default_factory=dict)
    error: Exception | None = None
    reason: str = ""
    notes: tuple[str, ...] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)

    @property
    def status(self) -> Literal["done", "skipped", "failed"]:
        return "failed" if self.error is not None else "skipped" if self.report is None else "done"


#: The parts of a file and the frame in them; a cache may stand in for it.
Reader = Callable[[Path], tuple[Sequence[Part], Frame]]


def run_job(
    job: Job, recipe: Recipe, *, device: str | int | cl.Device | None = None, overwrite: bool = False
) -> Outcome:
    """Do one job in this process: read, denoise, write; nothing is done where the target is up to date.

    The target appears under its name only when it is complete. Needs nothing but its arguments, so it can run in
    another process or on another machine that sees the same files. Threads may call it at once: reading and writing
    overlap, denoising on one device takes turns. What is kept between calls is a `Denoiser` a device.

    Args:
        device: index, part of a name, or `pyopencl.Device`; None: the default device.
        overwrite: write over a target that is up to date, or was not written by this program.

    Returns:
        An outcome that can be pickled; whatever goes wrong is its `error`.

    Example:
        >>> import tempfile
        >>> from mcdenoise_cl import write_exr
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     job = Job(Path(folder, "noisy.exr"), Path(folder, "clean.exr"))
        ...     write_exr(job.source, np.ones((8, 8, 3), np.float32))
        ...     outcomes = [run_job(job, Recipe.of("nlm")) for _ in range(2)]
        >>> [(outcome.status, outcome.reason) for outcome in outcomes]
        [('done', 'new'), ('skipped', 'up to date')]
    """
    try:
        verdict = judge(job, recipe, overwrite)
        if not verdict.needed:
            return Outcome(job.source, job.target, reason=verdict.reason)
        started = time.perf_counter()
        material = read_job(job, recipe)
        read = time.perf_counter()
        clean = denoisers_on(device).denoise(material, recipe)
        denoised = time.perf_counter()
        write_job(job, recipe, material, clean)
        times = {"read": read - started, "denoise": denoised - read, "write": time.perf_counter() - denoised}
        return finished(job, material, clean, verdict.reason, times)
    except Exception as error:
        return Outcome(job.source, job.target, error=portable(error))


def read_job(job: Job, recipe: Recipe, reader: Reader | None = None) -> Material:
    """Read all that a job needs.

    Raises:
        ExrError, FrameError: a file cannot be read, or two halves do not fit together.
    """
    read = reader or reader_for(recipe)
    # Before the files are read: whoever changes one meanwhile is noticed by the next run.
    text = stamp(job, recipe)
    parts, frame = read(job.source)
    also = also_of(job.source, parts, recipe.also, frame, dict(recipe.layers))
    images, neighbours, offsets, notes = also.images, [], [], list(also.notes)
    if job.halves is not None:
        frame, images = _halves(job.halves, read), _halves_also(job.halves, read, images, dict(recipe.layers))
    for path in job.neighbours if recipe.temporal else ():
        try:
            beside = read(path)[1] if job.halves is None else _halves((path, partner(path)), read)
        except (ExrError, FrameError) as error:  # it is listed as a failure of its own
            notes.append(f"done without its neighbour: {error}")
            continue
        if beside.shape == frame.shape:
            neighbours.append(beside)
            offsets.append(frames_between(job.source, path))
        else:
            notes.append(f"done without its neighbour {path}, which is {beside.shape} and not {frame.shape}")
    return Material(frame, tuple(with_motion(frame, neighbours, offsets)), parts, text, tuple(notes), images)


def reader_for(recipe: Recipe) -> Reader:
    """Reads a file the way a recipe says."""

    def read(path: Path) -> tuple[Sequence[Part], Frame]:
        with hushed():
            parts = load(path)
            # Only a neighbour, or what has some, has use for motion vectors.
            motion = recipe.temporal > 0
            return parts, frame_of(path, parts, dict(recipe.layers), recipe.samples_per_pixel, motion=motion)

    return read


def _halves(paths: tuple[Path, Path], read: Reader) -> Frame:
    return mean_of_halves(*(read(path)[1] for path in paths), names=paths)


def _halves_also(
    paths: tuple[Path, Path], read: Reader, images: Mapping[str, np.ndarray], layers: Mapping[str, str]
) -> dict[str, np.ndarray]:
    """The layers of two halves as one: `images`, those of the first, with the same of the second."""
    if not images:
        return {}
    first, (parts, second) = read(paths[0])[1], read(paths[1])
    beside = also_of(paths[1], parts, tuple(images), second, layers).images
    weights = weights_of_halves(first, second)
    return {name: weighted_sum(image, beside[name], weights) for name, image in images.items()}


def write_job(job: Job, recipe: Recipe, material: Material, clean: Clean) -> None:
    """Write the result beside everything else its source held, with a stamp of how it was made.

    Raises:
        ExrError: the folder cannot be made or the file cannot be written.
    """
    folder = job.target.parent
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{folder} cannot be made ({reason}): give another output folder") from None
    parts = replace_color(job.source, material.parts, clean.image, dict(recipe.layers))
    parts = replace_also(job.source, parts, clean.also, dict(recipe.layers))
    parts[0] = replace(parts[0], header=parts[0].header | {STAMP: material.stamp})
    save(job.target, parts)


def finished(job: Job, material: Material, clean: Clean, reason: str, seconds: Mapping[str, float]) -> Outcome:
    """The outcome of a job that was done."""
    return Outcome(
        job.source, job.target, clean.report, clean.layers, reason=reason, notes=material.notes, seconds=dict(seconds)
    )


def portable(error: Exception) -> Exception:
    """The error, or where it cannot be pickled, one that says the same."""
    try:
        pickle.loads(pickle.dumps(error))
        return error
    except Exception:
        return McdenoiseError(f"unexpected {type(error).__name__}: {error}")
