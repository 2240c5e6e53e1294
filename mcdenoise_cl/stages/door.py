"""The door: users' arrays become planes, without a NaN or an infinity among them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from ..engine import Engine, Planes
from ..errors import DeviceError
from .rows import Rows

MACROS = {np.dtype("f2"): "HALF", np.dtype("f4"): None, np.dtype("f8"): "DOUBLE"}


@dataclass(frozen=True)
class Strided:
    """An interleaved array on the device, (H, W, channels) or (H, W); offset and strides count elements."""

    buffer: cl.MemoryObjectHolder
    dtype: np.dtype
    channels: int
    offset: int
    strides: tuple[int, int, int]

    def rows(self, first: int) -> Strided:
        """The same from a row on."""
        return replace(self, offset=self.offset + first * self.strides[0])

    @property
    def layout(self) -> tuple[int, int, int, int]:
        return (self.offset, *self.strides)


def type_define(engine: Engine, dtype: np.dtype, prefix: str) -> dict[str, None]:
    """The macro that tells a kernel the user's element type."""
    kind = MACROS[np.dtype(dtype)]
    if kind == "DOUBLE" and "cl_khr_fp64" not in engine.device.extensions:
        raise DeviceError(
            f"{engine.device.name.strip()} has no double precision: pass the device array as float32, .astype('f4')"
        )
    return {f"{prefix}_{kind}": None} if kind else {}


def strided(array: cl_array.Array) -> Strided:
    """A device array as buffer, offset and strides."""
    size = array.dtype.itemsize
    row, column, *channel = (stride // size for stride in array.strides)
    channels = array.shape[2] if array.ndim == 3 else 1
    return Strided(array.base_data, array.dtype, channels, array.offset // size, (row, column, *(channel or [0])))


def upload(engine: Engine, array: np.ndarray) -> tuple[Strided, np.ndarray]:
    """A host array for the device, without waiting; the second value must live until the queue has finished.

    A device in the host's own memory reads it where it is; others get a copy. float64 is rounded to float32 here: the
    planes are float32, and many GPUs have no double precision.
    """
    with np.errstate(over="ignore"):  # beyond float32 becomes infinite, which the door counts and replaces
        host = np.require(array, np.float32 if array.dtype == np.float64 else array.dtype, ["C", "A"])
    if engine.device.type & cl.device_type.CPU:
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.USE_HOST_PTR
        buffer = cl.Buffer(engine.context, flags, hostbuf=host)
    else:
        buffer = engine.frame_memory(host.nbytes)
        cl.enqueue_copy(engine.queue, buffer, host, is_blocking=False)
    channels = host.shape[2] if host.ndim == 3 else 1
    channel = 1 if host.ndim == 3 else 0
    return Strided(buffer, host.dtype, channels, 0, (host.shape[1] * channels, channels, channel)), host


def door(
    engine: Engine,
    array: Strided,
    height: int,
    width: int,
    bad: cl.MemoryObjectHolder,
    slot: int = 0,
    rows: Rows | None = None,
    count: bool = True,
    lost: float = 0.0,
    out: Planes | None = None,
) -> Planes:
    """Interleaved to planar float32; a pixel that is not finite becomes the mean of its nearest finite pixels.

    Args:
        array: (height, width, ...) of float16, float32 or float64.
        bad: int32 counters on the device; the number of replaced pixels is added to number `slot`.
        rows: those to let in; None for all.
        count: whether pixels that were replaced in the wanted rows are to be counted.
        lost: what a pixel becomes where none within 8 is finite.
        out: planes to write to, without a border; None for new ones.

    Returns:
        Planes (channels, H, W) of these rows.
    """
    channels = array.channels
    rows = rows or Rows(0, height, 0, height)
    out = out or engine.planes(channels, rows.stop - rows.start, width)
    packed = {"PACKED": None} if array.strides[1:] == ((channels, 1) if channels > 1 else (1, 0)) else {}
    kernel = engine.kernel("door.cl", "door", CHANNELS=channels, **packed, **type_define(engine, array.dtype, "SOURCE"))
    size = engine.vectors(width), out.height
    span = rows.start, rows.stop, rows.first, rows.last if count else rows.first
    engine.launch("door", kernel, size, array.buffer, *array.layout, height, width, *span, out, bad, slot, lost)
    return out
