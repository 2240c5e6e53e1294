"""What further layers cost: time of whole calls with none, one and three of them, relative to the frame alone.

    python bench/also.py [--size 640 360] [--layers 0 1 3] [--methods auto guided] [--rounds 5]

The frame is that of bands.py. Calls take turns, and what is given is the median over the rounds, each ratio that within
a round; and how far the clean layers are from summing to the clean frame.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

import numpy as np
from bands import large_frame

from mcdenoise_cl import Denoiser


def split(color: np.ndarray, count: int) -> dict[str, np.ndarray]:
    """So many layers that sum to a colour, cut at random and from left to right."""
    rng = np.random.default_rng(0)
    right = np.linspace(0, 1, color.shape[1], dtype=np.float32)[:, None, None]
    shares = 0.1 + right * rng.random((*color.shape, count), np.float32)
    shares /= shares.sum(-1, keepdims=True)
    return {str(i): color * shares[..., i] for i in range(count)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", nargs=2, type=int, default=(640, 360), metavar=("W", "H"))
    parser.add_argument("--layers", nargs="+", type=int, default=(0, 1, 3))
    parser.add_argument("--methods", nargs="+", default=("auto", "guided"))
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    frame = large_frame(*options.size)
    print("| method | layers | ms | ratio | sum off by, relative |\n|:---|---:|---:|---:|---:|")
    for method in options.methods:
        denoiser = Denoiser(*frame.shape, method=method)
        layers = {count: split(frame.color, count) for count in options.layers}
        times: dict[int, list[float]] = {count: [] for count in layers}
        off = {}
        for turn in range(options.rounds + 1):
            for count, also in layers.items():
                start = time.perf_counter()
                clean = denoiser(frame, also=also)
                if turn > 0:  # the first builds programs
                    times[count].append(1e3 * (time.perf_counter() - start))
                total = sum(layer.astype(np.float64) for layer in denoiser.also.values())
                off[count] = np.max(np.abs(total - clean) / np.maximum(np.abs(clean), 1e-6)) if also else 0.0
        least = times[options.layers[0]]
        for count, taken in times.items():
            ratio = median(own / first for own, first in zip(taken, least, strict=True))
            print(f"| {method} | {count} | {median(taken):.0f} | {ratio:.2f} | {off[count]:.0e} |", flush=True)


if __name__ == "__main__":
    main()
