"""The charts of the README, from the JSON of `quality.py`, `speed.py` and `samples.py`.

    python bench/chart.py [--quality FILE] [--speed FILE] [--samples FILE] [--size 1280 720] [--out docs]

Writes, each as PNG and SVG: `pareto` (time a megapixel against relMSE, a panel a sample count; needs --quality and
--speed), `sizes` (time against megapixels; needs --speed), `samples` (relMSE against samples per pixel; needs
--samples). A file of `gpu.sh` will do for --quality and --speed. Colours are Okabe and Ito's, which people of any
colour vision tell apart; markers and labels say the same.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
from drawing import FAINT, INK, WIDTH, Pair, draw, label_ends, label_points, logarithmic, save, settle, style, title
from machine import words
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullLocator

INPUT = "input"


def front(points: dict[str, Pair]) -> list[Pair]:
    """The points that no other beats in both coordinates, from left to right."""
    best: list[Pair] = []
    for point in sorted(points.values()):
        if not best or point[1] < best[-1][1]:
            best.append(point)
    return best


def steps(best: Sequence[Pair]) -> list[Pair]:
    """The front as a line: what is right of and above it is beaten."""
    corners = [(b[0], a[1]) for a, b in pairwise(best)]
    return [point for pair in zip(best, [*corners, None], strict=True) for point in pair if point is not None]


def pareto_points(quality: dict, size: dict) -> dict[int, dict[str, Pair]]:
    """Sample count -> name -> (milliseconds a megapixel, relMSE); twins, equal at every count, share a point."""
    pixels = size["width"] * size["height"] / 1e6
    times = {one["name"]: 1e3 * statistics.median(one["seconds"]) / pixels for one in size["timings"]}
    means: dict[str, dict[str, float | None]] = quality["means"]
    names: dict[str, list[str]] = {}
    for name in times:
        if name in means:
            twin = next((other for other in names if means[other] == means[name]), name)
            names.setdefault(twin, []).append(name)
    counts = list(dict.fromkeys(count for name in names for count in means[name]))
    return {
        int(count): {
            twins(group): (times[name], means[name][count])
            for name, group in names.items()
            if means[name].get(count) is not None
        }
        for count in counts
    }


def twins(names: list[str]) -> str:
    """One label for denoisers with the same result: "OIDN high = balanced"."""
    first = names[0].split(" ")[0]
    return " = ".join([names[0], *(name.removeprefix(f"{first} ") for name in names[1:])])


def pareto(quality: dict, speed: dict, wanted: tuple[int, int]) -> Figure:
    """Time a megapixel against error."""
    size = nearest_size(speed, wanted)
    panels = pareto_points(quality, size)
    figure, axes = plt.subplots(
        len(panels), 1, figsize=(WIDTH, 1.0 + 2.7 * len(panels)), sharex=True, squeeze=False, layout="constrained"
    )
    scenes = len({row["scene"] for row in quality["frames"]})
    title(
        figure,
        "Error against time",
        f"{size['width']}×{size['height']}, whole calls; relMSE over {scenes} scene{'s' * (scenes != 1)}\n"
        f"{words(speed['machine'])}",
    )
    for axis, (count, points) in zip(axes[:, 0], panels.items(), strict=True):
        line = steps(front(points))
        axis.plot(*zip(*line, strict=True), color=FAINT, linewidth=2, zorder=1)
        for name, point in points.items():
            draw(axis, name, [point])
        logarithmic(axis)
        axis.margins(x=0.15, y=0.16)
        noisy = quality["means"].get(INPUT, {}).get(str(count))
        axis.set_title(
            f"{count} samples per pixel" + (f" (input: relMSE {noisy:.2g})" if noisy else ""),
            loc="left",
            fontsize=11,
        )
        axis.set_ylabel("relMSE")
    axes[-1, 0].set_xlabel("milliseconds per megapixel")
    figure.align_ylabels()
    settle(figure)
    for axis, points in zip(axes[:, 0], panels.values(), strict=True):
        label_points(axis, points, steps(front(points)))
    return figure


def nearest_size(speed: dict, wanted: tuple[int, int]) -> dict:
    """The size that was measured with about as many pixels as the one wanted."""
    return min(speed["sizes"], key=lambda size: abs(math.log(size["width"] * size["height"] / math.prod(wanted))))


def sizes(speed: dict) -> Figure:
    """Time against megapixels."""
    lines: dict[str, list[Pair]] = {}
    for size in speed["sizes"]:
        for one in size["timings"]:
            point = size["width"] * size["height"] / 1e6, 1e3 * statistics.median(one["seconds"])
            lines.setdefault(one["name"], []).append(point)
    subtitle = f"Whole calls, from and to the host's memory, median\n{words(speed['machine'])}"
    return line_chart(lines, "Time against size", subtitle, "megapixels", "milliseconds", lambda x: f"{x:.2g}")


def samples(figures: dict) -> Figure:
    """Error against samples per pixel."""
    lines = {name: [(int(n), value) for n, value in values.items()] for name, values in figures["relmse"].items()}
    subtitle = (
        f"Scene {figures['scene']} of this repository, {figures['width']}×{figures['height']}, "
        f"reference of {figures['reference_spp']} samples per pixel\n"
        "Ringed: from here on the input is nearer to the reference"
    )
    chart = line_chart(
        lines, "Where each method stops helping", subtitle, "samples per pixel", "relMSE", "{:.0f}".format
    )
    for name, line in lines.items():
        meeting = crossing(line, lines[INPUT]) if name != INPUT else None
        if meeting:
            chart.axes[0].plot(
                *meeting, "o", mfc="none", mec=style(name)[0], markersize=14, markeredgewidth=1.6, zorder=4
            )
    return chart


def crossing(line: Sequence[Pair], noisy: Sequence[Pair]) -> Pair | None:
    """Where a line first meets the input's from below, interpolated on logarithmic axes."""
    both = [(n, a, b) for (n, a), (m, b) in zip(line, noisy, strict=True) if n == m and a > 0 and b > 0]
    for (n, a, b), (m, c, d) in pairwise(both):
        before, after = math.log(a / b), math.log(c / d)
        if before < 0 <= after:
            part = before / (before - after)
            return n * (m / n) ** part, a * (c / a) ** part
    return None


