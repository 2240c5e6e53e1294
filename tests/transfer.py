"""NumPy images to planes on the device and back, for tests that call a stage alone."""

import numpy as np
import pyopencl as cl

from mcdenoise_cl.engine import Engine, Planes


def to_planes(engine: Engine, image: np.ndarray, border: int = 0) -> Planes:
    """(H, W) or (H, W, C) to planes; whatever lies outside the image is NaN, so that reading it shows."""
    stack = np.atleast_3d(np.asarray(image, np.float32)).transpose(2, 0, 1)
    channels, height, width = stack.shape
    planes = engine.planes(channels, height, width, border)
    full = np.full(channels * planes.plane, np.nan, np.float32)
    planes.view(full)[:, border : border + height, border : border + width] = stack
    cl.enqueue_copy(engine.queue, planes.buffer, full, is_blocking=True)
    return planes


def to_array(engine: Engine, planes: Planes) -> np.ndarray:
    """Planes to (H, W, C), or (H, W) for one plane, in float64."""
    full = np.empty(planes.channels * planes.plane, np.float32)
    cl.enqueue_copy(engine.queue, full, planes.buffer, is_blocking=True)
    b = planes.border
    image = planes.view(full)[:, b : b + planes.height, b : b + planes.width].transpose(1, 2, 0).astype(np.float64)
    return image[..., 0] if planes.channels == 1 else image


def scalars(engine: Engine, buffer: cl.MemoryObjectHolder, count: int = 1, dtype=np.float32) -> np.ndarray:
    """The first values of a buffer."""
    values = np.empty(count, dtype)
    cl.enqueue_copy(engine.queue, values, buffer, is_blocking=True)
    return values
