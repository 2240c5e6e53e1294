"""Whether `auto` does harm to a converged frame: a reference, the features of its scene and a little noise.

    python bench/converged.py [--frames FOLDER] [--noise 1e-4 1e-3 1e-2] [--grain 0.03]

The noise of each pixel and channel is a part of its own value, drawn independently, and is known exactly: as a
variance, as two half buffers, or as both. Prints the error of the result over that of its input; the reference is the
truth, and its own noise, of which nothing is told, a texture that no feature shows; --grain adds another, of all
channels together. The features are those of the
frame with most samples. The error is the mean of (x - truth)² / (truth² + 1e-4).
"""

from __future__ import annotations

import argparse

import numpy as np
from frames import add_arguments, chosen_cases

from mcdenoise_cl import Frame, denoise

#: Column of the table -> which of the planes below the frame has.
KNOWN = {
    "variance": ("color_variance",),
    "half buffers": ("color_a", "color_b"),
    "both": ("color_variance", "color_a", "color_b"),
}


def with_grain(image: np.ndarray, deviation: float) -> np.ndarray:
    """The image with a texture of that deviation, relative to each value; none if it is 0."""
    grain = 1 + deviation * np.random.default_rng(1).standard_normal((*image.shape[:2], 1))
    return (image * grain).astype(np.float32)


def converged(truth: np.ndarray, noise: float, features: Frame) -> tuple[Frame, dict[str, np.ndarray]]:
    """A clean image with noise, the features of another frame, and everything there is to know of that noise."""
    rng = np.random.default_rng(0)
    sigma = np.float32(noise) * np.abs(truth)
    color, difference = (sigma * rng.standard_normal(truth.shape, np.float32) for _ in range(2))
    color += truth
    planes = {name: plane for name, plane in features.planes().items() if not name.startswith("color")}
    known = {"color_variance": sigma**2, "color_a": color + difference, "color_b": color - difference}
    return Frame(color, **planes), known


def error(image: np.ndarray, truth: np.ndarray) -> float:
    return float(np.mean((image - truth.astype(np.float64)) ** 2 / (truth.astype(np.float64) ** 2 + 1e-4)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    parser.add_argument("--noise", nargs="+", type=float, default=(1e-4, 1e-3, 1e-2), help="relative to each value")
    parser.add_argument("--grain", type=float, default=0.0, help="deviation of a texture that no feature shows")
    options = parser.parse_args()
    print(f"| | noise | {' | '.join(KNOWN)} |\n|:---|---:|{'---:|' * len(KNOWN)}")
    last = {case.scene: case for case in chosen_cases(options)}
    for scene, case in last.items():
        truth = with_grain(case.reference.color, options.grain)
        for noise in options.noise:
            frame, known = converged(truth, noise, case.frame)
            before = error(frame.color, truth)
            ratios = []
            for names in KNOWN.values():
                given = Frame(**frame.planes(), **{name: known[name] for name in names})
                ratios.append(f"{error(denoise(given), truth) / before:.5f}")
            print(f"| {scene} | {noise:g} | {' | '.join(ratios)} |", flush=True)


if __name__ == "__main__":
    main()
