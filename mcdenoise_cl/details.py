"""What happened to a frame: the report, and the maps of which filter was used where and how far off it may be."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pyopencl as cl

from .engine import Engine, Planes
from .methods import Method
from .methods.auto import CANDIDATES
from .methods.result import Result
from .neighbours import Merged
from .stages.mean import plane_means
from .stages.rows import Rows


@dataclass(frozen=True)
class Report:
    """What happened to one frame.

    Attributes:
        method: its name.
        parameters: every parameter with the value used.
        device: name and runtime.
        exposure: factor before tonemapping.
        noise_level: standard deviation of the noise found in the tonemapped colours.
        replaced: pixels replaced because they were not finite, by plane, and by "also.NAME" for further layers; those
            without any are left out.
        energy_removed: part of the frame's light that was taken from outliers to be spread; 0 where none were sought.
        features_used: part of the frame, 0 to 1, in which each feature carried something for the fits; only for
            methods that fit, and features that are there.
        shares: part, 0 to 1, that each candidate has in the result; only for `auto`.
        estimated_error: mean of the error map; None where the method does not estimate it.
        merged: frames that a pixel is the mean of, on average; 1 without neighbours.
        stage_ms: device milliseconds of each stage; empty if the queue has no profiling.
    """

    method: str
    parameters: dict[str, Any]
    device: str
    exposure: float
    noise_level: float
    replaced: dict[str, int]
    energy_removed: float
    features_used: dict[str, float]
    shares: dict[str, float]
    estimated_error: float | None
    merged: float
    stage_ms: dict[str, float]


@dataclass(frozen=True)
class Denoised:
    """A clean image and all that is known about how it came about.

    Attributes:
        image: (H, W, 3), as `denoise` returns it alone.
        model_map: (H, W) uint8: the candidate with the largest share, an index into `candidates`; None for methods
            that are a single filter.
        error_map: (H, W) float32: estimated squared error of the luminance over the squared luminance around,
            the input's outliers left out; None where the method does not estimate it.
        report: see `Report`.
        candidates: names of the candidates, from the simplest.
        also: the clean layers by name, each of its dtype and of the side the frame came from; empty if none were given.
    """

    image: Any
    model_map: np.ndarray | None
    error_map: np.ndarray | None
    report: Report
    candidates: tuple[str, ...] = CANDIDATES
    also: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Summary:
    """What a report and the maps need of one band.

    Attributes:
        rows: how many it has.
        removed, kept, shares, error: means over it, one float a plane, on the device; None where there are none.
        used, blocks: for each plane of features the blocks that used it, on the device, of so many; None without.
        model_map, error_map: as in `Denoised`; None where they were not asked for.
    """

    rows: int
    removed: cl.MemoryObjectHolder | None
    kept: cl.MemoryObjectHolder | None
    shares: cl.MemoryObjectHolder | None
    error: cl.MemoryObjectHolder | None
    used: cl.MemoryObjectHolder | None
    blocks: int
    model_map: np.ndarray | None
    error_map: np.ndarray | None


def summarise(engine: Engine, result: Result, rows: Rows, maps: bool) -> Summary:
    """Of the wanted rows of a result. `maps` too, which are waited for."""

    def means(planes: Planes | None) -> cl.MemoryObjectHolder | None:
        return None if planes is None else plane_means(engine, rows.wanted(planes))

    error = result.error() if result.error else None
    models = errors = None
    if maps and result.shares is not None:
        models = _download(engine, rows.wanted(result.shares)).argmax(0).astype(np.uint8)
    if maps and error is not None:
        errors = _download(engine, rows.wanted(error))[0]
    return Summary(
        rows.last - rows.first,
        means(result.removed),
        means(result.kept) if result.removed else None,
        means(result.shares),
        means(error),
        result.terms.used if result.terms else None,
        result.terms.counted if result.terms else 0,
        models,
        errors,
    )


def make_report(
    engine: Engine,
    method: Method,
    parameters: Any,
    result: Result,
    summaries: Callable[[bool], list[Summary]],
    replaced: dict[str, int],
    merged: Merged | None = None,
) -> Report:
    """Read what a method found from the device; waits for it.

    Args:
        result: of the frame, or of any of its bands: exposure, noise level and features are those of the frame.
        summaries: one a band.
        merged: what became of the frame's neighbours.
    """
    stage_ms = engine.stage_times()  # before what follows adds to it
    device, parts = engine.device, summaries(False)
    shares = _mean(engine, parts, "shares", len(CANDIDATES))
    error = _mean(engine, parts, "error", 1)
    return Report(
        method=method.name,
        parameters=asdict(parameters),
        device=f"{device.name.strip()} ({device.platform.name.strip()}, {device.version.strip()})",
        exposure=float(_values(engine, result.exposure, 1)[0]),
        noise_level=float(_values(engine, result.noise_level, 1)[0]),
        replaced=replaced,
        energy_removed=_energy_removed(engine, parts),
        features_used=_features_used(engine, result.feature_names, parts),
        shares=dict(zip(CANDIDATES, shares, strict=True)) if shares else {},
        estimated_error=error[0] if error else None,
        merged=merged.mean(engine) if merged else 1.0,
        stage_ms=stage_ms,
    )


def model_map(parts: list[Summary]) -> np.ndarray | None:
    """(H, W): index of the candidate with the largest share; the simplest of equals."""
    return None if parts[0].model_map is None else np.concatenate([part.model_map for part in parts])


def error_map(parts: list[Summary]) -> np.ndarray | None:
    """(H, W): the estimated relative squared error."""
    return None if parts[0].error_map is None else np.concatenate([part.error_map for part in parts])


def _mean(engine: Engine, parts: list[Summary], name: str, count: int) -> list[float] | None:
    """The mean over the frame, of each plane; None where there is none."""
    if getattr(parts[0], name) is None:
        return None
    values = [part.rows * _values(engine, getattr(part, name), count).astype(float) for part in parts]
    return (sum(values) / sum(part.rows for part in parts)).tolist()


def _energy_removed(engine: Engine, parts: list[Summary]) -> float:
    if parts[0].removed is None:
        return 0.0
    removed, kept = (sum(_mean(engine, parts, name, 3)) for name in ("removed", "kept"))
    return removed / (removed + kept) if removed > 0 else 0.0


def _features_used(engine: Engine, names: tuple[str, ...], parts: list[Summary]) -> dict[str, float]:
    """A feature of three planes counts as used where one of them is: the largest part of the three."""
    if parts[0].used is None:
        return {}
    counts = sum(_values(engine, part.used, len(names), np.int32) for part in parts)
    used: dict[str, float] = {}
    for name, count in zip(names, counts, strict=True):
        used[name] = max(used.get(name, 0.0), int(count) / sum(part.blocks for part in parts))
    return used


def _values(engine: Engine, buffer: cl.MemoryObjectHolder, count: int, dtype: type = np.float32) -> np.ndarray:
    values = np.empty(count, dtype)
    cl.enqueue_copy(engine.queue, values, buffer, is_blocking=True)
    return values


def _download(engine: Engine, planes: Planes) -> np.ndarray:
    """(channels, H, W); only planes without a border come here."""
    values = np.empty(planes.channels * planes.plane, np.float32)
    offset = 4 * planes.first * planes.plane
    cl.enqueue_copy(engine.queue, values, planes.buffer, src_offset=offset, is_blocking=True)
    return planes.view(values)[:, planes.top : planes.top + planes.height, : planes.width]
