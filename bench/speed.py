"""How long every method and every peer takes at every size, side by side in one run, and how much memory.

    python bench/speed.py [--size WIDTH HEIGHT ...] [--methods NAME ...] [--peers NAME ...|none] [--rounds 5]
                          [--first smallest|all|none] [--longest 60] [--stages] [--json FILE] [--markdown FILE]

One frame (the first with the fewest samples, or a rendered one) is continued by its mirror images to each size. Every
denoiser is a process of its own on the same cores (`worker.py`) and warm; they take turns, never two at a time, so that
whatever else the machine does meets all of them alike. Where memory does not hold all of them at once, some are
stopped after their turn and made ready again before the next.

Tables show the median of the whole calls, from host memory to host memory, between which values the middle half of
the turns lies, and the fastest; for ours, the milliseconds on the device after its events, which leave out transfers
and Python. What the columns of memory count, and what they cannot tell apart, is said in `worker.py`. Times of the
first call are those of fresh processes with empty program caches and with the caches that the first one filled.
Ratios are medians of the ratios within a round. Progress goes to stderr.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from crew import Crew, Place, Worker, WorkerError, first_call
from entries import ENTRIES, chosen_entries
from frames import add_arguments, enlarged, noisy_frame
from machine import machine, versions, words
from peers import all_peers, installed
from speed_tables import first_table, ratio_table, ratios, scaling, scaling_table, size_table, stage_table

from mcdenoise_cl import Frame
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import DEVICE_VARIABLE

SIZES = ((640, 360), (1280, 720), (1920, 1080), (3840, 2160))


@dataclass(frozen=True)
class Timing:
    """One denoiser at one size.

    Attributes:
        name, ours: as tables show it, and whether it is one of entries.ENTRIES.
        seconds: of whole calls, one a round.
        device_ms: on the device, one a round; empty for peers.
        stages: median of the device's milliseconds, by stage.
        host_bytes, device_bytes: peaks, as `worker.py` says.
    """

    name: str
    ours: bool
    seconds: list[float]
    device_ms: list[float]
    stages: dict[str, float]
    host_bytes: int
    device_bytes: int | None


@dataclass(frozen=True)
class First:
    """Seconds until the first frame is done, with empty and with filled program caches."""

    name: str
    width: int
    height: int
    empty: float
    filled: float


def measure(names: list[str], place: Place, rounds: int, longest: float, label: str) -> tuple[list[Timing], list[str]]:
    """All of them in turns at one size; and notes on those that were left out."""
    notes = []
    answers: dict[str, list[dict]] = {name: [] for name in names}
    with Crew(names, place) as crew:
        for number in range(rounds):
            for name in list(answers):
                try:
                    answers[name].append(crew.turn(name, longest if number == 0 and name not in ENTRIES else None))
                except WorkerError as error:
                    notes.append(f"{name}: left out at {label}, {error}")
                    del answers[name]
                    crew.dismiss(name)
                    continue
                progress(f"{label}, round {number + 1}: {name} {1e3 * answers[name][-1]['seconds']:.1f} ms")
    return [timing(name, turns) for name, turns in answers.items()], notes


def timing(name: str, turns: list[dict]) -> Timing:
    """What the turns of one denoiser come to."""
    stages = {stage: statistics.median(turn["stages"][stage] for turn in turns) for stage in turns[0]["stages"]}
    return Timing(
        name=name,
        ours=name in ENTRIES,
        seconds=[turn["seconds"] for turn in turns],
        device_ms=[sum(turn["stages"].values()) for turn in turns if turn["stages"]],
        stages=stages,
        host_bytes=max(turn["host_bytes"] for turn in turns),
        device_bytes=max((turn["device_bytes"] for turn in turns if turn["device_bytes"] is not None), default=None),
    )


def measure_first(names: list[str], place: Place, width: int, height: int) -> tuple[list[First], list[str]]:
    """Times of the first calls of ours."""
    found, notes = [], []
    for name in names:
        progress(f"{width}x{height}, first call: {name}")
        try:
            found.append(First(name, width, height, *first_call(name, place)))
        except WorkerError as error:
            notes.append(f"{name}: no first call at {width}x{height}, {error}")
    return found, notes


def fill_caches(names: list[str], place: Place, label: str) -> None:
    """Have ours compiled before they are measured, lest the compiler's memory be taken for theirs."""
    for name in names:
        progress(f"{label}, filling caches: {name}")
        worker = Worker(name, place)
        try:
            worker.start()
        except WorkerError:
            pass  # it will fail again where that leads to a note
        finally:
            worker.stop()


