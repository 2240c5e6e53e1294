"""Inputs on which denoisers are known to fail: what our methods, eq. 8 as printed and the peers make of each.

    python bench/stability.py [--only TOPIC_OR_NAME ...] [--absolute] [--json FILE] [--pictures FOLDER]

Prints a table a topic. `input` is the relMSE of the input, over the judged pixels that are finite in it; the other
figures are the relMSE of the result, over all judged pixels, divided by it: below 1 is better than the input. Where the
input has no error, and everywhere with --absolute, the result's own is printed, in brackets. "non-finite": a value came
out that is no number. The last column is what the report of `auto` says was replaced, or taken from outliers.

For effects that features do not show, a second table has the part of the contrast between neighbours that is left on
the judged pixels: 1 for the truth, and for noise about it.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from importlib import import_module
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path

import numpy as np
import peers
from paper import ROWS
from stability_case import Case
from stability_scenes import contrast_kept

from mcdenoise_cl import Denoiser, Frame, McdenoiseError
from mcdenoise_cl.details import Report
from mcdenoise_cl.metrics import auto_exposure, relmse_map
from mcdenoise_cl.pictures import side_by_side, write_png

#: The parameters of eq. 8 as printed: those of the paper's tables.
PRINTED = next(parameters for name, _, parameters in ROWS if "as printed" in name)
OURS = {
    "auto": {"method": "auto"},
    "regression": {"method": "regression"},
    "guided": {"method": "guided"},
    "ssim-nlm": {"method": "ssim-nlm"},
    "eq. 8": {"method": "ssim-nlm", **PRINTED},
}
PEERS = {"OIDN": ("OIDN high", "OIDN high, colour only"), "scikit-image NLM": ("scikit-image NLM",)}
MODULES = ("stability_inputs", "stability_scenes")
#: An error of the input below this is none.
NO_ERROR = 1e-12


@dataclass
class Outcome:
    """What came of one case: relMSE of the input, relMSE or what else happened for each denoiser, contrast kept."""

    topic: str
    name: str
    tried: str
    outcome: str
    input: float | None = None
    results: dict[str, float | str] = field(default_factory=dict)
    contrast: dict[str, float] = field(default_factory=dict)
    replaced: dict[str, int] = field(default_factory=dict)
    energy_removed: float = 0.0


def all_cases(only: list[str]) -> list[Case]:
    """Every case there is, or those of these topics and names."""
    cases = [case for name in MODULES if find_spec(name) for case in import_module(name).CASES]
    if unknown := set(only) - {case.name for case in cases} - {case.topic for case in cases}:
        topics = ", ".join(dict.fromkeys(case.topic for case in cases))
        raise SystemExit(f"{unknown.pop()!r} is neither a topic nor a case: the topics are {topics}")
    return [case for case in cases if not only or case.topic in only or case.name in only]


def our_result(frame: Frame, parameters: dict) -> tuple[np.ndarray, Report]:
    denoiser = Denoiser(*frame.shape, **parameters)
    return denoiser(frame), denoiser.report


def peer_result(names: tuple[str, ...], frame: Frame, exposure: float) -> np.ndarray:
    """What the first of these peers makes of the frame whose planes the frame has."""
    by_name = {peer.name: peer for peer in peers.all_peers()}
    peer = next(by_name[name] for name in names if all(plane in frame.planes() for plane in by_name[name].needs))
    return peers.denoised(peer, frame, exposure).copy()


def judged(image: np.ndarray, truth: np.ndarray | None, mask: np.ndarray | None, exposure: float) -> float | str:
    """relMSE over the mask, or what there is to say where there is none."""
    if not np.isfinite(image).all():
        return "non-finite"
    return "finite" if truth is None else error_of(image, truth, mask, exposure)


def error_of(image: np.ndarray, truth: np.ndarray, mask: np.ndarray | None, exposure: float) -> float:
    """relMSE over the pixels of the mask that are finite; NaN where there are none."""
    seen = np.isfinite(image).all(-1) & (True if mask is None else mask)
    errors = relmse_map(np.where(seen[..., None], image, 0), truth, exposure)[seen]
    return float(errors.mean()) if errors.size else float("nan")


def measure(case: Case) -> tuple[Outcome, dict[str, np.ndarray], float]:
    """The figures of a case, its images by name, and the exposure for both."""
    frame, truth, mask = case.make()
    exposure = auto_exposure(frame.color if truth is None else truth)
    outcome = Outcome(case.topic, case.name, case.tried, case.outcome)
    images = {"input": frame.color}
    if truth is not None:
        images["truth"] = truth
        outcome.input = error_of(frame.color, truth, mask, exposure)

    def attempt(name: str, run: Callable[[], np.ndarray]) -> None:
        try:
            with np.errstate(all="ignore"):
                image = images[name] = run()
            outcome.results[name] = judged(image, truth, mask, exposure)
        except (McdenoiseError, RuntimeError, ValueError) as error:
            outcome.results[name] = f"error: {error}"

    def ours(name: str) -> np.ndarray:
        image, report = our_result(frame, OURS[name])
        if name == "auto":
            outcome.replaced, outcome.energy_removed = report.replaced, report.energy_removed
        return image

    for name in OURS:
        attempt(name, lambda name=name: ours(name))
    available = {peer.name for peer in peers.installed(peers.all_peers())[0]}
    for name, choices in PEERS.items():
        if available.issuperset(choices):
            attempt(name, lambda choices=choices: peer_result(choices, frame, exposure))
    if case.reference is not None:
        reference = case.reference()
        shown = {name: image for name, image in images.items() if name == "input" or name in outcome.results}
        outcome.contrast = {name: contrast_kept(image, reference, mask) for name, image in shown.items()}
    return outcome, images, exposure


def cell(result: float | str, before: float | None, absolute: bool = False) -> str:
    """A figure over the input's, or as it is in brackets; an error by its first words, or a word."""
    if isinstance(result, str):
        return result if len(result) <= 40 else f"{result[:39].rstrip()}…"
    if absolute or before is None or before < NO_ERROR:
        return f"({result:.2g})"
    return f"{result / before:.3g}"


