"""How the charts of `chart.py` look: colours, axes, titles, and labels beside points and ends of lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
from labels import Box, place, spread
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

Pair = tuple[float, float]
#: Width of the README's column in inches, at which fonts have their size; PNGs have twice its pixels.
WIDTH, DPI = 9.0, 200
INK, FAINT = "#222222", "#c8c8c8"
#: Colour and marker by method, whatever its preset; peers are grey, for the chart is about ours beside them.
STYLES = {
    "auto": ("#0072b2", "o"),
    "regression": ("#009e73", "s"),
    "guided": ("#d55e00", "^"),
    "ssim-nlm": ("#cc79a7", "D"),
    "nlm": ("#b8860b", "v"),
    "OIDN": ("#5a5a5a", "P"),
    "OpenCV": ("#5a5a5a", "X"),
    "scikit-image": ("#5a5a5a", "*"),
    "input": (INK, "."),
}


def style(name: str) -> tuple[str, str]:
    """Colour and marker of a name such as "auto, fast" or "OIDN high, colour only"."""
    return STYLES.get(name.split(",")[0].split(" ")[0], (INK, "o"))


def draw(axis: Axes, name: str, line: Sequence[Pair], stroke: str = "-") -> None:
    color, marker = style(name)
    width = 1.0 if color == STYLES["OIDN"][0] else 1.8
    size = {"*": 11, ".": 6, "D": 6.5}.get(marker, 8)
    axis.plot(
        *zip(*line, strict=True),
        stroke,
        color=color,
        marker=marker,
        markersize=size,
        linewidth=width,
        mec="white",
        zorder=3,
    )


def logarithmic(axis: Axes) -> None:
    axis.set_xscale("log")
    axis.set_yscale("log")
    for one in (axis.xaxis, axis.yaxis):
        one.set_major_locator(LogLocator(subs=(1, 2, 5)))
        one.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        one.set_minor_locator(NullLocator())
    axis.grid(color="#ececec", linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def title(figure: Figure, heading: str, subtitle: str) -> None:
    """Two sizes of text at the top left, and the charts below them."""
    height = figure.get_figheight()
    figure.text(0.012, 1 - 0.1 / height, heading, ha="left", va="top", fontsize=14, fontweight="bold")
    figure.text(0.012, 1 - 0.38 / height, subtitle, ha="left", va="top", fontsize=10, color="#444444")
    taken = 0.5 + 0.18 * len(subtitle.splitlines())
    figure.get_layout_engine().set(rect=(0, 0, 1, 1 - taken / height))


def settle(figure: Figure) -> None:
    """Lay out and keep it so, limits too, because labels are placed in pixels."""
    figure.canvas.draw()
    figure.set_layout_engine("none")
    for axis in figure.axes:
        axis.autoscale(False)


def label_points(axis: Axes, points: dict[str, Pair], line: Sequence[Pair]) -> None:
    """The name of every point beside it, with a line to it where it is not next to it."""
    figure = axis.figure
    pixels = [tuple(axis.transData.transform(point)) for point in points.values()]
    front_line = [tuple(axis.transData.transform(point)) for point in line]
    extents = [text_size(axis, name) for name in points]
    frame = axis.get_window_extent()
    area = Box(frame.x0 + 4, frame.y0 + 4, frame.x1 - 2, frame.y1 - 4)
    scale = figure.dpi / 72
    boxes = place(pixels, extents, area, 5 * scale, list(pairwise(front_line)))
    for name, point, pixel, box in zip(points, points.values(), pixels, boxes, strict=True):
        near = box.nearest(pixel)
        if math.dist(near, pixel) > 10 * scale:
            ends = axis.transData.inverted().transform([pixel, near])
            axis.plot(*zip(*ends, strict=True), color=style(name)[0], linewidth=0.7, zorder=2)
        offset = (box.left - pixel[0]) / scale + 2, (box.bottom - pixel[1]) / scale + 1
        write(axis, name, point, offset, va="bottom")


def label_ends(axis: Axes, lines: dict[str, list[Pair]]) -> None:
    """The name of every line right of its end, pushed up or down where two would meet."""
    scale = axis.figure.dpi / 72
    ends = {name: tuple(axis.transData.transform(line[-1])) for name, line in lines.items()}
    frame = axis.get_window_extent()
    gap = max(text_size(axis, name)[1] for name in lines)
    heights = spread([end[1] for end in ends.values()], gap, frame.y0 + gap / 2, frame.y1 - gap / 2)
    column = max(end[0] for end in ends.values()) + 26 * scale
    for (name, end), height in zip(ends.items(), heights, strict=True):
        knee = axis.transData.inverted().transform([(end[0] + 6 * scale, end[1]), (column - 3 * scale, height)])
        axis.plot(*zip(*knee, strict=True), color=style(name)[0], linewidth=0.7, zorder=2)
        write(axis, name, lines[name][-1], ((column - end[0]) / scale, (height - end[1]) / scale), va="center")


def write(axis: Axes, name: str, point: Pair, offset: Pair, va: str) -> None:
    axis.annotate(name, point, offset, textcoords="offset points", ha="left", va=va, color=style(name)[0], fontsize=10)


def text_size(axis: Axes, name: str) -> Pair:
    """Width and height of a label in pixels, with a little room around it."""
    text = axis.text(0, 0, name, fontsize=10, transform=None)
    extent = text.get_window_extent()
    text.remove()
    return extent.width + 4 * axis.figure.dpi / 72, extent.height + 2 * axis.figure.dpi / 72


def save(figure: Figure, folder: Path, name: str) -> None:
    for ending in ("png", "svg"):
        # Without the date a chart of the same figures is the same file.
        figure.savefig(folder / f"{name}.{ending}", dpi=DPI, metadata={"Date": None} if ending == "svg" else None)
    plt.close(figure)
