"""How the default parameters were chosen: one parameter at a time over a list of values, on frames with references.

    python bench/sweep.py --method ssim-nlm --parameter h_factor 1 2 3 4 [--set stabiliser=0.1 ...]

Prints, a value a row, the geometric mean over scenes of relMSE relative to the input's, for each sample count and
over all (lower is better; 1 is the input), and the mean PSNR for each.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np
from frames import Case, add_arguments, chosen_cases

from mcdenoise_cl import Denoiser
from mcdenoise_cl.methods import get_method
from mcdenoise_cl.methods.parameters import parse
from mcdenoise_cl.metrics import psnr, relmse


def errors(case: Case, image: np.ndarray) -> tuple[float, float]:
    """relMSE and PSNR against the case's reference."""
    reference = case.reference
    return (
        relmse(image, reference.color, case.exposure, reference.color_a, reference.color_b),
        psnr(image, reference.color, case.exposure),
    )


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--method", default="ssim-nlm")
    parser.add_argument("--parameter", nargs="+", required=True, metavar=("NAME", "VALUE"))
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    add_arguments(parser)
    return parser


def main() -> None:
    options = arguments().parse_args()
    known = {info.name: info for info in get_method(options.method).parameters}
    fixed = {name: parse(known[name], text) for name, text in (item.split("=", 1) for item in options.set)}
    swept, *values = options.parameter
    cases = list(chosen_cases(options))
    before = [errors(case, case.frame.color)[0] for case in cases]
    counts = sorted({case.spp for case in cases})
    print(
        f"{swept:>16} "
        + "".join(f"{n:>9} spp" for n in counts)
        + "          all      PSNR: "
        + " ".join(f"{n:>6}" for n in counts)
    )
    for text in values:
        ratios, quality = defaultdict(list), defaultdict(list)
        for case, noisy in zip(cases, before, strict=True):
            given = {**fixed, swept: parse(known[swept], text)}
            denoiser = Denoiser(*case.frame.shape, method=options.method, **given)
            after, db = errors(case, denoiser(case.frame))
            ratios[case.spp].append(np.log(after / noisy))
            quality[case.spp].append(db)
        row = "".join(f"{np.exp(np.mean(ratios[n])):11.4f}" for n in counts)
        every = np.exp(np.mean([value for group in ratios.values() for value in group]))
        print(
            f"{text:>16} {row}{every:13.4f}           " + " ".join(f"{np.mean(quality[n]):6.2f}" for n in counts),
            flush=True,
        )


if __name__ == "__main__":
    main()
