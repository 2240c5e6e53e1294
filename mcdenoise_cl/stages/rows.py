"""A frame in bands of rows: as many at a time as there is memory for."""

from __future__ import annotations

from dataclasses import dataclass

from ..engine import Planes

#: How many pixels of a row a work-item counts. A whole row of many layers has more turns than
#: tests/upstream/rusticl_loops.py gets.
STRETCH = 256


@dataclass(frozen=True)
class Rows:
    """Rows `start` to `stop` of a frame, of which `first` to `last` are wanted; the others are what those depend on."""

    start: int
    stop: int
    first: int
    last: int

    def wanted(self, planes: Planes) -> Planes:
        """Those that are wanted, of planes of all of them."""
        return planes.rows(self.first - self.start, self.last - self.first)


def cut(height: int, most: int, reach: int, align: int) -> list[Rows]:
    """Bands of at most `most` rows, each wanted row in one of them.

    Args:
        height: of the frame.
        most: at least 2 align + 2 reach, if it is less than `height`.
        reach: rows to each side that a row depends on.
        align: bands begin at multiples of this.
    """
    bands, first = [], 0
    while first < height:
        start = max(first - reach, 0) // align * align
        stop = min(start + most, height)
        last = stop if stop == height else (stop - reach) // align * align
        bands.append(Rows(start, stop, first, last))
        first = last
    return bands
