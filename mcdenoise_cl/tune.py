"""Which shapes of tiles and work-groups are fastest on a device, by trying them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from .api import Denoiser
from .device import DeviceInfo, Shape, identity, shape_as_text, shapes
from .errors import DeviceError
from .frame import Frame
from .measured import forget, remember

#: Methods whose kernels take most of the time: one that holds little a pixel, one that holds much.
METHODS = ("nlm", "regression")
#: A shape replaces the one to expect most of only if it takes less than this part of its time: timings scatter.
BETTER = 0.97


@dataclass(frozen=True)
class Trial:
    """A shape and the seconds that a small frame took with it, both methods together."""

    shape: Shape
    seconds: float


def tune(
    info: DeviceInfo, on_progress: Callable[[int, int], None] | None = None, height: int = 360, width: int = 640
) -> list[Trial]:
    """Try the shapes of a device, and let later runs of the same user on it take the fastest.

    Args:
        info: the device.
        on_progress: called with how many shapes were tried, of how many.
        height, width: size of the frame that is filtered.

    Returns:
        A trial for each shape that runs, the fastest first, which is used from now on, unless the one to expect most of
        is nearly as fast.

    Raises:
        DeviceError: the device cannot be opened, or runs none of the shapes.
    """
    frame, possible = _frame(height, width), shapes(info.device)
    denoisers = [Denoiser(height, width, method=method, device=info.device) for method in METHODS]
    trials, failure = [], None
    for number, shape in enumerate(possible):
        try:
            trials.append(Trial(shape, sum(_seconds(denoiser, shape, frame) for denoiser in denoisers)))
        except (DeviceError, cl.Error) as error:  # a shape that asks too much of this device
            failure = error
        if on_progress is not None:
            on_progress(number + 1, len(possible))
    if not trials:
        raise DeviceError(f"no shape of kernels runs on {info.name}: {failure}") from failure
    first = trials[0]
    trials.sort(key=lambda trial: trial.seconds)
    if trials[0].seconds < BETTER * first.seconds:
        remember(identity(info), shape_as_text(trials[0].shape))
    else:
        forget(identity(info))
    return trials


def _frame(height: int, width: int) -> Frame:
    """Slopes and noise, so that no feature is left out."""
    rng = np.random.default_rng(0)
    slope = np.linspace(0, 1, height * width, dtype=np.float32).reshape(height, width, 1)
    albedo, normal, color = (slope + 0.2 * rng.standard_normal((height, width, 3), dtype=np.float32) for _ in range(3))
    return Frame(color, albedo, normal, 1 + albedo[..., 0])


def _seconds(denoiser: Denoiser, shape: Shape, frame: Frame) -> float:
    """Of one frame on the host, the best of three once the kernels are built."""
    denoiser.use_shape(shape)
    denoiser(frame)
    times = []
    for _ in range(3):
        start = time.perf_counter()
        denoiser(frame)
        times.append(time.perf_counter() - start)
    return min(times)