def report_cell(outcome: Outcome) -> str:
    """What the report of `auto` says went on at the door and among the outliers."""
    parts = [f"{name} {count}" for name, count in outcome.replaced.items()]
    if outcome.energy_removed > 0:
        parts.append(f"{outcome.energy_removed:.1%} spread")
    return ", ".join(parts)


def print_table(topic: str, outcomes: list[Outcome], absolute: bool) -> None:
    names = list(outcomes[0].results)
    print(f"\n## {topic}\n")
    print("| case | what is tried | input | " + " | ".join(names) + " | report of `auto` |")
    print("|:---|:---|---:|" + "---:|" * len(names) + ":---|")
    for outcome in outcomes:
        before = "" if outcome.input is None else f"{outcome.input:.2g}"
        cells = [cell(outcome.results[name], outcome.input, absolute) for name in names]
        print(f"| {outcome.name} | {outcome.tried} | {before} | " + " | ".join([*cells, report_cell(outcome)]) + " |")

    if not any(outcome.contrast for outcome in outcomes):
        return
    print("\nContrast kept:\n\n| case | input | " + " | ".join(names) + " |\n|:---|---:|" + "---:|" * len(names))
    for outcome in outcomes:
        if outcome.contrast:
            cells = [f"{outcome.contrast[name]:.2f}" if name in outcome.contrast else "" for name in ("input", *names)]
            print(f"| {outcome.name} | " + " | ".join(cells) + " |")


def write_picture(folder: Path, name: str, images: dict[str, np.ndarray], exposure: float) -> None:
    """Input, auto, OIDN and truth beside each other, as far as they are there."""
    shown = {key: images[key] for key in ("input", "auto", "OIDN", "truth") if key in images}
    write_png(folder / f"{name}.png", side_by_side(shown, exposure))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="TOPIC_OR_NAME", help="topics or cases; all by default"
    )
    parser.add_argument("--absolute", action="store_true", help="print relMSE itself, not over that of the input")
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    parser.add_argument("--pictures", type=Path, help="write a picture of each case into this folder")
    options = parser.parse_args()
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    every: list[Outcome] = []
    for topic, cases in groupby(all_cases(options.only), key=lambda case: case.topic):
        outcomes = []
        for case in cases:
            outcome, images, exposure = measure(case)
            outcomes.append(outcome)
            if options.pictures:
                write_picture(options.pictures, case.name, images, exposure)
        print_table(topic, outcomes, options.absolute)
        every += outcomes
    if options.json:
        options.json.write_text(json.dumps([asdict(outcome) for outcome in every], indent=1) + "\n")


if __name__ == "__main__":
    main()