def line_chart(
    lines: dict[str, list[Pair]], heading: str, subtitle: str, x: str, y: str, tick: Callable[[float], str]
) -> Figure:
    """A line a denoiser, with its name at the right end; points of 0 or less, lost in noise, are left out."""
    figure, axis = plt.subplots(figsize=(WIDTH, 5.6), layout="constrained")
    title(figure, heading, subtitle)
    drawn = {name: [point for point in line if point[1] > 0] for name, line in lines.items()}
    drawn = {name: line for name, line in drawn.items() if line}
    for name, line in drawn.items():
        draw(axis, name, line, "--" if name == INPUT else "-")
    logarithmic(axis)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.set_xticks(sorted({point[0] for line in drawn.values() for point in line}))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: tick(value)))
    axis.xaxis.set_minor_locator(NullLocator())
    right = max(point[0] for line in drawn.values() for point in line)
    left = min(point[0] for line in drawn.values() for point in line)
    # Room for the names: about a third of the width, on a logarithmic axis.
    axis.set_xlim(left / (right / left) ** 0.03, right * max(right / left, 2) ** 0.36)
    axis.margins(y=0.06)
    settle(figure)
    label_ends(axis, drawn)
    return figure


def load(path: Path, name: str) -> dict:
    """The figures of one script, from its own file or from one of `gpu.sh`, which holds several under their names."""
    figures = json.loads(path.read_text())
    return figures.get(name, figures)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quality", type=Path, help="what quality.py --json wrote")
    parser.add_argument("--speed", type=Path, help="what speed.py --json wrote")
    parser.add_argument("--samples", type=Path, help="what samples.py --json wrote")
    parser.add_argument(
        "--size", nargs=2, type=int, default=(1280, 720), metavar=("W", "H"), help="of the Pareto chart"
    )
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder for the charts")
    options = parser.parse_args()
    if not (options.speed or options.samples):
        parser.error("there is nothing to draw: give --speed, --speed and --quality, or --samples")
    options.out.mkdir(parents=True, exist_ok=True)
    matplotlib.use("Agg")
    matplotlib.rcParams |= {"svg.hashsalt": "mcdenoise", "text.color": INK, "axes.labelcolor": INK}
    given: dict[str, Any] = {
        name: load(path, name)
        for name, path in (("quality", options.quality), ("speed", options.speed), ("samples", options.samples))
        if path
    }
    if "quality" in given and "speed" in given:
        save(pareto(given["quality"], given["speed"], tuple(options.size)), options.out, "pareto")
    if "speed" in given:
        save(sizes(given["speed"]), options.out, "sizes")
    if "samples" in given:
        save(samples(given["samples"]), options.out, "samples")


if __name__ == "__main__":
    main()
