"""Small frames that together launch every kernel: for simulators, which are slow.

`python tests/small_frames.py NAME` runs one of them on the device that `mcdenoise_cl` picks, in the schedule that
MCDENOISE_SCHEDULE names; tests/simulator.py runs all of them under oclgrind.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any
from unittest import mock

import inputs
import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
from transfer import to_array, to_planes

from mcdenoise_cl import engine
from mcdenoise_cl.api import Denoiser
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import Shape, context_for, shape_for
from mcdenoise_cl.engine import Engine, Planes
from mcdenoise_cl.frame import Frame
from mcdenoise_cl.program import kernel_folder
from mcdenoise_cl.stages import box, box_fit
from mcdenoise_cl.stages.pad import pad
from mcdenoise_cl.stages.ssim import patch_ssim, patch_statistics
from mcdenoise_cl.stages.terms import BLOCK_COLUMNS, BLOCK_ROWS

FEATURES = ("albedo", "normal", "depth")
VARIANCES = tuple(f"{name}_variance" for name in FEATURES)
HALVES = ("color_a", "color_b")
KNOWN = "color_variance"

#: (height, width): more than one tile or group in each direction and no multiple of any, with those of `small_shape`
#: and with those of devices.
SMALL, WHOLE = (5, 11), (17, 67)


@dataclass(frozen=True)
class Case:
    """One call: a method, the planes it gets besides the colour, their dtype, parameters that keep it short, how many
    further layers are filtered with the colour, and the neighbours: None for one that is searched for, or how far it
    has moved. `quiet` is for little noise in the colour."""

    method: str
    planes: tuple[str, ...] = ()
    dtype: str = "f4"
    packed: bool = True
    parameters: dict[str, Any] = field(default_factory=dict)
    layers: int = 0
    neighbours: tuple[float | None, ...] = ()
    quiet: bool = False


NLM = {"search_radius": 1, "patch_radius": 1}
FIT = {"search_radius": 2, "patch_radius": 1}
AUTO = {**FIT, "wide_radius": 1, "wide_stride": 2, "spread_radius": 32}

CASES = {
    "nlm": Case("nlm", parameters=NLM, layers=2),
    "nlm-linear": Case("nlm", dtype="f2", parameters={**NLM, "average": "linear", "curve": "clip", "center": "one"}),
    "nlm-tonemapped": Case("nlm", packed=False, parameters={**NLM, "average": "tonemapped", "exposure": 0.5}, layers=1),
    "ssim-nlm": Case("ssim-nlm", FEATURES, parameters=NLM),
    "ssim-nlm-printed": Case(
        "ssim-nlm",
        FEATURES,
        parameters={**NLM, "stabilised": False, "canny_low": 0.1, "canny_high": 0.3, "canny_sigma": 0.0},
    ),
    "regression-color": Case("regression", parameters={**FIT, "outliers": False}),
    "regression-depth": Case("regression", ("depth",), packed=False, parameters={**FIT, "spread_radius": 2}, layers=1),
    "regression": Case("regression", (*FEATURES, *VARIANCES, KNOWN), parameters=FIT),
    "guided-color": Case("guided", parameters={"outliers": False}),
    "guided-exact": Case("guided", FEATURES, dtype="f8", parameters={"block": 1, "radius": 1}),
    "guided": Case("guided", (*FEATURES, *VARIANCES, KNOWN), parameters={"residual_radius": 5}, layers=1),
    "guided-prefilter": Case(
        "guided", (*FEATURES, "normal_variance", *HALVES), parameters={"prefilter": True, "block": 3}
    ),
    "auto-color": Case("auto", parameters=AUTO),
    "auto-halves": Case("auto", ("normal", "normal_variance", *HALVES), dtype="f2", parameters=AUTO, layers=1),
    "auto": Case("auto", (*FEATURES, *VARIANCES, *HALVES, KNOWN), parameters=AUTO),
    "temporal": Case("guided", (*FEATURES, *VARIANCES, *HALVES, KNOWN), neighbours=(None, 1.3)),
    "temporal-color": Case("nlm", dtype="f2", packed=False, parameters=NLM, neighbours=(None,)),
    "auto-quiet": Case("auto", ("depth", KNOWN), parameters=AUTO, layers=1, quiet=True),
    "auto-quiet-halves": Case("auto", HALVES, dtype="f2", parameters=AUTO, quiet=True),
    "auto-inliers": Case("auto", ("albedo", *HALVES), parameters={**AUTO, "outliers": False}),
}

NAMES = (*CASES, "ssim")


def frame(height: int, width: int, quiet: bool = False) -> dict[str, np.ndarray]:
    """Every plane that a frame can have, float32, with two pixels that are not finite; no blue tells anything."""
    planes = inputs.features(height, width)
    planes["albedo"][..., 2] = 0.5
    rng = np.random.default_rng([height, width])
    for name, noise in (("color", 0.004 if quiet else 0.2), ("albedo", 0.02), ("normal", 0.05), ("depth", 0.01)):
        squares = rng.gamma(4.0, 0.25, planes[name].shape)
        planes[f"{name}_variance"] = ((noise * planes[name]) ** 2 * squares + 1e-6).astype(np.float32)
    half = np.sqrt(planes["color_variance"]) * rng.standard_normal(planes["color"].shape).astype(np.float32)
    planes["color_a"], planes["color_b"] = planes["color"] + half, planes["color"] - half
    planes["color"][height // 2, width // 3] = np.nan
    planes["color"][-1, -1, 0] = np.inf
    return planes


def small_shape(shape: Shape) -> Shape:
    """Tiles and groups of 8x4 pixels, so that small frames have seams."""
    return replace(shape, width=min(shape.width, 4), tile=(8, 4), deep=(8, 4), group=(8, 4))


@contextmanager
def tight() -> Iterator[None]:
    """Planes end with a block of `terms`, than which nothing in `small_shape` is wider, so that what lies beyond shows;
    and what a group transposes at a time, or a work-item of `box_fit` takes, is as small."""
    planes = mock.patch.multiple(engine, COLUMNS=BLOCK_COLUMNS, ROWS=BLOCK_ROWS, _SLACK=4)
    with planes, mock.patch.object(box, "GROUP_BLOCK", 4), mock.patch.multiple(box_fit, CHUNK=8, TILES=1, ROWS=2):
        yield


def run_case(queue: cl.CommandQueue, case: Case, size: tuple[int, int] = SMALL, small: bool = True) -> dict[str, Any]:
    """Everything that one case makes of a frame: the image, its layers, both maps and the numbers of the report.

    The planes go to the device first: some simulators take the host's own memory for uninitialised. `small` cuts the
    work as `small_shape` says; else as the device wants it.
    """
    wanted, source = ("color", *case.planes), frame(*size, quiet=case.quiet)
    planes = {plane: _on_device(queue, image, case) for plane, image in source.items() if plane in wanted}
    near = []
    for move in case.neighbours:
        known = {} if move is None else {"motion": _on_device(queue, np.full((*size, 2), move), case)}
        copies = {
            plane: _on_device(queue, 1.1 * image, case) for plane, image in frame(*size).items() if plane in wanted
        }
        near.append(Frame(**copies, **known))
    denoiser = Denoiser(*size, method=case.method, queue=queue, **case.parameters)
    if small:
        denoiser.use_shape(small_shape(shape_for(queue.device)))
    # Neither the planes nor the result go before the end: see `fresh` on what oclgrind makes of freed buffers.
    shares = np.linspace(0.1, 0.9, size[1], dtype=case.dtype)[:, None] / max(case.layers, 1)
    layers = {str(i): _on_device(queue, frame(*size)["color"] * shares, case) for i in range(case.layers)}
    result = denoiser(Frame(**planes), also=layers, neighbours=near)
    image, report = result.get(), denoiser.report
    found = {"image": image, "model_map": denoiser.model_map, "error_map": denoiser.error_map}
    numbers = (report.exposure, report.noise_level, report.energy_removed, report.estimated_error, report.merged)
    found |= {f"layer {name}": layer.get() for name, layer in denoiser.also.items()}
    found |= {"numbers": np.array(numbers, float), "replaced": report.replaced}
    return found | {"shares": report.shares, "features_used": report.features_used}


def _on_device(queue: cl.CommandQueue, image: np.ndarray, case: Case) -> cl_array.Array:
    # Without double precision a device takes single.
    double = case.dtype == "f8" and "cl_khr_fp64" in queue.device.extensions
    image = image.astype(case.dtype if case.dtype != "f8" or double else "f4")
    if case.packed:
        return cl_array.to_device(queue, image)
    return cl_array.to_device(queue, np.repeat(image, 2, axis=1))[:, ::2]


def run_ssim(queue: cl.CommandQueue, size: tuple[int, int] = SMALL, small: bool = True) -> dict[str, Any]:
    """The map of SSIM for one offset, which is on no way from the door to the exit."""
    own = Engine(queue)
    if small:
        own.use_shape(small_shape(own.shape))
    unit = pad(own, to_planes(own, 0.5 + 0.5 * frame(*size)["normal"]), 3)
    stats = pad(own, patch_statistics(own, unit, 1), 3)
    return {"image": to_array(own, patch_ssim(own, unit, stats, 1, -2, 1, 1e-4, 9e-4))}


def kernels() -> set[tuple[str, str]]:
    """(file, name) of every kernel that there is."""
    head = re.compile(r"^(?:GROUP_)?KERNEL\b.*?\bvoid (\w+)\(", re.DOTALL | re.MULTILINE | re.IGNORECASE)
    return {(file.name, name) for file in kernel_folder().glob("*.cl") for name in head.findall(file.read_text())}


@contextmanager
def recorded() -> Iterator[set[tuple[str, str]]]:
    """(file, name) of every kernel that is launched meanwhile."""
    launched: set[tuple[str, str]] = set()
    files: dict[int, str] = {}
    made, launch = Engine.kernel, Engine.launch

    def kernel(self: Engine, file: str, *arguments, **defines) -> cl.Kernel:
        found = made(self, file, *arguments, **defines)
        files[found.int_ptr] = file
        return found

    def noted(self: Engine, stage: str, kernel: cl.Kernel, *arguments, **options) -> None:
        launch(self, stage, kernel, *arguments, **options)
        launched.add((files[kernel.int_ptr], kernel.function_name))

    with mock.patch.object(Engine, "kernel", kernel), mock.patch.object(Engine, "launch", noted):
        yield launched


@contextmanager
def filled(value: float) -> Iterator[None]:
    """Memory that the engine hands out meanwhile holds this value, which so must not reach any result."""
    memory = Engine.memory

    def full(self: Engine, size: int) -> cl.MemoryObjectHolder:
        buffer = memory(self, size)
        cl.enqueue_fill_buffer(self.queue, buffer, np.float32(value), 0, size // 4 * 4)
        return buffer

    with mock.patch.object(Engine, "memory", full):
        yield


#: Fills what lies between an image and its next whole tile. A kernel, as oclgrind 21.10 does not see other ways to fill
#: part of a buffer.
MARGINS = """
kernel void margins(global float *planes, int row, int plane, int height, int width)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        planes[c * plane + y * row + x] = NAN;
}
"""


@contextmanager
def fresh(queue: cl.CommandQueue) -> Iterator[None]:
    """Memory that the engine hands out meanwhile is new, so that a simulator knows that nothing has been written to it.

    Only between an image and its next whole tile may be read what was never written, as vectors are: there is NaN.
    """
    margins = cl.Kernel(cl.Program(queue.context, MARGINS).build(), "margins")
    planes = Engine.planes
    kept: list[cl.Buffer] = []  # oclgrind 21.10 takes what it knows of a freed buffer for that of the next one

    def memory(self: Engine, size: int) -> cl.Buffer:
        kept.append(cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size))
        return kept[-1]

    def zeros(self: Engine, count: int) -> cl.Buffer:
        kept.append(cl.Buffer(self.context, cl.mem_flags.COPY_HOST_PTR, hostbuf=np.zeros(count, np.int32)))
        return kept[-1]

    def with_margins(self: Engine, channels: int, height: int, width: int, border: int = 0) -> Planes:
        out = planes(self, channels, height, width, border)
        if not border:  # `pad` writes all of those that have one
            numbers = (np.int32(number) for number in (out.row, out.plane, height, width))
            margins(self.queue, (out.row, out.plane // out.row, channels), None, out.buffer, *numbers)
        return out

    with mock.patch.multiple(Engine, memory=memory, zeros=zeros, planes=with_margins):
        yield
        queue.finish()


def run(name: str, queue: cl.CommandQueue, **how: Any) -> dict[str, Any]:
    """All that is found of one case: see `run_case`, or `run_ssim` for the name "ssim"."""
    with tight() if how.get("small", True) else nullcontext():
        return run_ssim(queue, **how) if name == "ssim" else run_case(queue, CASES[name], **how)


if __name__ == "__main__":
    device = pick_device().device
    queue = cl.CommandQueue(context_for(device), device)
    with fresh(queue):
        whole = "--whole" in sys.argv
        run(sys.argv[1], queue, size=WHOLE if whole else SMALL, small=not whole)
