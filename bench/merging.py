"""How long neighbouring frames take: milliseconds on the device for each of them, by stage.

    python bench/merging.py [--size 1280 720] [--calls 9]

A frame, continued by its mirror images to the size, and copies of it that have moved by a pixel, are denoised with
`guided`, alone and with two neighbours. Given is the fastest call of each stage, which is disturbed least by whatever
else the machine does, and what a neighbour adds to it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from frames import add_arguments, enlarged, noisy_frame
from speed_tables import table

from mcdenoise_cl import Denoiser, Frame


def moved(frame: Frame, pixels: int) -> Frame:
    """The frame so many pixels further to the right."""
    return replace(frame, **{name: np.roll(plane, pixels, 1) for name, plane in frame.planes().items()})


def fastest(denoiser: Denoiser, frame: Frame, near: list[Frame], calls: int) -> dict[str, float]:
    """The least milliseconds of each stage, after a first call that does not count."""
    times = []
    for _ in range(calls + 1):
        denoiser(frame, neighbours=near)
        times.append(denoiser.report.stage_ms)
    return {name: min(each[name] for each in times[1:]) for name in times[-1]}


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", nargs=2, type=int, default=(1280, 720), metavar=("W", "H"))
    parser.add_argument("--calls", type=int, default=9)
    add_arguments(parser)
    return parser


def main() -> None:
    options = arguments().parse_args()
    width, height = options.size
    _, _, frame, _ = noisy_frame(options)
    frame = enlarged(frame, width, height)
    denoiser = Denoiser(height, width, method="guided")
    near = [moved(frame, 1), moved(frame, -1)]
    alone, merged = (fastest(denoiser, frame, beside, options.calls) for beside in ([], near))
    alone["all"], merged["all"] = sum(alone.values()), sum(merged.values())
    rows = [
        (name, f"{alone.get(name, 0.0):.1f}", f"{merged[name]:.1f}", f"{(merged[name] - alone.get(name, 0.0)) / 2:.1f}")
        for name in merged
    ]
    print(f"{denoiser.queue.device.name}, {width}x{height}, planes {', '.join(frame.planes())}\n")
    print(table(("stage", "alone, ms", "with two neighbours", "each adds"), rows))


if __name__ == "__main__":
    main()
