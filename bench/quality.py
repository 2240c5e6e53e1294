"""Quality beside the peers: every entry of entries.py, Open Image Denoise, OpenCV and scikit-image.

    python bench/quality.py [--frames FOLDER] [--spp 4 32 128] [--methods NAME ...] [--no-peers]
                            [--strengths 1.6 ...] [--json FILE] [--pictures FOLDER]

Prints Markdown: a table for each frame; then each denoiser's relMSE relative to that of Open Image Denoise (high
quality, noisy albedo and normal), as a geometric mean over the scenes, and where our best method loses to it.
Progress goes to stderr. relMSE is that of linear light, against the two halves of the reference where it has them;
PSNR, MSE, SSIM and FLIP are those of the tonemapped images against the whole reference.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from entries import ENTRIES, Entry, chosen_entries
from frames import Case, add_arguments, chosen_cases
from machine import machine, versions
from peers import STRENGTH, Peer, all_peers, denoised, installed

from mcdenoise_cl import Denoiser, Frame
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import DeviceInfo
from mcdenoise_cl.frame import PLANES
from mcdenoise_cl.metrics import Scores, compare
from mcdenoise_cl.pictures import find_crops, pillow, side_by_side, write_png
from mcdenoise_cl.report import scores_table

INPUT, REFERENCE = "input", "reference"
#: What the last table is relative to, where it was measured.
BASELINE = "OIDN high"
#: Scores of which less is better; of the others more is.
LESS = ("relmse", "relmse_trimmed", "flip")
SCORES = {"relmse": "relMSE", "relmse_trimmed": "trimmed relMSE", "psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP"}


@dataclass(frozen=True)
class Row:
    """The scores of one image of one frame."""

    scene: str
    spp: int
    name: str
    scores: Scores


@dataclass(frozen=True)
class Relative:
    """relMSE of one denoiser over that of the baseline.

    Attributes:
        means: geometric mean over the scenes, by sample count; None where it is missing on one of them, or lost in
            the reference's noise.
        mean: the same over all frames.
        worst, worst_frame: the largest ratio, and where.
    """

    name: str
    means: dict[int, float | None]
    mean: float | None
    worst: float | None
    worst_frame: str


def frame_images(
    case: Case, device: DeviceInfo, chosen: list[Entry], peers: list[Peer], without: list[str]
) -> tuple[dict[str, np.ndarray], list[str]]:
    """The frame denoised by all that can, by name, and a note for each that lacks a plane. `without`: planes that our
    methods are not given."""
    present = case.frame.planes()
    ours = Frame(**{name: plane for name, plane in present.items() if name not in without})
    images, notes = {INPUT: case.frame.color}, []
    for one in [*chosen, *peers]:
        given = present if isinstance(one, Peer) else ours.planes()
        lacking = [plane for plane in one.needs if plane not in given]
        if lacking:
            notes.append(f"{one.name}: left out on {label(case)}, which has no {' and no '.join(lacking)}")
        elif isinstance(one, Peer):
            images[one.name] = denoised(one, case.frame, case.exposure)
        else:
            images[one.name] = Denoiser(*case.frame.shape, device=device.device, **one.arguments)(ours)
    return images, notes


def label(frame: Case | Row) -> str:
    return f"{frame.scene}, {frame.spp} spp"


def write_picture(folder: Path, case: Case, images: dict[str, np.ndarray], rows: list[Row], ours: list[str]) -> None:
    """Input, our methods, the baseline and the reference beside each other, with the crops that tell most."""
    shown = {name: images[name] for name in (INPUT, *ours, BASELINE) if name in images}
    labels = {row.name: f"{row.name}\nrelMSE {row.scores.relmse:.3g}" for row in rows if row.name in shown}
    size = min(64, *case.frame.shape)
    crops = find_crops(case.frame.color, case.reference.color, size=size, exposure=case.exposure)
    picture = side_by_side({**shown, REFERENCE: case.reference.color}, case.exposure, crops=crops, labels=labels)
    write_png(folder / f"{case.scene}-{case.spp:04d}.png", picture)


def relative(rows: list[Row], baseline: str) -> list[Relative]:
    """Every denoiser's relMSE over the baseline's."""
    base = {label(row): row.scores.relmse for row in rows if row.name == baseline}
    frames = {label(row): row.spp for row in rows}
    result = []
    for name in dict.fromkeys(row.name for row in rows):
        own = {label(row): row.scores.relmse for row in rows if row.name == name}
        # Either can be 0 or less where it is lost in the reference's noise: there is no ratio then.
        ratios = {f: own[f] / base[f] for f in frames if f in own and base.get(f, 0) > 0 and own[f] > 0}
        means = {
            spp: geometric_mean([ratios.get(f) for f, n in frames.items() if n == spp])
            for spp in sorted(set(frames.values()))
        }
        worst = max(ratios, key=ratios.__getitem__, default="")
        mean = geometric_mean([ratios.get(f) for f in frames])
        result.append(Relative(name, means, mean, ratios.get(worst), worst))
    return result


def absolute(rows: list[Row]) -> dict[str, dict[int, float | None]]:
    """Geometric mean over the scenes of every image's relMSE, by name and sample count, for chart.py."""
    found: dict[str, dict[int, list[float | None]]] = {}
    for row in rows:
        # A relMSE of 0 or less is lost in the reference's noise.
        value = row.scores.relmse if row.scores.relmse > 0 else None
        found.setdefault(row.name, {}).setdefault(row.spp, []).append(value)
    scenes = {spp: len({row.scene for row in rows if row.spp == spp}) for spp in {row.spp for row in rows}}
    return {
        name: {
            spp: geometric_mean(values) if len(values) == scenes[spp] else None
            for spp, values in sorted(counts.items())
        }
        for name, counts in found.items()
    }


