"""How fast frames go from file to file, beside each part of the way alone; and whether memory stays flat.

    python bench/throughput.py [--size 1280 720] [--frames 24] [--preset fast] [--device all] [--folder TMP]

Frames are made up: a synthetic room with features, noise and its variance, tiled, written as ZIP-compressed EXR. Each
part (reading, denoising with upload and download, writing) is timed alone over the same frames, then the whole with
everything at once. The whole cannot be faster than its slowest part, nor than all the work of the CPU spread over its
cores: on a GPU the first counts, on a CPU runtime the second, because denoising takes the same cores.

Memory is that of the process, after a quarter, a half and all of the frames of the last run.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import sys
import tempfile
import threading
import time
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mcdenoise_cl import Frame, write_exr
from mcdenoise_cl.choose import pick_devices
from mcdenoise_cl.denoisers import Denoisers
from mcdenoise_cl.job import Job, Recipe, read_job, write_job
from mcdenoise_cl.pipeline import helpers, run_jobs
from mcdenoise_cl.selection import find_jobs

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import inputs

DIFFERENT = 4


@dataclass(frozen=True)
class Time:
    """Seconds a frame: by the clock, and of the CPU, all threads of the process together."""

    wall: float
    cpu: float


def make_frames(folder: Path, count: int, width: int, height: int) -> None:
    """`count` files, of which a few differ: the others are copies, which take as long to read."""
    tile = inputs.features(min(height, 540), min(width, 960))
    times = -(-height // tile["depth"].shape[0]), -(-width // tile["depth"].shape[1])
    rng = np.random.default_rng(0)
    for number in range(count):
        path = folder / f"frame.{number:04d}.exr"
        if number >= DIFFERENT:
            shutil.copyfile(folder / f"frame.{number % DIFFERENT:04d}.exr", path)
            continue
        planes = {name: np.tile(plane, times + (1,) * (plane.ndim - 2)) for name, plane in tile.items()}
        planes = {name: np.ascontiguousarray(plane[:height, :width]) for name, plane in planes.items()}
        planes["color"] *= rng.gamma(4, 0.25, planes["color"].shape).astype(np.float32)
        variance = 0.25 * planes["color"] ** 2 + np.float32(1e-6)
        write_exr(path, Frame(**planes, color_variance=variance))


def timed(work: Callable[[], object], count: int) -> Time:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    return Time((time.perf_counter() - wall) / count, (time.process_time() - cpu) / count)


def parts_alone(jobs: Sequence[Job], recipe: Recipe, denoisers: Denoisers) -> dict[str, Time]:
    """Each part over all jobs, one after the other; the first frames are kept for those that need them."""
    few = [read_job(job, recipe) for job in jobs[:DIFFERENT]]
    clean = [denoisers.denoise(material, recipe) for material in few]  # also makes programs and memory ready
    return {
        "read": timed(lambda: [read_job(job, recipe) and None for job in jobs], len(jobs)),
        "denoise": timed(
            lambda: [denoisers.denoise(few[i % DIFFERENT], recipe) and None for i in range(len(jobs))], len(jobs)
        ),
        "write": timed(
            lambda: [write_job(job, recipe, few[i % DIFFERENT], clean[i % DIFFERENT]) for i, job in enumerate(jobs)],
            len(jobs),
        ),
    }


def cores_given(wanted: int) -> float:
    """How many cores as many busy threads get: fewer than there are where the machine has other work."""
    data = os.urandom(2**20)

    def work() -> None:
        until = time.perf_counter() + 1
        while time.perf_counter() < until:
            zlib.compress(data)

    threads = [threading.Thread(target=work) for _ in range(wanted)]
    wall, cpu = time.perf_counter(), time.process_time()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return (time.process_time() - cpu) / (time.perf_counter() - wall)


def resident() -> float:
    """MiB in memory now; what was the most where the system does not say."""
    statm = Path("/proc/self/statm")
    if statm.exists():
        return int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", nargs=2, type=int, default=(1280, 720), metavar=("W", "H"))
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--device", default=None, help="as for the command; also all")
    parser.add_argument("--folder", type=Path, default=None, help="where to put the frames; a temporary folder")
    options = parser.parse_args()
    devices = [info.device for info in pick_devices(options.device)]
    recipe = Recipe.of(preset=options.preset)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with tempfile.TemporaryDirectory(dir=options.folder) as temporary:
        source, target = Path(temporary, "in"), Path(temporary, "out")
        source.mkdir()
        make_frames(source, options.frames, *options.size)
        jobs = find_jobs([source], target)
        parts = parts_alone(jobs, recipe, Denoisers(devices[0]))
        seen: list[float] = []
        given = cores_given(cores)
        whole = timed(
            lambda: run_jobs(jobs, recipe, devices, overwrite=True, on_progress=lambda _: seen.append(resident())),
            len(jobs),
        )
        given = (given + cores_given(cores)) / 2
    width, height = options.size
    names = ", ".join(f"{device.name.strip()} ({device.platform.name.strip()})" for device in devices)
    print(f"{options.frames} frames of {width} x {height}, {recipe.method}, on {names}; {cores} cores, of which")
    print(f"busy threads got {given:.2f} before and after the whole (fewer where the machine has other work)")
    reading, writing = helpers()
    print(f"{reading} reading, {writing} writing beside the device\n")
    print("| part | ms a frame | ms of CPU a frame |\n|:---|---:|---:|")
    for name, taken in {**parts, "whole": whole}.items():
        print(f"| {name} | {1e3 * taken.wall:.0f} | {1e3 * taken.cpu:.0f} |")
    one_by_one = sum(part.wall for part in parts.values())
    slowest = max(parts, key=lambda name: parts[name].wall)
    shared = sum(part.cpu for part in parts.values()) / given
    print(f"\none after the other: {1e3 * one_by_one:.0f} ms a frame, {one_by_one / whole.wall:.2f} times the whole")
    print(f"the slowest part alone, {slowest}: the whole takes {whole.wall / parts[slowest].wall:.2f} times as long")
    bound = max(shared, parts[slowest].wall)
    work = f"{1e3 * shared:.0f} ms for the work of all parts on these cores"
    print(f"the bound, {1e3 * bound:.0f} ms ({work}): {whole.wall / bound:.2f} times")
    quarter, half = seen[len(seen) // 4 - 1], seen[len(seen) // 2 - 1]
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"MiB in memory: {quarter:.0f} after a quarter, {half:.0f} after a half, {seen[-1]:.0f} at the end", end="")
    print(f"; the most at any time {most:.0f}")


if __name__ == "__main__":
    main()
