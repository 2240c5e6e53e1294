"""Which OpenCL devices there are, and what each can do."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import threading
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field
from functools import cache

import pyopencl as cl

from . import pocl_cache
from .errors import DeviceError
from .measured import recall

#: Environment variable that chooses the device when no argument does: an index, or part of a name.
DEVICE_VARIABLE = "MCDENOISE_DEVICE"
INSTALL_HINT = (
    "install a GPU driver with OpenCL, or for the CPU PoCL: pip install 'mcdenoise-cl[cpu]', "
    "or on Debian and Ubuntu: apt-get install pocl-opencl-icd"
)


@dataclass(frozen=True)
class DeviceInfo:
    """One OpenCL device, as `mcdenoise devices` lists it.

    Attributes:
        index: position in the list, over all runtimes.
        name, runtime, version, driver: as the runtime reports them.
        kind: "GPU", "CPU" or "accelerator".
        compute_units: cores or multiprocessors.
        memory: bytes of global memory.
        device: the `pyopencl.Device`.
    """

    index: int
    name: str
    runtime: str
    version: str
    driver: str
    kind: str
    compute_units: int
    memory: int
    device: cl.Device = field(repr=False)


#: Environment variable that forces one of SCHEDULES on every device.
SCHEDULE_VARIABLE = "MCDENOISE_SCHEDULE"
SCHEDULES = ("tile", "group")

#: Work-items along a row. On PoCL 64 to 512 are alike and as fast as what it would choose itself; with several rows to
#: a group the cheap kernels take up to twice as long.
PIECE = 128


@dataclass(frozen=True)
class Shape:
    """How work is cut for a device.

    Attributes:
        schedule: "tile", a work-item filters a tile of pixels with explicit vectors (CPUs); or "group", a work-group
            filters one, a pixel or a few to a work-item, and shares what it needs in local memory (GPUs).
        width: floats to a vector; 1 in the group schedule.
        tile: (columns, rows) of pixels to a work-item of the patch kernels.
        deep: the same for kernels that keep a value for each offset of the search window.
        group: (columns, rows) of work-items to a work-group of the group schedule.
    """

    schedule: str
    width: int
    tile: tuple[int, int]
    deep: tuple[int, int]
    group: tuple[int, int]

    @property
    def plain(self) -> tuple[int, int]:
        """(columns, rows) of work-items to a work-group of kernels that leave it open: on CPUs a piece of a row, of
        which the compiler makes vectors."""
        return (PIECE, 1) if self.schedule == "tile" else self.group


def list_devices() -> list[DeviceInfo]:
    """Every device of every OpenCL runtime; an empty list when there is none.

    Raises:
        DeviceError: no OpenCL runtime is installed.
    """
    pocl_cache.prepare()
    try:
        platforms = cl.get_platforms()
    except cl.Error as error:  # the loader found no runtime
        raise DeviceError(f"no OpenCL runtime was found: {INSTALL_HINT}") from error
    found: list[DeviceInfo] = []
    for platform in platforms:
        try:
            devices = platform.get_devices()
        except cl.Error:  # a runtime without a device of its kind in this machine
            continue
        for device in devices:
            with contextlib.suppress(cl.Error):  # a device that is gone answers no question
                found.append(describe(len(found), device))
    return found


def describe(index: int, device: cl.Device) -> DeviceInfo:
    kinds = {cl.device_type.GPU: "GPU", cl.device_type.CPU: "CPU"}
    kind = next((name for flag, name in kinds.items() if device.type & flag), "accelerator")
    return DeviceInfo(
        index=index,
        name=device.name.strip(),
        runtime=device.platform.name.strip(),
        version=device.version.strip(),
        driver=device.driver_version.strip(),
        kind=kind,
        compute_units=device.max_compute_units,
        memory=device.global_mem_size,
        device=device,
    )


def shape_for(device: cl.Device) -> Shape:
    """Schedule, vector width and tiles for a device: what `mcdenoise tune` found best, else the first of `shapes`.

    Raises:
        DeviceError: MCDENOISE_SCHEDULE names no schedule.
    """
    possible = shapes(device)
    found = recall(identity(describe(-1, device)))
    return next((shape for shape in possible if shape_as_text(shape) == found), possible[0])


def shapes(device: cl.Device) -> list[Shape]:
    """The shapes that suit a device, the one to expect most of first.

    The tile schedule, for CPU runtimes, takes wide tiles of explicit vectors, whose scratch stays in a core's caches
    and well inside the smallest stack seen: about 220 KB with the widest tile, half a megabyte with the largest deep
    one. The group schedule is for anything else, whose own compiler makes the vectors. A group lies in one block of
    `terms`.

    Raises:
        DeviceError: MCDENOISE_SCHEDULE names no schedule.
    """
    cpu = bool(device.type & cl.device_type.CPU) and most_turns(device) is None
    schedule = os.environ.get(SCHEDULE_VARIABLE) or ("tile" if cpu else "group")
    if schedule not in SCHEDULES:
        raise DeviceError(
            f"environment variable {SCHEDULE_VARIABLE} is {schedule!r}: set it to {' or '.join(SCHEDULES)}, or unset it"
        )
    groups = [group for group in ((32, 8), (16, 8), (32, 4), (16, 4)) if math.prod(group) <= device.max_work_group_size]
    groups = groups or [(1, 1)]
    if schedule == "group":
        return [Shape("group", width=1, tile=(1, 4), deep=(1, 1), group=group) for group in groups]
    width = max(4, min(16, device.native_vector_width_float))
    if width == 16 and "PoCL" in device.version and not _compiles_for_avx512(device):
        width = 8
    tiles, deep = ((64, 16), (32, 16), (64, 8), (32, 8)), ((32, 8), (16, 8), (32, 4))
    return [Shape("tile", width, tile, each, groups[0]) for tile in tiles for each in deep]


def most_turns(device: cl.Device) -> int | None:
    """After how many turns in all the loops of a work-item end, right or wrong and without a word; None for never.

    Mesa's rasteriser does so (tests/upstream/rusticl_loops.py): too few for a tile, enough for a work-item of a group.
    """
    return 65535 if device.type & cl.device_type.CPU and "rusticl" in device.platform.name else None


@cache
def _compiles_for_avx512(device: cl.Device) -> bool:
    """Whether PoCL's compiler knows all of the processor: an older LLVM takes a newer processor for an older one.

    It has no registers then for the 16 floats that PoCL promises, and ends the process at some kernels that ask for
    them.
    """
    source = "#ifdef __AVX512F__\nkernel void wide() {}\n#else\nkernel void narrow() {}\n#endif"
    pocl_cache.mend()
    program = cl.Program(context_for(device), source).build(cache_dir=False)
    return "wide" in program.kernel_names


def shape_as_text(shape: Shape) -> str:
    """As it is remembered."""
    return json.dumps(astuple(shape))


def identity(info: DeviceInfo) -> str:
    """A device and what drives it, in words: what measurements on it are remembered under."""
    return f"{info.runtime} | {info.version} | {info.driver} | {info.name} | {info.compute_units}"


_contexts: dict[cl.Device, cl.Context] = {}
_lock = threading.Lock()


def context_for(device: cl.Device) -> cl.Context:
    """One context a device and process: making one takes long on some drivers.

    Raises:
        DeviceError: the device cannot be opened, or is a PoCL that could not link its kernels or keep them.
    """
    if "PoCL" in device.version:
        # What PoCL would not report but end the process for.
        if shutil.which("ld") is None:
            raise DeviceError(
                "PoCL links its kernels with the system's linker, ld, which is missing: "
                "on Debian and Ubuntu, apt-get install gcc libc6-dev"
            )
        pocl_cache.check_room()
    with _lock:
        if device not in _contexts:
            try:
                _contexts[device] = cl.Context([device])
            except cl.Error as error:
                raise DeviceError(
                    f"device {device.name.strip()} cannot be opened ({error}): choose another with device=..., "
                    f"--device or {DEVICE_VARIABLE}"
                ) from error
        return _contexts[device]


@contextlib.contextmanager
def device_errors(name: str, device: cl.Device | None = None) -> Iterator[None]:
    """What OpenCL raises while it works, for instance because the device was unplugged or reset, as a `DeviceError`.

    Args:
        name: of the device, asked for while it was there.
        device: whose context is not handed out again after such an error, so that whoever tries again starts afresh.
    """
    try:
        yield
    except cl.Error as error:
        with _lock:
            _contexts.pop(device, None)
        short = error.code in (cl.status_code.OUT_OF_RESOURCES, cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE)
        hint = "denoise a smaller frame if that is too large for it" if short else "try again with a new Denoiser"
        raise DeviceError(
            f"{name} failed ({error}): see with `mcdenoise devices` whether it is still there, and {hint}, or choose "
            f"another with device=..., --device or {DEVICE_VARIABLE}"
        ) from error