def geometric_mean(values: list[float | None]) -> float | None:
    """None where a value is missing: a mean over fewer scenes than its neighbour's would not compare with it."""
    return None if None in values or not values else float(np.exp(np.mean(np.log(values))))


def relative_table(table: list[Relative]) -> str:
    counts = list(table[0].means)
    lines = [f"| image | {' | '.join(f'{n} spp' for n in counts)} | all | worst frame |"]
    lines.append("|:---|" + "---:|" * (len(counts) + 1) + ":---|")
    for one in table:
        means = ["-" if mean is None else f"{mean:.3f}" for mean in (*one.means.values(), one.mean)]
        worst = "-" if one.worst is None else f"{one.worst:.3f} ({one.worst_frame})"
        lines.append(f"| {one.name} | {' | '.join(means)} | {worst} |")
    return "\n".join(lines)


def verdict(rows: list[Row], table: list[Relative], ours: list[str]) -> str:
    """Where the best of our methods loses to the baseline, by every score."""
    ranked = [one for one in table if one.name in ours and one.mean is not None]
    if not ranked:
        return f"None of our methods was measured beside {BASELINE} on every frame."
    best = min(ranked, key=lambda one: one.mean)
    scores = {name: {label(row): row.scores for row in rows if row.name == name} for name in (best.name, BASELINE)}
    lines = [f"Our best method is {best.name}, with {best.mean:.3f} times the relMSE of {BASELINE} over all frames."]
    for attribute, title in SCORES.items():
        lost, compared = [], 0
        for frame, reached in scores[best.name].items():
            own, other = getattr(reached, attribute), getattr(scores[BASELINE][frame], attribute)
            if own is None or other is None:
                continue
            compared += 1
            if own > other if attribute in LESS else own < other:
                lost.append(f"{frame} ({own:.4g} against {other:.4g})")
        if compared:
            where = f": {'; '.join(lost)}" if lost else ""
            lines.append(f"- {title}: it loses to {BASELINE} on {len(lost)} of {compared} frames{where}.")
    return "\n".join(lines)


