"""What a page shows: a noisy frame, results of it, and what there is to judge them by."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyopencl.array as cl_array

from ..details import Denoised, Report
from ..errors import FrameError, ParameterError
from ..frame import Frame
from ..maps import LEAST_ERROR, MOST_ERROR, PALETTE
from ..metrics import Scores, compare, frame_exposure
from .planes import Plane

#: Names that a page uses itself.
INPUT, REFERENCE = "input", "reference"
#: The features of a frame that are shown, with the kind of plane they are.
FEATURES = {"albedo": "reflectance", "normal": "normal", "depth": "depth"}


@dataclass(frozen=True)
class Entry:
    """One clean image, and what is known about how it came about.

    Attributes:
        image: (H, W, 3), scene-linear.
        seconds: of one frame, from and to the memory of the host.
        details: what `denoise(..., details=True)` returned.
        scores: against the reference; None: computed where there is one.
    """

    image: Any
    seconds: float | None = None
    details: Denoised | None = None
    scores: Scores | None = None

    @property
    def report(self) -> Report | None:
        """What the denoiser said."""
        return None if self.details is None else self.details.report


@dataclass(frozen=True)
class Content:
    """All that a page shows, checked and brought to the memory of the host.

    Attributes:
        planes: what can be looked at, the input first.
        entries: name -> result.
        scores: name -> scores, of the input too; empty without a reference.
        unscored: name -> why there are none.
        exposure: factor to display white.
    """

    planes: list[Plane]
    entries: Mapping[str, Entry]
    scores: Mapping[str, Scores]
    unscored: Mapping[str, str]
    exposure: float
    metadata: Mapping[str, Any] = field(default_factory=dict)

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return self.planes[0].values.shape[:2]


def gather(frame: Frame, results: Mapping[str, Any], reference: Any = None, scores: Scores | None = None) -> Content:
    """Check and score what is to be shown.

    Args:
        frame: the noisy one.
        results: name -> `Entry`, `Denoised` or array.
        reference: a `Frame` or an array.
        scores: those of the input; None: computed where there is a reference.

    Raises:
        FrameError: an image has another size than the frame.
        ParameterError: a name that the page needs itself.
    """
    entries = {name: _entry(name, result) for name, result in results.items()}
    truth = reference if reference is None or isinstance(reference, Frame) else Frame(reference)
    images = {INPUT: frame.color} | {name: entry.image for name, entry in entries.items()}
    if truth is not None:
        images[REFERENCE] = truth.color
    images = {name: _host(image) for name, image in images.items()}
    for name, image in images.items():
        if image.shape != (*frame.shape, 3):
            raise FrameError(f"{name} is {image.shape} but {INPUT} is {(*frame.shape, 3)}: pass images of one size")
    exposure = frame_exposure(truth if truth is not None else frame)

    planes = [Plane(name, "light", image, scale=exposure) for name, image in images.items()]
    present = frame.planes()
    planes += [_feature(name, kind, _host(present[name])) for name, kind in FEATURES.items() if name in present]
    for name, entry in entries.items():
        planes += _maps(name if len(entries) > 1 else "", entry.details)
    found, unscored = {}, {}
    if truth is not None:
        known = {INPUT: scores} | {name: entry.scores for name, entry in entries.items()}
        for name, given in known.items():
            try:
                found[name] = given or compare(images[name], truth, exposure)
            except FrameError as error:
                unscored[name] = str(error).replace("image has", f"{name} has", 1)
    return Content(planes, entries, found, unscored, exposure, frame.metadata)


def _entry(name: str, result: Any) -> Entry:
    if name in (INPUT, REFERENCE, *FEATURES):
        raise ParameterError(f"a result is named {name!r}, as the page names something else: choose another name")
    if isinstance(result, Entry):
        return result
    return Entry(result.image, details=result) if isinstance(result, Denoised) else Entry(result)


def _host(values: Any) -> np.ndarray:
    return np.asarray(values.get() if isinstance(values, cl_array.Array) else values)


def _feature(name: str, kind: str, values: np.ndarray) -> Plane:
    if kind == "normal":
        return Plane(name, kind, np.clip(values, -1, 1), step=1 / 127, dark=0.0)
    if kind == "reflectance":
        return Plane(name, kind, values, dark=2.0**-5)
    hit = values[np.isfinite(values) & (values > 0)].astype(np.float64)
    near, middle, far = np.percentile(hit, (1, 50, 99)) if hit.size else (0.0, 1.0, 1.0)
    return Plane(name, kind, values, scale=1 / middle, facts={"range": [near, far]})


def _maps(name: str, details: Denoised | None) -> list[Plane]:
    planes, of = [], name and f" of {name}"
    if details is None:
        return planes
    if details.error_map is not None:
        scale = {"range": [LEAST_ERROR, MOST_ERROR], "of": name}
        planes.append(Plane(f"estimated error{of}", "error", details.error_map, step=0.05, dark=1e-4, facts=scale))
    if details.model_map is not None:
        shares = details.report.shares
        facts = {"colors": PALETTE[: len(details.candidates)].tolist(), "of": name}
        facts["shares"] = [shares.get(candidate) for candidate in details.candidates]
        planes.append(
            Plane(f"model map{of}", "labels", details.model_map, 1.0, 1.0, 0.0, details.candidates, facts=facts)
        )
    return planes
