"""`Engine`: one in-order queue with its programs and its memory. Stages launch their kernels through it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyopencl as cl
import pyopencl.tools

from . import program
from .device import Shape, shape_for
from .errors import BudgetError, DeviceError, NoRoomError

# The widest tile of any device: planes are allocated up to whole tiles, so that a kernel may store whole vectors.
COLUMNS, ROWS, _SLACK = 64, 16, 16
# Between planes: without it those of usual sizes lie whole pages apart, so that the same pixel of each wants the same
# few places of a cache.
_APART = 16

#: The largest float32.
LARGEST = float(np.finfo(np.float32).max)


def _round_up(n: int, to: int) -> int:
    return -(-n // to) * to


@dataclass(frozen=True)
class Planes:
    """float32 planes (C, H, W) on the device, rows contiguous, with a border of `border` pixels on every side."""

    buffer: cl.MemoryObjectHolder
    channels: int
    height: int
    width: int
    border: int
    row: int
    plane: int
    first: int = 0
    top: int = 0

    def part(self, first: int, channels: int) -> Planes:
        """Some of the planes, in the same memory."""
        return replace(self, channels=channels, first=self.first + first)

    def rows(self, top: int, height: int) -> Planes:
        """Some of the rows, in the same memory."""
        return replace(self, top=self.top + top, height=height)

    def view(self, values: np.ndarray) -> np.ndarray:
        """(channels, rows, columns) with all borders, a view of a copy of the memory from the first plane on."""
        rows = self.plane // self.row
        strides = tuple(4 * n for n in (self.plane, self.row, 1))
        return np.lib.stride_tricks.as_strided(values, (self.channels, rows, self.row), strides)

    @property
    def arguments(self) -> tuple:
        """The four arguments that PLANES(p) in common.h stands for."""
        origin = self.first * self.plane + (self.border + self.top) * self.row + self.border
        return self.buffer, np.int32(origin), np.int32(self.row), np.int32(self.plane)


class Engine:
    """A queue, the kernels built for it and a pool of its memory. Not to be used by two threads at once.

    Memory comes from a pool: a buffer that Python lets go of is handed to the next stage that asks for its size,
    which is safe because the queue is in order.
    """

    def __init__(self, queue: cl.CommandQueue) -> None:
        if queue.properties & cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE:
            raise DeviceError("the queue is out of order but stages rely on order: pass an in-order CommandQueue")
        self.queue = queue
        self.context = queue.context
        self.device = queue.device
        self.shape = shape_for(queue.device)
        self.profiling = bool(queue.properties & cl.command_queue_properties.PROFILING_ENABLE)
        self._pool = cl.tools.MemoryPool(cl.tools.ImmediateAllocator(queue))
        self._frames = cl.tools.MemoryPool(cl.tools.ImmediateAllocator(queue))
        #: Bytes that the pool may hold; None for as many as the device has.
        self.budget: int | None = None
        self._kernels: dict[tuple, cl.Kernel] = {}
        self._constants: dict[bytes, cl.Buffer] = {}
        self._events: list[tuple[str, cl.Event]] = []

    def use_shape(self, shape: Shape) -> None:
        """Cut the work in another of `device.shapes` from now on."""
        self.shape = shape
        self._kernels.clear()

    def kernel(self, file: str, name: str, **defines: int | None) -> cl.Kernel:
        """A kernel of a file, built with these macros and the device's vector width."""
        key = (file, name, tuple(sorted(defines.items())))
        if key not in self._kernels:
            built = program.build(self.context, file, {"WIDTH": self.shape.width, **defines})
            self._kernels[key] = program.make_kernel(built, name)
        return self._kernels[key]

    def tile_defines(self, patch_radius: int, *, deep: bool = False) -> dict[str, int]:
        """The macros that patch.h needs; `deep` for kernels that keep a value an offset of the search window."""
        columns, rows = self.shape.deep if deep else self.shape.tile
        return {"COLUMNS": columns, "ROWS": rows, "PATCH_RADIUS": patch_radius}

    def vectors(self, width: int) -> int:
        """How many vectors cover a row."""
        return -(-width // self.shape.width)

    def tiles(self, height: int, width: int, *, deep: bool = False) -> tuple[int, int]:
        """The global size that covers an image with tiles."""
        columns, rows = self.shape.deep if deep else self.shape.tile
        return -(-width // columns), -(-height // rows)

    def group_defines(self) -> dict[str, int]:
        """The macros that say how large a work-group of the group schedule is."""
        columns, rows = self.shape.group
        return {"GROUP_COLUMNS": columns, "GROUP_ROWS": rows}

    def memory(self, size: int) -> cl.MemoryObjectHolder:
        """Bytes from the pool, uninitialised.

        Raises:
            NoRoomError: the device has no room for them.
            BudgetError: the budget has none.
        """
        memory = self._allocate(self._pool, size)
        if self.budget is not None and self.held > self.budget:
            self.queue.finish()
            self._pool.free_held()
            if self.held > self.budget:
                raise BudgetError(f"{self.budget / 2**20:.0f} MiB are no room for another {size / 2**20:.0f} MiB")
        return memory

    def frame_memory(self, size: int) -> cl.MemoryObjectHolder:
        """Bytes for what goes in or comes out, which the budget is not about."""
        return self._allocate(self._frames, size)

    def _allocate(self, pool: cl.tools.MemoryPool, size: int) -> cl.MemoryObjectHolder:
        try:
            return pool.allocate(size)
        except cl.MemoryError as error:
            raise NoRoomError(
                f"{self.device.name.strip()} has no room for another {size / 2**20:.0f} MiB: pass a smaller frame, "
                "or choose another device"
            ) from error

    @property
    def held(self) -> int:
        """Bytes that the pool holds, in use or not."""
        return self._pool.managed_bytes

    def release(self) -> None:
        """Give back what the pool holds and nobody uses."""
        self.queue.finish()
        self._pool.free_held()

    def planes(self, channels: int, height: int, width: int, border: int = 0) -> Planes:
        """Uninitialised planes. Rows and columns are readable and writable up to the next whole tile."""
        row = _round_up(width, COLUMNS) + 2 * border + (_SLACK if border else 0)
        plane = row * (_round_up(height, ROWS) + 2 * border) + _APART
        return Planes(self.memory(4 * channels * plane), channels, height, width, border, row, plane)

    def constant(self, values: Sequence[float] | np.ndarray) -> cl.Buffer:
        """A small float32 table on the device, uploaded once."""
        table = np.ascontiguousarray(values, np.float32)
        key = table.tobytes()
        if key not in self._constants:
            flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
            self._constants[key] = cl.Buffer(self.context, flags, hostbuf=table)
        return self._constants[key]

    def zeros(self, count: int) -> cl.MemoryObjectHolder:
        """`count` 32-bit zeros (integers or floats)."""
        buffer = self.memory(4 * count)
        cl.enqueue_fill_buffer(self.queue, buffer, np.int32(0), 0, 4 * count)
        return buffer

    def launch(
        self,
        stage: str,
        kernel: cl.Kernel,
        size: tuple[int, ...],
        *arguments,
        single: bool = False,
        local: tuple[int, ...] | None = None,
    ) -> None:
        """Enqueue a kernel; Planes become their four arguments, Python numbers 32-bit ones.

        Args:
            stage: the name under which its time is reported.
            size: global size, (columns, rows) or (columns, rows, planes); rounded up to whole work-groups, so that
                unless `single` is set a kernel must return where its column or row is beyond what there is.
            single: for work-items that do much each, or rows as a whole: one to a work-group on a CPU; elsewhere the
                runtime decides.
            local: size of a work-group, for kernels that share local memory.
        """
        flat: list = []
        for argument in arguments:
            if isinstance(argument, Planes):
                flat += argument.arguments
            elif isinstance(argument, int):
                flat.append(np.int32(argument))
            elif isinstance(argument, float):
                flat.append(np.float32(argument))
            else:
                flat.append(argument)
        if single:
            local = (1,) * len(size) if self.shape.width > 1 else None
        else:
            # The same for every frame: PoCL compiles a kernel anew for each size of work-group, and what a runtime
            # makes of a frame whose width is a prime number may be groups of one.
            local = local or (*self.shape.plain, 1)[: len(size)]
            size = tuple(_round_up(n, group) for n, group in zip(size, local, strict=True))
        try:
            event = kernel(self.queue, size, local, *flat)
        except cl.MemoryError as error:  # many devices look for memory only now
            raise NoRoomError(f"{self.device.name.strip()} has no room for what {stage} works on: {error}") from error
        if self.profiling:
            self._events.append((stage, event))

    def start(self) -> None:
        """Forget the times of the frame before."""
        self._events.clear()

    def stage_times(self) -> dict[str, float]:
        """Device milliseconds of each stage since `start`, in order; waits for them. Empty without profiling."""
        times: dict[str, float] = {}
        for stage, event in self._events:
            event.wait()
            times[stage] = times.get(stage, 0.0) + (event.profile.end - event.profile.start) * 1e-6
        return times
