"""Does a sequence gain from its neighbouring frames? Error and flicker of single frames and with `neighbours`.

    python bench/sequence.py [--scenes room staircase classroom] [--spp 4 16] [--methods auto guided] [--frames 5]

Renders short sequences of this repository's scenes, once into the cache folder: with a camera that stands still, one
that moves by a fraction of a pixel a frame, and one that moves by a few; every frame has a seed and a reference of its
own. For 0, 1 and 2 neighbours to each side it prints relMSE, and the flicker: the variance over time of what the result
differs from its reference by, relative as relMSE is. References come in halves, so that their own noise cancels in the
mean of both.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from speed_tables import table

from mcdenoise_cl import Denoiser, Frame
from mcdenoise_cl.exr import read_exr, write_exr
from mcdenoise_cl.metrics import RELMSE_EPSILON, frame_exposure
from mcdenoise_cl.render import render, scene_names

#: How far the camera moves from frame to frame: metres to the right, up and forward. At 160 pixels across, 1 cm to the
#: side is about a third of a pixel on what is three metres away.
MOVES = {"still": (0.0, 0.0, 0.0), "slow": (0.01, 0.003, 0.005), "moving": (0.06, 0.01, 0.03)}
SIZE, FRAMES, SPP, REFERENCE_SPP = (160, 90), 5, (4, 16), 128


def rendered(
    cache: Path, scene: str, move: str, number: int, spp: int, size: Sequence[int], seed: int, name: str = ""
) -> Frame:
    """One frame of a sequence, from the cache or rendered; `name` stands for the sample count in the file's name."""
    width, height = size
    path = cache / f"{width}x{height}" / "sequences" / scene / move / f"{name or 'frame'}{spp:04d}.{number:02d}.exr"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        print(f"rendering {path.name} of {scene}, {move}", file=sys.stderr, flush=True)
        steps = tuple(number * each for each in MOVES[move])
        write_exr(path, render(scene, spp=spp, width=width, height=height, seed=seed, halves=True, move=steps))
    return read_exr(path)


def sequence(options: argparse.Namespace, scene: str, move: str, spp: int) -> tuple[list[Frame], list[Frame]]:
    """The noisy frames and their references."""
    noisy, references = [], []
    for number in range(options.frames):
        noisy.append(rendered(options.cache, scene, move, number, spp, options.size, seed=1 + number))
        # Frames that show the same share a reference.
        own = number if any(MOVES[move]) else 0
        references.append(
            rendered(options.cache, scene, move, own, options.reference_spp, options.size, 1000 + own, "reference")
        )
    return noisy, references


def scores(images: Sequence[np.ndarray], references: Sequence[Frame]) -> tuple[float, float]:
    """relMSE over the sequence, and the flicker: the same of the residuals less their mean over time.

    Both are products of the differences to the two halves of the reference. The flicker is divided by n - 1, as
    variances are.
    """
    exposure = frame_exposure(references[0])
    squares = np.stack([reference.color.astype(np.float64) ** 2 for reference in references])
    weight = exposure**2 / (exposure**2 * squares + RELMSE_EPSILON)
    residuals = [
        np.stack([np.asarray(image, np.float64) - half for image, half in zip(images, halves, strict=True)])
        for halves in zip(*((reference.color_a, reference.color_b) for reference in references), strict=True)
    ]
    error = np.mean(weight * residuals[0] * residuals[1])
    about = [residual - residual.mean(0) for residual in residuals]
    flicker = np.mean(weight * about[0] * about[1]) * len(images) / (len(images) - 1)
    return float(error), float(flicker)


def filtered(denoiser: Denoiser, frames: Sequence[Frame], reach: int) -> tuple[list[np.ndarray], float]:
    """Every frame denoised with up to `reach` neighbours to each side; and how many frames were merged, on average."""
    images, merged = [], []
    for i, frame in enumerate(frames):
        near = [frames[j] for j in range(max(i - reach, 0), min(i + reach + 1, len(frames))) if j != i]
        images.append(denoiser(frame, neighbours=near))
        merged.append(denoiser.report.merged)
    return images, float(np.mean(merged))


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=scene_names(), default=scene_names())
    parser.add_argument("--moves", nargs="+", choices=list(MOVES), default=list(MOVES))
    parser.add_argument("--spp", type=int, nargs="+", default=list(SPP), help="sample counts, even numbers")
    parser.add_argument("--methods", nargs="+", default=["auto", "guided"])
    parser.add_argument("--neighbours", type=int, nargs="+", default=[0, 1, 2], metavar="N", help="to each side")
    parser.add_argument("--frames", type=int, default=FRAMES, help="length of a sequence")
    parser.add_argument("--size", nargs=2, type=int, default=SIZE, metavar=("W", "H"))
    parser.add_argument("--reference-spp", type=int, default=REFERENCE_SPP)
    parser.add_argument("--cache", type=Path, default=Path("bench/cache"), help="where rendered frames are kept")
    return parser


def main() -> None:
    options = arguments().parse_args()
    width, height = options.size
    rows = []
    for scene in options.scenes:
        for move in options.moves:
            for spp in options.spp:
                noisy, references = sequence(options, scene, move, spp)
                for method in options.methods:
                    denoiser, first = Denoiser(height, width, method=method), None
                    for reach in options.neighbours:
                        images, merged = filtered(denoiser, noisy, reach)
                        found = scores(images, references)
                        first = first or found
                        change = [f"{100 * (value / one - 1):+.1f} %" for value, one in zip(found, first, strict=True)]
                        error, flicker = (f"{1e3 * value:.3f}" for value in found)
                        row = f"{spp}", method, f"{reach}", error, change[0], flicker, change[1], f"{merged:.2f}"
                        rows.append((scene, move, *row))
                        print(*rows[-1], file=sys.stderr, flush=True)
    heads = ("scene", "camera", "spp", "method", "N", "relMSE × 10³", "", "flicker × 10³", "", "frames merged")
    print(f"{width}x{height}, {options.frames} frames, references of {options.reference_spp} samples\n")
    print(table(heads, rows))


if __name__ == "__main__":
    main()
