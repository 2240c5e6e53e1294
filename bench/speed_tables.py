"""What `speed.py` makes of its figures: tables, ratios and how time grows with the frame."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from entries import ENTRIES, method_of

#: (slower, faster): how many times as fast the second is. The slow baselines first, then the strong one.
PAIRS = [("scikit-image NLM", name) for name in ENTRIES if method_of(name) in ("nlm", "ssim-nlm")]
PAIRS += [("OIDN high", name) for name in ENTRIES if method_of(name) in ("guided", "regression", "auto")]
#: What the largest frame is compared with, where it was measured.
BASE = (1280, 720)


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median and upper quartile; of one value, three times itself."""
    if len(values) == 1:
        return values[0], values[0], values[0]
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return low, middle, high


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table, the first column to the left and the others to the right."""
    lines = [f"| {' | '.join(head)} |", "|:---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)])


def milliseconds(ms: float) -> str:
    """Three digits."""
    return f"{ms:.0f}" if ms >= 100 else f"{ms:.1f}" if ms >= 10 else f"{ms:.2f}"


def size_table(size: dict[str, Any]) -> str:
    """The denoisers at one size."""
    head = ("", "median, ms", "middle half, ms", "fastest, ms", "on the device, ms", "host, MiB", "device, MiB")
    rows = []
    for one in size["timings"]:
        low, middle, high = (milliseconds(1e3 * seconds) for seconds in quartiles(one["seconds"]))
        fastest = milliseconds(1e3 * min(one["seconds"]))
        on_device = milliseconds(statistics.median(one["device_ms"])) if one["device_ms"] else ""
        device_bytes = "" if one["device_bytes"] is None else f"{one['device_bytes'] / 2**20:.0f}"
        host = f"{one['host_bytes'] / 2**20:.0f}"
        rows.append((one["name"], middle, f"{low}–{high}", fastest, on_device, host, device_bytes))
    return table(head, rows)


def stage_table(timing: dict[str, Any]) -> str:
    """The stages of one denoiser, the longest first."""
    total = sum(timing["stages"].values())
    stages = sorted(timing["stages"].items(), key=lambda item: -item[1])
    rows = [(stage, f"{ms:.3f}", f"{100 * ms / total:.1f}") for stage, ms in stages]
    return table(("stage", "ms", "%"), [*rows, ("all", f"{total:.3f}", "100")])


def first_table(first: list[dict[str, Any]]) -> str:
    rows = [
        (one["name"], f"{one['width']}x{one['height']}", f"{one['empty']:.2f}", f"{one['filled']:.2f}") for one in first
    ]
    return table(("", "frame", "empty caches", "filled caches"), rows)


def ratios(sizes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each pair and size the quartiles of slower / faster over the rounds, in which both ran side by side."""
    found = []
    for size in sizes:
        seconds = {one["name"]: one["seconds"] for one in size["timings"]}
        for slower, faster in PAIRS:
            if slower in seconds and faster in seconds:
                each = [a / b for a, b in zip(seconds[slower], seconds[faster], strict=True)]
                low, middle, high = quartiles(each)
                facts = {"slower": slower, "faster": faster, "width": size["width"], "height": size["height"]}
                found.append({**facts, "ratio": middle, "low": low, "high": high})
    return found


def ratio_table(found: list[dict[str, Any]]) -> str:
    """A pair a row, a size a column."""
    sizes = list(dict.fromkeys((one["width"], one["height"]) for one in found))
    cells = {(one["slower"], one["faster"], one["width"], one["height"]): one for one in found}
    rows = []
    for slower, faster in dict.fromkeys((one["slower"], one["faster"]) for one in found):
        row = [f"{slower} / {faster}"]
        for size in sizes:
            one = cells.get((slower, faster, *size))
            row.append(f"{one['ratio']:.2f} ({one['low']:.2f}–{one['high']:.2f})" if one else "")
        rows.append(row)
    return table(("", *(f"{width}x{height}" for width, height in sizes)), rows)


def scaling(sizes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Time a pixel at the largest size over that at BASE, or at the smallest size; nothing if there is one size."""
    if len(sizes) < 2:
        return []
    largest = sizes[-1]
    base = next((one for one in sizes[:-1] if (one["width"], one["height"]) == BASE), sizes[0])
    found = []
    for one in largest["timings"]:
        other = next((timing for timing in base["timings"] if timing["name"] == one["name"]), None)
        if other:
            times = statistics.median(one["seconds"]) / statistics.median(other["seconds"])
            pixels = largest["width"] * largest["height"] / (base["width"] * base["height"])
            frames = {key: f"{size['width']}x{size['height']}" for key, size in (("large", largest), ("small", base))}
            found.append({"name": one["name"], **frames, "time": times, "pixels": pixels, "ratio": times / pixels})
    return found


def scaling_table(found: list[dict[str, Any]]) -> str:
    head = ("", f"time, {found[0]['large']} / {found[0]['small']}", "pixels", "time a pixel")
    return table(
        head, [(one["name"], f"{one['time']:.2f}", f"{one['pixels']:.2f}", f"{one['ratio']:.2f}") for one in found]
    )
