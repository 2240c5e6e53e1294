"""Time against error as an SVG picture: every method a point with its name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape

WIDTH, HEIGHT = 640, 340
LEFT, RIGHT, TOP, BOTTOM = 64, 20, 16, 48
#: Width of a letter of a label, and how far apart the lines of labels are.
LETTER, LINE = 8, 15
#: Shapes for those who do not tell the colours apart, about the origin.
SHAPES = (
    '<circle r="6"/>',
    '<rect x="-5.5" y="-5.5" width="11" height="11"/>',
    '<path d="M0-7 7 5.5H-7Z"/>',
    '<path d="M0-7.5 7.5 0 0 7.5-7.5 0Z"/>',
    '<path d="M0 7-7-5.5H7Z"/>',
)


def chart(times: Mapping[str, float], errors: Mapping[str, float], start: float | None = None) -> str:
    """SVG of the errors (relMSE) over the times (seconds), both logarithmic; "" where no two go together.

    Args:
        times: name -> seconds.
        errors: name -> relMSE; what is not above 0 has no place on the scale and is left out.
        start: the input's error, drawn as a line across.

    Example:
        >>> text = chart({"nlm": 0.1, "auto": 1.0}, {"nlm": 0.05, "auto": 0.01}, 0.8)
        >>> text.startswith("<svg"), text.count("<text")
        (True, 16)
    """
    points = {name: (1e3 * times[name], errors[name]) for name in times if name in errors and errors[name] > 0}
    points = {name: (x, y) for name, (x, y) in points.items() if x > 0 and math.isfinite(x) and math.isfinite(y)}
    if not points:
        return ""
    lines = [start] if start is not None and start > 0 and math.isfinite(start) else []
    x0, x1 = _range([x for x, _ in points.values()])
    y0, y1 = _range([y for _, y in points.values()] + lines)

    def across(x: float) -> float:
        return LEFT + (math.log10(x) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT)

    def down(y: float) -> float:
        return HEIGHT - BOTTOM - (math.log10(y) - y0) / (y1 - y0) * (HEIGHT - TOP - BOTTOM)

    parts = []
    for x in _ticks(x0, x1):
        parts.append(f'<path class="grid" d="M{across(x):.1f} {TOP}V{HEIGHT - BOTTOM}"/>')
        parts.append(f'<text x="{across(x):.1f}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{x:g}</text>')
    for y in _ticks(y0, y1):
        parts.append(f'<path class="grid" d="M{LEFT} {down(y):.1f}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{down(y) + 4:.1f}" text-anchor="end">{y:g}</text>')
    for y in lines:
        parts.append(f'<path class="start" d="M{LEFT} {down(y):.1f}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text x="{WIDTH - RIGHT - 4}" y="{down(y) - 5:.1f}" text-anchor="end">input</text>')
    parts.append(f'<text x="{(LEFT + WIDTH - RIGHT) / 2}" y="{HEIGHT - 8}" text-anchor="middle">time, ms</text>')
    middle = (TOP + HEIGHT - BOTTOM) / 2
    parts.append(f'<text transform="translate(14 {middle})rotate(-90)" text-anchor="middle">relMSE</text>')
    places = {name: (across(x), down(y)) for name, (x, y) in points.items()}
    for number, (x, y) in enumerate(places.values()):
        shape = SHAPES[number % len(SHAPES)]
        parts.append(f'<g class="point" transform="translate({x:.1f} {y:.1f})">{shape}</g>')
    for name, (x, y, anchor) in _labels(places).items():
        parts.append(f'<text class="name" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(name)}</text>')
    said = "; ".join(f"{name}: {x:.0f} ms, relMSE {y:.3g}" for name, (x, y) in points.items())
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape("Time against error. " + said)}">'
        + "".join(parts)
        + "</svg>"
    )


def _range(values: list[float]) -> tuple[float, float]:
    """Powers of ten around them, with some room, at least a fifth of a decade."""
    low, high = math.log10(min(values)), math.log10(max(values))
    room = max(0.1, 0.12 * (high - low))
    return low - room, high + room


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between two powers of ten: 1, 2 and 5 of each decade, fewer over many decades."""
    steps = (1,) if high - low > 3 else (1, 2, 5)
    if high - low < 0.5:
        steps = (1, 1.5, 2, 3, 4, 5, 7)
    decades = range(math.floor(low), math.ceil(high) + 1)
    return [step * 10.0**d for d in decades for step in steps if low <= math.log10(step * 10.0**d) <= high]


def _labels(places: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float, str]]:
    """Where each name stands: beside its point, or as near to it as no other name or point is."""
    taken = [(x - 8, y - 8, x + 8, y + 8) for x, y in places.values()]
    found = {}
    for name, (x, y) in sorted(places.items(), key=lambda item: item[1][1]):
        width = LETTER * len(name)
        options = []
        for shift in (0, -LINE, LINE, -2 * LINE, 2 * LINE, -3 * LINE, 3 * LINE):
            options += [(x + 11, y + 4 + shift, "start"), (x - 11, y + 4 + shift, "end")]
        free = [o for o in options if _inside(_box(*o, width)) and not any(_meet(_box(*o, width), t) for t in taken)]
        found[name] = (free or options)[0]
        taken.append(_box(*found[name], width))
    return found


def _box(x: float, y: float, anchor: str, width: float) -> tuple[float, float, float, float]:
    left = x if anchor == "start" else x - width
    return left, y - 11, left + width, y + 3


def _inside(box: tuple[float, float, float, float]) -> bool:
    return box[0] >= LEFT and box[2] <= WIDTH - 2 and box[1] >= 0 and box[3] <= HEIGHT - BOTTOM


def _meet(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
