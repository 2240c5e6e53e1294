"""`Denoiser`s for frames of many sizes, one at a time."""

from __future__ import annotations

import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pyopencl as cl

from .api import Denoiser
from .details import Report
from .errors import DeviceError, FrameError
from .exr_file import Part
from .exr_layers import MOTION
from .frame import Frame

if TYPE_CHECKING:
    from .job import Recipe


@dataclass(frozen=True)
class Material:
    """A job that has been read: the frame, its neighbours, the file it goes back into, and the stamp of the result.

    `frame` is None once it has been denoised. `also`: the layers that are filtered with it, by their names.
    """

    frame: Frame | None
    neighbours: tuple[Frame, ...]
    parts: Sequence[Part]
    stamp: str
    notes: tuple[str, ...] = ()
    also: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Clean:
    """What a denoiser made of a `Material`."""

    image: np.ndarray
    report: Report
    layers: Mapping[str, str]
    also: Mapping[str, np.ndarray] = field(default_factory=dict)


class Denoisers:
    """Makes the `Denoiser` for a frame, and hands out the last one again where frame and recipe are like the last.

    Only the last one is kept: each holds device memory for a whole frame. Programs are kept by the process.
    """

    def __init__(self, device: str | int | cl.Device | None = None) -> None:
        self._device = device
        self._last: tuple[Any, Denoiser] | None = None
        self._lock = threading.Lock()

    def denoise(self, material: Material, recipe: Recipe) -> Clean:
        """Raises what `Denoiser` raises; after a `DeviceError` the next frame gets a new one."""
        frame = material.frame
        with self._lock:
            try:
                denoiser = self._for(frame, recipe)
                extra = {"neighbours": list(material.neighbours)} if material.neighbours else {}
                image, report, also = denoiser(frame, also=material.also, **extra), denoiser.report, denoiser.also
            except FrameError as error:
                raise FrameError(f"{frame.metadata['source']}: {error}") from error
            except DeviceError:
                self._last = None  # it failed, but may be back by then
                raise
        used = denoiser.method.takes(frame.planes())
        named = {plane: layer for plane, layer in frame.metadata["layers"].items() if plane in used}
        if MOTION in frame.metadata and any(near.motion is not None for near in material.neighbours):
            named[MOTION] = frame.metadata[MOTION]
        named |= {"also": ",".join(also)} if also else {}
        return Clean(image, report, named, also)

    def _for(self, frame: Frame, recipe: Recipe) -> Denoiser:
        key = frame.shape, recipe.method, recipe.parameters, recipe.max_memory_mb
        if self._last is None or self._last[0] != key:
            self._last = None  # its memory goes before the next one asks for its own
            options = {"method": recipe.method, "device": self._device, "max_memory_mb": recipe.max_memory_mb}
            self._last = key, Denoiser(*frame.shape, **options, **dict(recipe.parameters))
        return self._last[1]


_denoisers: dict[Any, Denoisers] = {}
_denoisers_lock = threading.Lock()


def denoisers_on(device: str | int | cl.Device | None) -> Denoisers:
    """Those of this process, made once."""
    with _denoisers_lock:
        return _denoisers.setdefault((os.getpid(), device), Denoisers(device))