def twins(rows: list[Row]) -> list[str]:
    """A note for every two denoisers that came out the same everywhere, lest it be taken for a mistake."""
    scores: dict[str, list[tuple[str, Scores]]] = {}
    for row in rows:
        scores.setdefault(row.name, []).append((label(row), row.scores))
    names = list(scores)
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :] if scores[a] == scores[b]]
    return [f"{b}: the same as {a} on every frame" for a, b in pairs]


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    names = list(ENTRIES)
    parser.add_argument("--methods", nargs="+", choices=names, default=names, help="ours to measure; all by default")
    planes = [name for name in PLANES if name != "color"]
    parser.add_argument("--without", nargs="+", default=[], choices=planes, help="planes to keep from our methods")
    parser.add_argument("--no-peers", action="store_true", help="measure our methods only, relative to the input")
    parser.add_argument(
        "--strengths",
        nargs="+",
        type=float,
        default=[STRENGTH],
        help="h of OpenCV and scikit-image, in units of the noise; several are measured side by side",
    )
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    parser.add_argument("--pictures", type=Path, help="write a comparison of every frame into this folder")
    return parser


def prepare(options: argparse.Namespace) -> tuple[list[Peer], list[str]]:
    """What can be measured here, found out before the long part begins, and notes on what cannot."""
    if options.json and not options.json.parent.is_dir():
        raise SystemExit(f"{options.json} cannot be written: make the folder {options.json.parent} first")
    if min(options.strengths) <= 0:
        raise SystemExit(f"--strengths has {min(options.strengths):g} but numbers above 0 are needed")
    if options.pictures:
        pillow("Image")
        options.pictures.mkdir(parents=True, exist_ok=True)
    peers, notes = ([], []) if options.no_peers else installed(all_peers(tuple(options.strengths)))
    for module, package, title in (("skimage", "scikit-image", "SSIM"), ("flip_evaluator", "flip-evaluator", "FLIP")):
        if find_spec(module) is None:
            notes.append(f"{title}: left out, {package} is not installed")
    return peers, notes


def main() -> None:
    options = arguments().parse_args()
    peers, notes = prepare(options)
    info = pick_device()
    device = f"{info.name} ({info.runtime}, {info.version})"
    chosen = chosen_entries(options.methods)
    print(f"Device: {device}\n\n{', '.join(f'{name} {version}' for name, version in versions().items())}")

    rows: list[Row] = []
    for case in chosen_cases(options):
        start = time.perf_counter()
        print(f"measuring {label(case)}", file=sys.stderr, flush=True)
        images, left_out = frame_images(case, info, chosen, peers, options.without)
        notes += left_out
        if case.reference.color_a is None:
            notes.append(f"{label(case)}: its reference has no halves, so relMSE counts the reference's noise too")
        measured = [
            Row(case.scene, case.spp, name, compare(image, case.reference, case.exposure))
            for name, image in images.items()
        ]
        rows += measured
        print(f"\n### {label(case)}\n\n{scores_table({row.name: row.scores for row in measured})}", flush=True)
        if options.pictures:
            write_picture(options.pictures, case, images, measured, options.methods)
        seconds = time.perf_counter() - start
        print(f"{label(case)}: {len(images)} images in {seconds:.1f} s", file=sys.stderr, flush=True)
    if not rows:
        raise SystemExit(f"{options.frames} has no frames with references, or none of the sample counts asked for")

    with_baseline = any(row.name == BASELINE for row in rows)
    table = relative(rows, BASELINE if with_baseline else INPUT)
    print(f"\n### relMSE relative to {BASELINE if with_baseline else INPUT}\n")
    print(f"Geometric mean over the scenes; less is better.\n\n{relative_table(table)}")
    if with_baseline:
        print(f"\n{verdict(rows, table, options.methods)}")
    notes += twins(rows)
    if notes:
        print("\nNotes:\n\n" + "\n".join(f"- {note}" for note in notes))
    if options.json:
        figures = {
            "device": device,
            "machine": machine(info),
            "versions": versions(),
            "baseline": BASELINE if with_baseline else INPUT,
            "notes": notes,
            "frames": [asdict(row) for row in rows],
            "relative": [asdict(one) for one in table],
            "means": absolute(rows),
        }
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
