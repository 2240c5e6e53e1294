"""How long every method and every peer takes, side by side in one run.

    python bench/speed.py --size 1280 720

One frame (the first with the fewest samples, or a rendered one) is continued by its mirror images to the size asked
for. Each denoiser is made ready and run once; then all take turns, and the table shows the median and the fastest of
the whole calls (from host memory to host memory) and, for ours, the milliseconds on the device.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from frames import add_arguments, chosen_cases
from peers import all_peers, installed

from mcdenoise_cl import Denoiser, Frame, methods
from mcdenoise_cl.choose import pick_device


@dataclass(frozen=True)
class Time:
    """Seconds of the whole calls of one denoiser, and the device's share of the fastest; None for peers."""

    name: str
    calls: list[float]
    device: float | None


def enlarged(frame: Frame, width: int, height: int) -> Frame:
    """The frame continued by its mirror images, or cut, to a size."""
    planes = {}
    for name, plane in frame.planes().items():
        missing = [(0, max(0, n - have)) for n, have in zip((height, width), plane.shape, strict=False)]
        planes[name] = np.pad(plane, missing + [(0, 0)] * (plane.ndim - 2), mode="symmetric")[:height, :width]
    return Frame(**{name: np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()})


def measure(frame: Frame, exposure: float, rounds: int) -> tuple[list[Time], list[str]]:
    """Every method and every installed peer, in turns; and notes on what is missing."""
    peers, notes = installed(all_peers())
    device = pick_device().device
    runs: dict[str, Callable[[], object]] = {}
    ours: dict[str, Denoiser] = {}
    with ExitStack() as stack:
        for method in methods():
            ours[method.name] = Denoiser(*frame.shape, method=method.name, device=device)
            out = np.empty_like(frame.color)
            runs[method.name] = lambda denoiser=ours[method.name], out=out: denoiser(frame, out=out)
        for peer in peers:
            if all(plane in frame.planes() for plane in peer.needs):
                runs[peer.name] = stack.enter_context(peer.opened(frame, exposure))
        calls: dict[str, list[float]] = {name: [] for name in runs}
        on_device: dict[str, float] = {}
        for number in range(rounds + 1):
            for name, run in runs.items():
                start = time.perf_counter()
                run()
                seconds = time.perf_counter() - start
                print(f"round {number}: {name} {1e3 * seconds:.0f} ms", file=sys.stderr, flush=True)
                if number == 0:
                    continue  # builds kernels, fills caches
                if name in ours and seconds < min(calls[name], default=np.inf):
                    on_device[name] = sum(ours[name].report.stage_ms.values()) / 1e3
                calls[name].append(seconds)
    return [Time(name, seconds, on_device.get(name)) for name, seconds in calls.items()], notes


def table(times: list[Time]) -> str:
    rows = ["| | median, ms | fastest, ms | on the device, ms |", "|:---|---:|---:|---:|"]
    for one in times:
        device = "" if one.device is None else f"{1e3 * one.device:.0f}"
        rows.append(
            f"| {one.name} | {1e3 * statistics.median(one.calls):.0f} | {1e3 * min(one.calls):.0f} | {device} |"
        )
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    parser.add_argument("--size", nargs=2, type=int, default=(1280, 720), metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    options = parser.parse_args()
    if min(*options.size, options.rounds) < 1:
        parser.error("--size and --rounds want whole numbers of at least 1")
    case = next(iter(chosen_cases(options)))
    width, height = options.size
    times, notes = measure(enlarged(case.frame, width, height), case.exposure, options.rounds)
    info = pick_device()
    print(f"{width}x{height}, {case.scene}, {case.spp} spp; {info.name} ({info.runtime}), {os.cpu_count()} cores\n")
    print(table(times))
    for note in notes:
        print(f"- {note}")
    if options.json:
        figures = {"size": options.size, "device": info.name, "times": [asdict(one) for one in times]}
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
