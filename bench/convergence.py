"""Whether a method goes on helping: error of the result over that of its input, from few samples to very many.

    python bench/convergence.py [--scenes room classroom staircase] [--spp 16 64 256 1024 4096 16384] [--methods auto]

Renders each of this repository's scenes at every sample count, each count from samples of its own, and a reference of
several times as many in two halves, against which its own noise cancels in the mean. A count is added up from renders
of `PART` samples that are kept, so that the next run goes on where this one ended. Prints the ratio, and at the end
what is wrong: a ratio over 1.01, or an error that rises with the samples.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from entries import ENTRIES
from frames import rendered

from mcdenoise_cl import Frame, denoise
from mcdenoise_cl.exr import read_exr
from mcdenoise_cl.metrics import frame_exposure, relmse
from mcdenoise_cl.render import scene_names

SPP = (16, 64, 256, 1024, 4096, 16384)
#: Samples of one file at most, and of the reference in units of the largest count.
PART, REFERENCE = 4096, 2
SIZE = (64, 36)
#: The most by which a result may be worse than its input.
MOST = 1.01


def added_up(frames: Sequence[Frame], samples: Sequence[int]) -> Frame:
    """Independent frames of one scene as one, with variances and half buffers; each has so many samples."""
    total = sum(samples)
    shares = [n / total for n in samples]
    planes = {}
    for name, plane in frames[0].planes().items():
        # The variance of a weighted mean takes the squares of the weights.
        power = 2 if name.endswith("_variance") else 1
        parts = (getattr(frame, name).astype(np.float64) * w**power for frame, w in zip(frames, shares, strict=True))
        planes[name] = sum(parts).astype(np.float32).reshape(plane.shape)
    return Frame(**planes, metadata={**frames[0].metadata, "samples_per_pixel": total})


def frame_of(cache: Path, scene: str, spp: int, size: tuple[int, int], seed: int) -> Frame:
    """The scene with that many samples, of this seed and those that follow."""
    parts = [min(PART, spp - start) for start in range(0, spp, PART)]
    paths = [
        rendered(cache, scene, n, *size, seed=1000 * seed + i, name=f"convergence-{seed}-{i}-{n}")
        for i, n in enumerate(parts)
    ]
    return added_up([read_exr(path) for path in paths], parts)


def error(image: np.ndarray, reference: Frame) -> float:
    return relmse(image, reference.color, frame_exposure(reference), reference.color_a, reference.color_b)


def faults(counts: Sequence[int], before: Sequence[float], after: Sequence[float]) -> list[str]:
    """What is wrong with a method's errors, `after`, at rising sample counts, those of the input being `before`."""
    found = [
        f"{n} spp: {b / a:.3f} times the error of the input"
        for n, a, b in zip(counts, before, after, strict=True)
        if b > MOST * a
    ]
    pairs = zip(counts[1:], after, after[1:], strict=False)
    return found + [f"{n} spp: error rises from {a:.3g} to {b:.3g}" for n, a, b in pairs if b > a]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=scene_names(), default=scene_names())
    parser.add_argument("--spp", type=int, nargs="+", default=list(SPP), help="sample counts, even numbers")
    parser.add_argument("--methods", nargs="+", choices=list(ENTRIES), default=["auto"])
    parser.add_argument("--cache", type=Path, default=Path("bench/cache"), help="where rendered frames are kept")
    parser.add_argument("--render-size", nargs=2, type=int, default=SIZE, metavar=("W", "H"))
    options = parser.parse_args()
    counts, size = sorted(set(options.spp)), tuple(options.render_size)
    complaints = []
    print(f"| | | {' | '.join(f'{n} spp' for n in counts)} |\n|:---|:---|{'---:|' * len(counts)}", flush=True)
    for scene in options.scenes:
        reference = frame_of(options.cache, scene, REFERENCE * counts[-1], size, seed=99)
        frames = [frame_of(options.cache, scene, n, size, seed=i) for i, n in enumerate(counts)]
        before = [error(frame.color, reference) for frame in frames]
        print(f"| {scene} | input | {' | '.join(f'{e:.3g}' for e in before)} |", flush=True)
        for name in options.methods:
            after = [error(denoise(frame, **ENTRIES[name]), reference) for frame in frames]
            cells = (f"{b:.3g} ({b / a:.3f})" for a, b in zip(before, after, strict=True))
            print(f"| {scene} | {name} | {' | '.join(cells)} |", flush=True)
            complaints += [f"{scene}, {name}, {fault}" for fault in faults(counts, before, after)]
    print("\n" + "\n".join(complaints or ["never worse than the input by more than 1 %; errors fall with the samples"]))


if __name__ == "__main__":
    main()
