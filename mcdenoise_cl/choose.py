"""Which OpenCL device to use: what the user says, else the first GPU, else the CPU runtime that is fastest here."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np
import pyopencl as cl

from .device import DEVICE_VARIABLE, INSTALL_HINT, DeviceInfo, context_for, describe, identity, list_devices
from .engine import Engine
from .errors import DeviceError
from .measured import recall, remember
from .stages.nlm import nlm
from .stages.pad import pad

#: What `pick_devices` takes for every device.
ALL = "all"


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
        return next((info for info in devices if info.device == choice), None) or describe(-1, choice)
    origin = "device"
    if choice is None:
        choice, origin = os.environ.get(DEVICE_VARIABLE) or None, f"environment variable {DEVICE_VARIABLE}"
    if choice is None:
        return _default(devices)
    text = str(choice).strip()
    if text.removeprefix("-").isdecimal():
        matches = [info for info in devices if str(info.index) == text]
    else:
        matches = [
            info for info in devices if text and text.lower() in f"{info.name} {info.runtime} {info.version}".lower()
        ]
    if not matches:
        known = "; ".join(f"{info.index}: {info.name} ({info.runtime}, {info.version})" for info in devices)
        raise DeviceError(f"{origin} is {text!r}, which is none of the devices here: choose one of {known}")
    return matches[0]


def pick_devices(choice: Any = None) -> list[DeviceInfo]:
    """The devices to share the work: "all" there are, those of a list, or the one that `pick_device` picks.

    Raises:
        DeviceError: there is no device, or none that fits a choice.
    """
    if isinstance(choice, str) and choice.strip().lower() == ALL:
        return list_devices() or [pick_device()]
    if isinstance(choice, list | tuple) and choice:
        return [pick_device(one) for one in choice]
    return [pick_device(choice)]


def _default(devices: list[DeviceInfo]) -> DeviceInfo:
    gpus = [info for info in devices if info.kind == "GPU"]
    others = [info for info in devices if info.kind == "CPU"] or devices
    if gpus or len(others) == 1:
        return (gpus or others)[0]
    seconds = _measured_seconds(others)
    return min(others, key=lambda info: seconds[identity(info)])


def _measured_seconds(devices: list[DeviceInfo]) -> dict[str, float]:
    """Seconds of one small denoising kernel on each device, measured once a machine and remembered."""
    identities = [identity(info) for info in devices]
    key = "runtimes " + "; ".join(identities)
    try:
        known = {str(name): float(seconds) for name, seconds in recall(key).items()}
        if set(known) == set(identities):
            return known
    except (ValueError, AttributeError, TypeError):
        pass  # absent, or written by another version: measure again
    known = {name: _time(info.device) for name, info in zip(identities, devices, strict=True)}
    remember(key, {name: min(seconds, 1e30) for name, seconds in known.items()})
    return known


def _time(device: cl.Device) -> float:
    """Seconds of NLM on 256x128 zeros, the best of five runs; infinity where it does not run."""
    try:
        engine = Engine(cl.CommandQueue(context_for(device), device))
        image = engine.planes(3, 128, 256)
        cl.enqueue_fill_buffer(engine.queue, image.buffer, np.float32(0), 0, 4 * image.channels * image.plane)
        image = pad(engine, image, 5)
        windows = {"search_radius": 3, "patch_radius": 2, "patch_sigma": 1.0}
        best = float("inf")
        for _ in range(5):
            engine.queue.finish()
            start = time.perf_counter()
            nlm(engine, image, image, **windows, noise_level=engine.constant([1.0]), h_factor=1.0)
            engine.queue.finish()
            best = min(best, time.perf_counter() - start)
        return best
    except (cl.Error, DeviceError):
        return float("inf")
