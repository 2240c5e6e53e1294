"""What happened to a frame: the report, and the maps of which filter was used where and how far off it may be."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyopencl as cl

from .engine import Engine, Planes
from .methods import Method
from .methods.auto import CANDIDATES
from .methods.result import Result
from .stages.mean import plane_means


@dataclass(frozen=True)
class Report:
    """What happened to one frame.

    Attributes:
        method: its name.
        parameters: every parameter with the value used.
        device: name and runtime.
        exposure: factor before tonemapping.
        noise_level: standard deviation of the noise found in the tonemapped colours.
        replaced: pixels replaced because they were not finite, by plane; planes without any are left out.
        energy_removed: part of the frame's light that was taken from outliers and spread; 0 where none were looked for.
        features_used: part of the frame, 0 to 1, in which each feature carried something for the fits; only for
            methods that fit, and features that are there.
        shares: part, 0 to 1, that each candidate has in the result; only for `auto`.
        estimated_error: mean of the error map; None where the method does not estimate it.
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
    """

    image: Any
    model_map: np.ndarray | None
    error_map: np.ndarray | None
    report: Report
    candidates: tuple[str, ...] = CANDIDATES


def make_report(engine: Engine, method: Method, parameters: Any, result: Result, replaced: dict[str, int]) -> Report:
    """Read what a method found from the device; waits for it."""
    stage_ms = engine.stage_times()  # before what follows adds to it
    device = engine.device
    return Report(
        method=method.name,
        parameters=asdict(parameters),
        device=f"{device.name.strip()} ({device.platform.name.strip()}, {device.version.strip()})",
        exposure=float(_values(engine, result.exposure, 1)[0]),
        noise_level=float(_values(engine, result.noise_level, 1)[0]),
        replaced=replaced,
        energy_removed=_energy_removed(engine, result),
        features_used=_features_used(engine, result),
        shares=dict(zip(CANDIDATES, _means(engine, result.shares), strict=True)) if result.shares else {},
        estimated_error=_means(engine, result.error())[0] if result.error else None,
        stage_ms=stage_ms,
    )


def model_map(engine: Engine, result: Result) -> np.ndarray | None:
    """(H, W): index of the candidate with the largest share; the simplest of equals."""
    return None if result.shares is None else _download(engine, result.shares).argmax(0).astype(np.uint8)


def error_map(engine: Engine, result: Result) -> np.ndarray | None:
    """(H, W): the estimated relative squared error."""
    return None if result.error is None else _download(engine, result.error())[0]


def _energy_removed(engine: Engine, result: Result) -> float:
    if result.removed is None:
        return 0.0
    removed, kept = (sum(_means(engine, planes)) for planes in (result.removed, result.kept))
    return removed / (removed + kept) if removed > 0 else 0.0


def _features_used(engine: Engine, result: Result) -> dict[str, float]:
    """A feature of three planes counts as used where one of them is: the largest part of the three."""
    if result.terms is None:
        return {}
    counts = _values(engine, result.terms.used, len(result.feature_names), np.int32)
    parts: dict[str, float] = {}
    for name, count in zip(result.feature_names, counts, strict=True):
        parts[name] = max(parts.get(name, 0.0), int(count) / (result.terms.across * result.terms.down))
    return parts


def _means(engine: Engine, planes: Planes) -> list[float]:
    return _values(engine, plane_means(engine, planes), planes.channels).tolist()


def _values(engine: Engine, buffer: cl.MemoryObjectHolder, count: int, dtype: type = np.float32) -> np.ndarray:
    values = np.empty(count, dtype)
    cl.enqueue_copy(engine.queue, values, buffer, is_blocking=True)
    return values


def _download(engine: Engine, planes: Planes) -> np.ndarray:
    """(channels, H, W); only planes without a border come here."""
    rows = planes.plane // planes.row
    full = np.empty((planes.channels, rows, planes.row), np.float32)
    offset = 4 * planes.first * planes.plane
    cl.enqueue_copy(engine.queue, full, planes.buffer, src_offset=offset, is_blocking=True)
    return full[:, : planes.height, : planes.width]
