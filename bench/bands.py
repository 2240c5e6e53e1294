"""What it costs to filter a frame in bands of rows: time and memory of a large frame under several budgets.

    python bench/bands.py [--size 3840 2160] [--memory 2048 1024] [--methods auto guided nlm]
    python bench/bands.py --size 8192 8192 --memory 4096 --methods guided nlm --bands-only --calls 1

The frame is made up: a synthetic room with features, noise and its variance, tiled. Of each method and budget: rows of
a band, the best of three calls, and the most that is kept besides input and output; results that differ from the whole,
or with --bands-only from those of the first budget, in any bit are said to.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pyopencl as cl

from mcdenoise_cl import Denoiser, Frame
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.errors import NoRoomError

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import inputs


def large_frame(width: int, height: int) -> Frame:
    """The synthetic room, repeated until it fills the frame, with a variance of a twentieth of its square."""
    tile = inputs.features(min(height, 540), min(width, 960))
    times = -(-height // tile["depth"].shape[0]), -(-width // tile["depth"].shape[1])
    planes = {name: np.tile(plane, times + (1,) * (plane.ndim - 2)) for name, plane in tile.items()}
    planes = {name: np.ascontiguousarray(plane[:height, :width]) for name, plane in planes.items()}
    return Frame(**planes, color_variance=0.05 * planes["color"] ** 2 + np.float32(1e-6))


def watched(engine: Engine, memory: Callable, most: list[int], size: int) -> cl.MemoryObjectHolder:
    """What the engine's `memory` gives; `most` becomes the largest number of bytes held so far."""
    given = memory(size)
    most[0] = max(most[0], engine.held)
    return given


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", nargs=2, type=int, default=(3840, 2160), metavar=("W", "H"))
    parser.add_argument("--memory", nargs="*", type=int, default=(2048, 1024), help="MiB; the whole frame comes first")
    parser.add_argument("--bands-only", action="store_true", help="never the whole frame, which may not fit")
    parser.add_argument("--calls", type=int, default=3, help="calls after the first, the best of which is timed")
    parser.add_argument("--methods", nargs="+", default=("auto", "guided", "nlm"))
    options = parser.parse_args()
    frame = large_frame(*options.size)
    print("| method | MiB allowed | rows | seconds | MiB kept | |\n|:---|---:|---:|---:|---:|:---|")
    for method in options.methods:
        whole = None
        for budget in (*([] if options.bands_only else [None]), *options.memory):
            denoiser, most = Denoiser(*frame.shape, method=method, max_memory_mb=budget), [0]
            denoiser._engine.memory = partial(watched, denoiser._engine, denoiser._engine.memory, most)
            try:
                result, seconds = denoiser(frame), []
                for _ in range(max(options.calls, 1)):
                    start = time.perf_counter()
                    result = denoiser(frame)
                    seconds.append(time.perf_counter() - start)
            except NoRoomError as error:
                print(f"| {method} | {budget} | | | | {error} |", flush=True)
                continue
            whole = result if whole is None else whole
            same = "" if np.array_equal(result, whole) else "**other bits**"
            row = method, budget or "", denoiser._rows, f"{min(seconds):.2f}", f"{most[0] / 2**20:.0f}", same
            print("|", " | ".join(map(str, row)), "|", flush=True)


if __name__ == "__main__":
    main()
