"""Places for the labels of points and lines in a chart, so that none covers another. Plain numbers, no drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Point = tuple[float, float]
#: Ways a label can lie from its point: right first, which reads best.
DIRECTIONS = [
    math.radians(angle) for angle in (0, 25, -25, 180, 155, 205, 50, -50, 130, 230, 75, -75, 105, 255, 90, 270)
]
#: Distances from the point, in units of the label's height.
DISTANCES = (0.45, 0.8, 1.2, 1.7, 2.3, 3.0, 3.8, 4.8, 6.0, 7.5)
#: What is bad about a place: pixels of another label, point or border covered; lines crossed; distance.
COVERED, CROSSED, FAR, TURNED = 2.0, 60.0, 1.0, 0.15


@dataclass(frozen=True)
class Box:
    """A rectangle, x to the right and y upwards."""

    left: float
    bottom: float
    right: float
    top: float

    def common(self, other: Box) -> float:
        """The area that both cover."""
        width = min(self.right, other.right) - max(self.left, other.left)
        height = min(self.top, other.top) - max(self.bottom, other.bottom)
        return width * height if width > 0 and height > 0 else 0.0

    def nearest(self, point: Point) -> Point:
        """The point of the rectangle that is nearest to another."""
        return min(max(point[0], self.left), self.right), min(max(point[1], self.bottom), self.top)

    def meets(self, a: Point, b: Point) -> bool:
        """Whether a segment passes through."""
        corners = [(self.left, self.bottom), (self.right, self.bottom), (self.right, self.top), (self.left, self.top)]
        inside = self.left < a[0] < self.right and self.bottom < a[1] < self.top
        return inside or any(cross(a, b, corners[i - 1], corners[i]) for i in range(4))

    @property
    def area(self) -> float:
        return (self.right - self.left) * (self.top - self.bottom)


def cross(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Whether two segments cross."""

    def side(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0


def place(
    points: Sequence[Point],
    sizes: Sequence[Point],
    area: Box,
    marker: float,
    lines: Sequence[tuple[Point, Point]] = (),
) -> list[Box]:
    """A rectangle for the label of each point.

    Greedy: each label takes the place that is least bad beside those already placed, those with most neighbours first;
    then all choose again a few times, now knowing of the others.

    Args:
        points: in pixels.
        sizes: (width, height) of each label.
        area: where labels may be.
        marker: half the width of a point's marker, which no label may cover.
        lines: segments that labels should not cover.
    """
    markers = [Box(x - marker, y - marker, x + marker, y + marker) for x, y in points]
    candidates = [_candidates(point, size) for point, size in zip(points, sizes, strict=True)]

    def crowd(i: int) -> int:
        (x, y), (width, height) = points[i], sizes[i]
        return -sum(abs(x - a) < width and abs(y - b) < 3 * height for a, b in points)

    order = sorted(range(len(points)), key=crowd)
    chosen: dict[int, Box] = {}
    for _ in range(6):
        before = dict(chosen)
        for i in order:
            others = {j: box for j, box in chosen.items() if j != i}
            chosen[i] = min(
                candidates[i],
                key=lambda one, i=i, others=others: _badness(one, i, points, others, markers, area, lines),
            )[0]
        if chosen == before:
            break
    return [chosen[i] for i in range(len(points))]


def _candidates(point: Point, size: Point) -> list[tuple[Box, float]]:
    """Places for a label, each with what it costs by itself."""
    (x, y), (width, height) = point, size
    found = []
    for distance in DISTANCES:
        for rank, angle in enumerate(DIRECTIONS):
            middle_x = x + math.cos(angle) * (distance * height + width / 2)
            middle_y = y + math.sin(angle) * (distance * height + height / 2)
            box = Box(middle_x - width / 2, middle_y - height / 2, middle_x + width / 2, middle_y + height / 2)
            near = math.dist(point, box.nearest(point))
            found.append((box, height * TURNED * rank + FAR * near))
    return found


def _badness(
    one: tuple[Box, float],
    i: int,
    points: Sequence[Point],
    others: dict[int, Box],
    markers: Sequence[Box],
    area: Box,
    lines: Sequence[tuple[Point, Point]],
) -> float:
    box, bad = one
    bad += COVERED * sum(box.common(other) for other in others.values())
    bad += COVERED * sum(box.common(other) for other in markers)
    bad += COVERED * (box.area - box.common(area))
    # A label just outside of another's rectangle may still sit on its leader, or its own leader pass through one.
    leader = (points[i], box.nearest(points[i]))
    for j, other in others.items():
        its = (points[j], other.nearest(points[j]))
        bad += CROSSED * (other.meets(*leader) + box.meets(*its) + cross(*leader, *its))
    bad += CROSSED * sum(marker.meets(*leader) for j, marker in enumerate(markers) if j != i)
    return bad + CROSSED / 4 * sum(box.meets(*line) for line in lines)


def spread(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Heights as near to those wanted as they can be with a gap between any two, in the same order.

    Example:
        >>> spread([0, 1, 10], 4, 0, 20)
        [0, 4, 10]
    """
    order = sorted(range(len(wanted)), key=lambda i: wanted[i])
    # Groups of labels that touch, each as (their sum of wanted first places, how many): pooled until none overlap.
    groups: list[list[float]] = []
    for i in order:
        groups.append([wanted[i], 1])
        while len(groups) > 1 and _start(groups[-2], gap, low, high) + gap * groups[-2][1] > _start(
            groups[-1], gap, low, high
        ):
            total, count = groups.pop()
            groups[-1][0] += total - gap * groups[-1][1] * count
            groups[-1][1] += count
    placed = [_start(group, gap, low, high) + gap * k for group in groups for k in range(int(group[1]))]
    result = [0.0] * len(wanted)
    for i, height in zip(order, placed, strict=True):
        result[i] = height
    return result


def _start(group: Sequence[float], gap: float, low: float, high: float) -> float:
    """Where the lowest label of a group goes: the mean of what its labels want of it, within bounds."""
    total, count = group
    return max(low, min(total / count, high - gap * (count - 1)))
