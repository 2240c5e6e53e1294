"""Where each method stops helping: relMSE of the input and of what is made of it, from few samples to many.

    python bench/samples.py [--scene room] [--spp 4 8 ... 1024] [--methods NAME ...] [--no-peers] [--json FILE]

Renders one of this repository's scenes at every sample count, once into the cache folder, and a reference in two
halves, against which the reference's own noise cancels in the mean. A method has stopped helping where its line meets
the input's. `chart.py` draws the JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from entries import ENTRIES, chosen_entries
from frames import Case, add_render_arguments, rendered_cases
from machine import machine, versions
from peers import all_peers, denoised, installed
from speed_tables import table

from mcdenoise_cl import Denoiser
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.metrics import relmse
from mcdenoise_cl.render import scene_names

SPP = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
#: Peers that are drawn beside ours: the strongest.
PEERS = ("OIDN high",)
#: Small, because a thousand samples of a pixel take long to render, and with a reference of twice as many.
SIZE, REFERENCE_SPP = (320, 180), 2048


def error(case: Case, image: Any) -> float:
    reference = case.reference
    return relmse(image, reference.color, case.exposure, reference.color_a, reference.color_b)


def errors(case: Case, methods: list[str], peers: list) -> dict[str, float]:
    """relMSE of the input and of every denoiser on one frame."""
    device = pick_device().device
    found = {"input": error(case, case.frame.color)}
    for one in chosen_entries(methods):
        found[one.name] = error(case, Denoiser(*case.frame.shape, device=device, **one.arguments)(case.frame))
    for peer in peers:
        found[peer.name] = error(case, denoised(peer, case.frame, case.exposure))
    return found


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=scene_names(), default="room")
    parser.add_argument("--spp", type=int, nargs="+", default=list(SPP), help="sample counts, even numbers")
    names = list(ENTRIES)
    parser.add_argument("--methods", nargs="*", choices=names, default=names, help="ours to measure; all by default")
    parser.add_argument("--no-peers", action="store_true", help="measure our methods only")
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    add_render_arguments(parser)
    parser.set_defaults(render_size=SIZE, reference_spp=REFERENCE_SPP)
    return parser


def main() -> None:
    options = arguments().parse_args()
    if options.json and not options.json.parent.is_dir():
        raise SystemExit(f"{options.json} cannot be written: make the folder {options.json.parent} first")
    wanted = [] if options.no_peers else [peer for peer in all_peers() if peer.name in PEERS]
    peers, notes = installed(wanted)
    counts = tuple(sorted(set(options.spp)))
    cases = rendered_cases(options.cache, counts, options.reference_spp, *options.render_size, scenes=(options.scene,))
    found: dict[str, dict[int, float]] = {}
    for case in cases:
        print(f"measuring {case.scene}, {case.spp} spp", file=sys.stderr, flush=True)
        for name, value in errors(case, options.methods, peers).items():
            found.setdefault(name, {})[case.spp] = value
    rows = [(name, *(f"{values[n]:.3g}" for n in counts)) for name, values in found.items()]
    width, height = options.render_size
    print(f"relMSE of {options.scene}, {width}x{height}, reference of {options.reference_spp} samples per pixel\n")
    print(table(("", *(f"{n} spp" for n in counts)), rows))
    for note in notes:
        print(f"- {note}")
    if options.json:
        figures = {"machine": machine(pick_device()), "versions": versions(), "scene": options.scene}
        figures |= {"width": width, "height": height, "reference_spp": options.reference_spp}
        figures |= {"notes": notes, "relmse": found}
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