def save_planes(folder: Path, frame: Frame, exposure: float) -> None:
    """The frame as `worker.py` reads it."""
    for name, plane in frame.planes().items():
        np.save(folder / f"{name}.npy", plane)
    (folder / "exposure.json").write_text(json.dumps(exposure))


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    parser.add_argument(
        "--size", nargs=2, type=int, action="append", metavar=("W", "H"), help="may be repeated; four sizes by default"
    )
    names = list(ENTRIES)
    parser.add_argument("--methods", nargs="*", choices=names, default=names, help="ours to measure; all by default")
    known = [peer.name for peer in all_peers()]
    parser.add_argument("--peers", nargs="+", choices=[*known, "none"], default=known, help="all by default")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each denoiser at each size")
    parser.add_argument(
        "--longest", type=float, default=60, help="seconds that a peer's first run may take, else it is left out"
    )
    parser.add_argument("--first", choices=("smallest", "all", "none"), default="smallest", help="sizes of first calls")
    parser.add_argument("--stages", action="store_true", help="print the device's milliseconds of every stage too")
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    parser.add_argument("--markdown", type=Path, help="write the tables to this file too")
    return parser


def chosen_sizes(given: list[list[int]] | None) -> list[tuple[int, int]]:
    """The sizes asked for, from small to large."""
    return sorted({(w, h) for w, h in given or SIZES}, key=lambda size: size[0] * size[1])


def text(figures: dict, stages: bool) -> str:
    """Every table, as Markdown."""
    facts = figures["machine"]
    frame = f"{figures['scene']}, {figures['spp']} spp"
    parts = [f"{words(facts)}; {facts['version']}, driver {facts['driver']}; {frame}; {figures['rounds']} rounds"]
    for size in figures["sizes"]:
        parts.append(f"### {size['width']}x{size['height']}\n\n{size_table(size)}")
        if stages:
            parts += [f"{one['name']}: device ms\n\n{stage_table(one)}" for one in size["timings"] if one["stages"]]
    if figures["first"]:
        parts.append(f"### First call, s\n\n{first_table(figures['first'])}")
    if figures["ratios"]:
        parts.append(f"### Times as fast\n\n{ratio_table(figures['ratios'])}")
    if figures["scaling"]:
        parts.append(f"### Time a pixel relative to a smaller frame\n\n{scaling_table(figures['scaling'])}")
    if figures["notes"]:
        parts.append("Notes:\n\n" + "\n".join(f"- {note}" for note in figures["notes"]))
    return "\n\n".join(parts)


def main() -> None:
    parser = arguments()
    options = parser.parse_args()
    sizes = chosen_sizes(options.size)
    if min(options.rounds, *(n for size in sizes for n in size)) < 1:
        parser.error("--size and --rounds want whole numbers of at least 1")
    for path in (options.json, options.markdown):
        if path and not path.parent.is_dir():
            parser.error(f"{path} cannot be written: make the folder {path.parent} first")
    scene, spp, frame, exposure = noisy_frame(options)
    have = frame.planes()
    peers, notes = installed([peer for peer in all_peers() if peer.name in options.peers])
    able = [one for one in [*chosen_entries(options.methods), *peers] if all(plane in have for plane in one.needs)]
    own = [one.name for one in able if one.name in ENTRIES]
    info = pick_device()
    # By index, so that workers do not choose among runtimes again, which they would do by measuring.
    variables = {DEVICE_VARIABLE: str(info.index)}
    device_memory = None if info.kind == "CPU" else info.memory

    figures = {"machine": machine(info), "versions": versions(), "scene": scene, "spp": spp, "rounds": options.rounds}
    figures |= {"sizes": [], "first": []}
    for width, height in sizes:
        label = f"{width}x{height}"
        with tempfile.TemporaryDirectory(prefix="mcdenoise-speed-") as folder:
            save_planes(Path(folder), enlarged(frame, width, height), exposure)
            place = Place(Path(folder), width * height, variables, device_memory)
            if options.first == "all" or (options.first == "smallest" and (width, height) == sizes[0]):
                first, left_out = measure_first(own, place, width, height)
                figures["first"] += [asdict(one) for one in first]
                notes += left_out
            fill_caches(own, place, label)
            timings, left_out = measure([one.name for one in able], place, options.rounds, options.longest, label)
            notes += left_out
        figures["sizes"].append({"width": width, "height": height, "timings": [asdict(one) for one in timings]})
    figures |= {"ratios": ratios(figures["sizes"]), "scaling": scaling(figures["sizes"]), "notes": notes}
    print(text(figures, options.stages))
    if options.markdown:
        options.markdown.write_text(text(figures, options.stages) + "\n")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
