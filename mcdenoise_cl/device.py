"""Which OpenCL devices there are, which one to use, and what it can do."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import platformdirs
import pyopencl as cl

from . import program
from .errors import DeviceError

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


@dataclass(frozen=True)
class Shape:
    """How work is cut for a device: floats to a vector, pixels to a work-item's tile of the patch kernels."""

    width: int
    columns: int
    rows: int


def list_devices() -> list[DeviceInfo]:
    """Every device of every OpenCL runtime; an empty list when there is none.

    Raises:
        DeviceError: no OpenCL runtime is installed.
    """
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
        found += [_describe(len(found) + i, device) for i, device in enumerate(devices)]
    return found


def _describe(index: int, device: cl.Device) -> DeviceInfo:
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


def pick_device(choice: str | int | cl.Device | None = None) -> DeviceInfo:
    """The device to use.

    Args:
        choice: an index of `list_devices`, part of a device's or runtime's name (case does not matter), a
            `pyopencl.Device`, or None for the environment variable `MCDENOISE_DEVICE` and, without it, the
            default: the first GPU, else the fastest CPU runtime.

    Raises:
        DeviceError: there is no device, or none that fits `choice`.
    """
    devices = list_devices()
    if not devices:
        raise DeviceError(f"OpenCL is installed but has no device: {INSTALL_HINT}")
    if isinstance(choice, cl.Device):
        return next((info for info in devices if info.device == choice), None) or _describe(-1, choice)
    origin = "device"
    if choice is None:
        choice, origin = os.environ.get(DEVICE_VARIABLE) or None, f"environment variable {DEVICE_VARIABLE}"
    if choice is None:
        return _default(devices)
    text = str(choice).strip()
    if text.lstrip("-").isdigit():
        matches = [info for info in devices if info.index == int(text)]
    else:
        matches = [info for info in devices if text.lower() in f"{info.name} {info.runtime} {info.version}".lower()]
    if not matches:
        known = "; ".join(f"{info.index}: {info.name} ({info.runtime}, {info.version})" for info in devices)
        raise DeviceError(f"{origin} is {text!r}, which is none of the devices here: choose one of {known}")
    return matches[0]


def _default(devices: list[DeviceInfo]) -> DeviceInfo:
    gpus = [info for info in devices if info.kind == "GPU"]
    others = [info for info in devices if info.kind == "CPU"] or devices
    if gpus or len(others) == 1:
        return (gpus or others)[0]
    seconds = _measured_seconds(others)
    return min(others, key=lambda info: seconds[_identity(info)])


def shape_for(device: cl.Device) -> Shape:
    """Vector width and tile for a device.

    A CPU runtime gets wide tiles of explicit vectors, whose scratch (about 30 KB with the widest tile) stays in a
    core's first-level cache and well inside the smallest stack seen; any other device gets one pixel column a
    work-item, and its own compiler makes the vectors.
    """
    if device.type & cl.device_type.CPU:
        return Shape(width=max(4, min(16, device.native_vector_width_float)), columns=64, rows=16)
    return Shape(width=1, columns=1, rows=4)


_contexts: dict[cl.Device, cl.Context] = {}
_lock = threading.Lock()


def context_for(device: cl.Device) -> cl.Context:
    """One context a device and process: making one takes long on some drivers."""
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


def _identity(info: DeviceInfo) -> str:
    return f"{info.runtime} | {info.version} | {info.driver} | {info.name} | {info.compute_units}"


def _measured_seconds(devices: list[DeviceInfo]) -> dict[str, float]:
    """Seconds of one small denoising kernel on each device, measured once a machine and kept in the user's cache."""
    identities = [_identity(info) for info in devices]
    digest = hashlib.sha256("\n".join(identities).encode()).hexdigest()[:16]
    path = Path(platformdirs.user_cache_dir("mcdenoise-cl")) / f"runtimes-{digest}.json"
    try:
        known = {str(name): float(seconds) for name, seconds in json.loads(path.read_text()).items()}
        if set(known) == set(identities):
            return known
    except (OSError, ValueError, AttributeError, TypeError):
        pass  # absent, broken or written by another version: measure again
    known = {identity: _time(info.device) for identity, info in zip(identities, devices, strict=True)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as file:
            json.dump({name: seconds if seconds < float("inf") else 1e30 for name, seconds in known.items()}, file)
        Path(file.name).replace(path)
    except OSError:
        pass  # a read-only home only means measuring again next time
    return known


def _time(device: cl.Device) -> float:
    """Best of five runs of the NLM kernel on a 256x128 image of zeros; infinity where it does not run."""
    shape = shape_for(device)
    height, width, border = 128, 256, 5
    row = width + 2 * border + 16
    plane = row * (height + 2 * border)
    try:
        context = context_for(device)
        queue = cl.CommandQueue(context)
        defines = {"WIDTH": shape.width, "COLUMNS": shape.columns, "ROWS": shape.rows, "PATCH_RADIUS": 2}
        kernel = cl.Kernel(program.build(context, "nlm.cl", defines), "nlm")
        image = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * 3 * plane)
        taps = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * 5)
        for buffer in (image, taps):
            cl.enqueue_fill_buffer(queue, buffer, np.float32(0), 0, buffer.size)
        planes = (image, np.int32(border * row + border), np.int32(row), np.int32(plane))
        out = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * 3 * width * height)
        target = (out, np.int32(0), np.int32(width), np.int32(width * height))
        size = (width // shape.columns, height // shape.rows)
        best = float("inf")
        for _ in range(5):
            queue.finish()
            start = time.perf_counter()
            kernel(
                queue,
                size,
                (1, 1) if shape.columns > 1 else None,
                *planes,
                *planes,
                np.int32(height),
                np.int32(width),
                np.int32(3),
                taps,
                taps,
                np.float32(1),
                *target,
            )
            queue.finish()
            best = min(best, time.perf_counter() - start)
        return best
    except (cl.Error, DeviceError):
        return float("inf")
