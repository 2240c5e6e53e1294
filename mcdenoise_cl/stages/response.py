"""How much of its noise a filtered frame has, found by adding a little and filtering again; see response.cl."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
import pyopencl as cl

from ..engine import Engine, Planes
from .rows import STRETCH, Rows

#: A frame is quiet where the noise of most pixels that have any is below this part of their luminance.
QUIET = 0.03

#: Part of the noise that is added: enough to stand out from rounding, and no more than weights answer in proportion to.
PART = 0.25


def look_for_noise(engine: Engine, bands: Iterable[tuple[Planes, Sequence[Planes], Rows]]) -> Callable[[], bool]:
    """Whether a frame is quiet, which is known when it is asked for, so that the device need not be waited for before.

    Args:
        bands: colours as they came, and their variance or two half buffers.
    """
    counts, found = engine.zeros(2), np.empty(2, np.int32)
    for color, noise, rows in bands:
        kernel = engine.kernel("response.cl", "count_quiet", **({"HALVES": None} if len(noise) == 2 else {}))
        size = -(-color.width // STRETCH), rows.last - rows.first
        own = rows.first - rows.start, rows.last - rows.start
        engine.launch("response", kernel, size, color, *noise, *own, color.width, QUIET, STRETCH, counts, single=True)
    event = cl.enqueue_copy(engine.queue, found, counts, is_blocking=False)

    def quiet() -> bool:
        event.wait()
        noisy, below = found
        return 2 * below > noisy

    return quiet


def disturb(engine: Engine, color: Planes, variance: Planes, first: int = 0) -> Planes:
    """Colours, three planes, with `PART` of their noise added, which the channels share; the same in every run.

    By how much a filter's result changes is how much of the noise it keeps, its weights' answer included (Ramani, Blu
    and Unser 2008, "Monte-Carlo SURE: A Black-Box Optimization of Regularization Parameters for General Denoising
    Algorithms"). `first` is the row of the frame at which the planes begin.
    """
    height, width = color.height, color.width
    out = engine.planes(3, height, width)
    kernel = engine.kernel("response.cl", "disturb")
    engine.launch("response", kernel, (width, height), color, variance, height, width, first, PART, out)
    return out


def disturb_by_halves(
    engine: Engine, color: Planes, a: Planes, b: Planes, factor: Planes, exposure: cl.MemoryObjectHolder
) -> Planes:
    """The same with half the difference of two halves, as they came: noise as this frame has it, in each channel.

    `color` is exposed, and was scaled by `factor`, one plane.
    """
    height, width = color.height, color.width
    out = engine.planes(3, height, width)
    kernel = engine.kernel("response.cl", "disturb_by_halves")
    engine.launch("response", kernel, (width, height), color, a, b, factor, height, width, exposure, PART, out)
    return out
