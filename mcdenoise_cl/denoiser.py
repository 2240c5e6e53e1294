"""`Denoiser`: a method made ready for many frames of one size."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from .also import PREFIX, check_layers
from .bands import Filtered, budget_of, fewer_rows, filter_frame, first_guess, least_rows, most_rows
from .choose import pick_device
from .details import Report, error_map, make_report, model_map
from .device import Shape, context_for, device_errors
from .engine import Engine
from .errors import BudgetError, FrameError, NoRoomError, ParameterError
from .frame import Frame
from .inputs import as_frame, check_frame, check_neighbours
from .methods import Method, get_method, settle
from .methods.parameters import make, shown
from .neighbours import COMPARED, MOTION, Merged, least_rows_to_merge, merge
from .stages.door import Strided, strided, upload
from .stages.source import Source


class Denoiser:
    """A method made ready for frames of one size: it keeps its queue, programs and device memory.

    Threads may share one `Denoiser`: calls take turns. For parallel work give each thread its own.

    Args:
        height, width: size of the frames, in pixels.
        method: a name of `methods()`.
        preset: "fast", "balanced" or "high" instead of a method; "high" if neither is given.
        device: index, part of a name, or `pyopencl.Device`; None: see `mcdenoise_cl.choose.pick_device`.
        queue: an in-order `pyopencl.CommandQueue` to work on instead, in the caller's context.
        max_memory_mb: MiB that may be kept at a time besides input and output; a frame that needs more is filtered in
            bands of rows, to the same result. What neighbours are merged into counts as input: a float32 copy of each
            plane that the method takes. None: what the device has, or half of it where that is the host's.
        **parameters: the method's, by name.

    Raises:
        ParameterError: an unknown method, preset or parameter, or a value out of range.
        DeviceError: no such device, or a kernel that does not build on it.

    Example:
        >>> import numpy as np
        >>> denoiser = Denoiser(4, 6, method="nlm")
        >>> denoiser(np.ones((4, 6, 3), np.float32)).shape
        (4, 6, 3)
        >>> denoiser.report.method
        'nlm'
    """

    def __init__(
        self,
        height: int,
        width: int,
        *,
        method: str | None = None,
        preset: str | None = None,
        device: str | int | cl.Device | None = None,
        queue: cl.CommandQueue | None = None,
        max_memory_mb: int | None = None,
        **parameters: Any,
    ) -> None:
        sizes = {"height": height, "width": width}
        if max_memory_mb is not None:
            sizes["max_memory_mb"] = max_memory_mb
        for name, value in sizes.items():
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise ParameterError(f"{name} is {shown(value)} but a whole number of at least 1 is needed")
        self.height, self.width = int(height), int(width)
        name, parameters = settle(method, preset, parameters)
        self.method: Method = get_method(name)
        self.parameters = make(self.method.make, name, parameters)
        if queue is not None and device is not None:
            raise ParameterError("device and queue are both given: pass one, since a queue belongs to a device")
        self._device = pick_device(device).device if queue is None else queue.device
        self._name = self._device.name.strip()
        with self._errors():
            if queue is None:
                profiling = cl.command_queue_properties.PROFILING_ENABLE
                queue = cl.CommandQueue(context_for(self._device), self._device, properties=profiling)
            self._engine = Engine(queue)
        self._lock = threading.Lock()
        self._engine.budget = budget_of(self._engine.device, max_memory_mb)
        self._rows = first_guess(self.height, self.width, self._engine.budget, self._least_rows)
        self._last: tuple[Filtered, tuple[str, ...], cl.MemoryObjectHolder] | None = None
        self._also: dict[str, Any] = {}
        self._merged: Merged | None = None

    def _errors(self) -> contextlib.AbstractContextManager[None]:
        return device_errors(self._name, self._device)

    @property
    def queue(self) -> cl.CommandQueue:
        """The queue on which everything runs."""
        return self._engine.queue

    def use_shape(self, shape: Shape) -> None:
        """Cut the work otherwise from now on: for `mcdenoise_cl.tune`."""
        with self._lock:
            self._engine.use_shape(shape)

    @property
    def report(self) -> Report:
        """What happened to the last frame. Waits for it.

        Raises:
            ParameterError: no frame has been denoised yet.
        """
        with self._lock, self._errors():
            found, names, bad = self._last_frame()
            replaced = self._replaced(names, bad)
            known = self.method, self.parameters, found.result, found.summaries, replaced, self._merged
            return make_report(self._engine, *known)

    @property
    def model_map(self) -> np.ndarray | None:
        """Which candidate has the largest share where, in the last frame: see `Denoised`. Waits for it.

        Raises:
            ParameterError: no frame has been denoised yet.
        """
        with self._lock, self._errors():
            return model_map(self._last_frame()[0].summaries(True))

    @property
    def error_map(self) -> np.ndarray | None:
        """The estimated error of the last frame: see `Denoised`. Waits for it.

        Raises:
            ParameterError: no frame has been denoised yet.
        """
        with self._lock, self._errors():
            return error_map(self._last_frame()[0].summaries(True))

    @property
    def also(self) -> dict[str, Any]:
        """The clean layers of the last frame, by the names under which they came; empty if none did.

        Raises:
            ParameterError: no frame has been denoised yet.
        """
        with self._lock:
            self._last_frame()
            return dict(self._also)

    def _last_frame(self) -> tuple[Filtered, tuple[str, ...], cl.MemoryObjectHolder]:
        if self._last is None:
            raise ParameterError("there is no report yet: denoise a frame first")
        return self._last

    def __call__(
        self,
        frame_or_color: Frame | np.ndarray | cl_array.Array,
        *,
        out: Any = None,
        also: Mapping[str, Any] | None = None,
        neighbours: Iterable[Frame] = (),
        **planes: Any,
    ) -> Any:
        """Denoise one frame.

        Args:
            frame_or_color: a `Frame`, or its colour, with the other planes as keywords.
            out: an array of the frame's shape and side (host or device) to write to, any supported dtype.
            also: further layers by name, (H, W, 3) like the colour, to be filtered with what is found for it. They come
                in `Denoiser.also`, each in its dtype; see `denoise`.
            neighbours: frames before and after it in a sequence, in any order, of the same size, on the same side, with
                at least the same planes: what they show of the same is merged into the frame first. With `motion`
                where it is known (see `Frame`), else it is searched for, up to 4 pixels to each side.
            **planes: `albedo=`, `normal=`, ... where `frame_or_color` is an array.

        Returns:
            (H, W, 3), scene-linear, of the dtype of the colour: a NumPy array for host planes; for device planes a
            `pyopencl.array.Array` in the same context, on this denoiser's queue, not waited for, though `auto` waits
            until it has seen how much noise there is. `out` if given.

        Raises:
            FrameError: the frame has another size, lacks a plane that the method needs, lies in another context,
                has no finite pixel (host frames; on the device such a frame comes out black), or `out` or a neighbour
                does not fit.
            DeviceError: the device has no room, or has failed: then make another Denoiser.
        """
        frame = as_frame(frame_or_color, planes)
        check_frame(frame, (self.height, self.width), self.method, out)
        layers = check_layers(also, frame)
        near = check_neighbours(neighbours, frame, self._used(frame, True))
        if layers and near:
            raise FrameError(
                "also and neighbours are both given, but only the colour is merged with neighbours: leave one out"
            )
        run = self._run_device if frame.on_device else self._run_host
        with self._lock, self._errors():
            return run(frame, near, layers, out)

    def _used(self, frame: Frame, merging: bool) -> dict[str, Any]:
        """The planes that the method takes and, where neighbours are merged, those by which they are compared."""
        present = frame.planes()
        names = {*self.method.takes(present), *(COMPARED if merging else ())}
        return {name: plane for name, plane in present.items() if name in names}

    def _used_of_all(self, frame: Frame, neighbours: list[Frame], layers: dict[str, Any]) -> list[dict[str, Any]]:
        """The same of the frame, with its further layers, and of each neighbour, with motion where it is known."""
        own = self._used(frame, bool(neighbours))
        used = [own | layers]
        for neighbour in neighbours:
            used.append({name: getattr(neighbour, name) for name in own})
            if neighbour.motion is not None:
                used[-1][MOTION] = neighbour.motion
        return used

    def _run_host(
        self, frame: Frame, neighbours: list[Frame], layers: dict[str, np.ndarray], out: np.ndarray | None
    ) -> np.ndarray:
        engine = self._engine
        engine.start()
        alive = []  # what is uploaded must not go before the queue has taken it
        try:
            arrays: list[dict[str, Strided]] = []
            for used in self._used_of_all(frame, neighbours, layers):
                arrays.append({})
                for name, plane in used.items():
                    arrays[-1][name], host = upload(engine, plane)
                    alive.append(host)
            return self._download(arrays, frame, layers, out)
        except BaseException:
            with contextlib.suppress(cl.Error):  # where the device is gone, nothing reads them any more
                engine.queue.finish()
            raise

    def _download(
        self, arrays: list[dict[str, Strided]], frame: Frame, layers: dict[str, np.ndarray], out: np.ndarray | None
    ) -> np.ndarray:
        dtypes = [frame.color.dtype if out is None else out.dtype, *(layer.dtype for layer in layers.values())]
        color, *others = (self._room_for(dtype) for dtype in dtypes)
        self._filter(arrays, tuple(layers), color, others)
        if self._replaced(*self._last[1:]).get("color") == self.height * self.width:
            raise FrameError("color has no finite pixel: there is nothing to denoise, so look at the renderer")
        direct = out is not None and out.dtype == color.dtype and out.flags.c_contiguous
        result = self._fetch(color, out if direct else None)
        found = (self._fetch(place).astype(dtype, copy=False) for place, dtype in zip(others, dtypes[1:], strict=True))
        self._also = self._named(layers, found)
        if out is None:
            return result.astype(dtypes[0], copy=False)
        if not direct:
            out[...] = result
        return out

    def _room_for(self, wanted: np.dtype) -> Strided:
        """For a picture that goes to the host: float64 becomes so there."""
        dtype = np.dtype("f4") if wanted == np.float64 else np.dtype(wanted)
        size = 3 * self.height * self.width * dtype.itemsize
        return Strided(self._engine.frame_memory(size), dtype, 3, 0, (3 * self.width, 3, 1))

    def _fetch(self, place: Strided, to: np.ndarray | None = None) -> np.ndarray:
        result = np.empty((self.height, self.width, 3), place.dtype) if to is None else to
        cl.enqueue_copy(self.queue, result, place.buffer, is_blocking=True)
        return result

    def _named(self, layers: Iterable[str], found: Iterable[Any]) -> dict[str, Any]:
        return {name.removeprefix(PREFIX): layer for name, layer in zip(layers, found, strict=True)}

    def _run_device(
        self,
        frame: Frame,
        neighbours: list[Frame],
        layers: dict[str, cl_array.Array],
        out: cl_array.Array | None,
    ) -> cl_array.Array:
        engine = self._engine
        used = self._used_of_all(frame, neighbours, layers)
        everything = [(name, array) for planes in used for name, array in planes.items()]
        if out is not None:
            everything.append(("out", out))
        for name, array in everything:
            if array.context != engine.context:
                raise FrameError(
                    f"{name} lies in another OpenCL context than this Denoiser's queue: "
                    "make the Denoiser with queue=color.queue, or copy the array"
                )
        waits = [event for _, array in everything for event in array.events]
        if waits:
            cl.enqueue_barrier(engine.queue, wait_for=waits)
        engine.start()
        shape = self.height, self.width, 3
        if out is None:
            out = cl_array.empty(engine.queue, shape, frame.color.dtype)
        others = [cl_array.empty(engine.queue, shape, layer.dtype) for layer in layers.values()]
        arrays = [{name: strided(array) for name, array in planes.items()} for planes in used]
        self._filter(arrays, tuple(layers), strided(out), [strided(array) for array in others])
        for array in (out, *others):
            array.add_event(cl.enqueue_marker(engine.queue))
        self._also = self._named(layers, others)
        return out

    def _filter(
        self, arrays: list[dict[str, Strided]], layers: tuple[str, ...], target: Strided, others: Sequence[Strided]
    ) -> None:
        """Fewer rows at a time until there is room for them; how many is remembered for the next frame.

        `arrays` are those of the frame and then those of each neighbour.
        """
        engine, method, p = self._engine, self.method, self.parameters
        self._last = self._merged = None  # what they keep takes room
        self._also = {}
        least = self._least_rows
        if len(arrays) > 1:
            least = min(self.height, max(least, least_rows_to_merge(engine)))
            self._rows = max(self._rows, least)
        while True:
            most = max(min(self._rows, most_rows(self.width, len(layers))), least)
            bad = engine.zeros(len(arrays[0]))
            source, merged = self._source(arrays[0], bad, most, layers), None
            try:
                if len(arrays) > 1:
                    near = [self._source(each, engine.zeros(len(each)), most) for each in arrays[1:]]
                    merged = merge(engine, source, near, method.takes(arrays[0]))
                    source = self._source(merged.arrays, engine.zeros(len(merged.arrays)), most)
                found = filter_frame(engine, method, source, p, target, others)
                break
            except NoRoomError as error:
                rows = fewer_rows(most, least)
                if rows is None:
                    raise self._no_room(error) from error
                self._rows = rows
            near = None
            del source, bad, merged
            engine.release()
        self._last = found, tuple(arrays[0]), bad
        self._merged = merged

    def _source(
        self, arrays: dict[str, Strided], bad: cl.MemoryObjectHolder, most: int, layers: tuple[str, ...] = ()
    ) -> Source:
        return Source(self._engine, arrays, self.height, self.width, bad, most, layers)

    @property
    def _least_rows(self) -> int:
        return min(self.height, least_rows(self._engine, self.method, self.parameters))

    def _no_room(self, error: NoRoomError) -> NoRoomError:
        """Even for a few rows."""
        if not isinstance(error, BudgetError):
            return error
        return NoRoomError(
            f"max_memory_mb is {self._engine.budget / 2**20:.0f}, which is no room for {self._rows} rows of "
            f"{self.width} pixels with method {self.method.name!r}: allow more, or choose a faster preset"
        )

    def _replaced(self, names: tuple[str, ...], bad: cl.MemoryObjectHolder) -> dict[str, int]:
        counts = np.empty(len(names), np.int32)
        cl.enqueue_copy(self.queue, counts, bad, is_blocking=True)
        return {name: int(count) for name, count in zip(names, counts, strict=True) if count}
