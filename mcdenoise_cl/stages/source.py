"""A frame's arrays, let in whole or in bands of rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from .door import Strided, door
from .rows import Rows, cut
from .variance import UNKNOWN


@dataclass(frozen=True)
class Source:
    """A frame's arrays on the device, to be let in whole or in bands.

    Attributes:
        arrays: by the name of the plane.
        height, width: of the frame.
        bad: a counter for each array, of the pixels that were replaced.
        most: rows of a band, at most.
    """

    engine: Engine
    arrays: dict[str, Strided]
    height: int
    width: int
    bad: cl.MemoryObjectHolder
    most: int

    def planes(self, rows: Rows, names: Iterable[str] | None = None, count: bool = False) -> dict[str, Planes]:
        """The planes of some rows, by name; `count` the bad pixels among those that are wanted."""
        slots = {name: slot for slot, name in enumerate(self.arrays)}
        size = self.height, self.width
        planes = {}
        for name in self.arrays if names is None else names:
            lost = UNKNOWN if name == "color_variance" else 0.0
            planes[name] = door(self.engine, self.arrays[name], *size, self.bad, slots[name], rows, count, lost)
        return planes

    def sweep(self, name: str, reach: int = 0) -> Iterator[tuple[Planes, Rows]]:
        """One plane after the other, each band with `reach` rows around."""
        for rows in cut(self.height, self.most, reach, 1):
            yield self.planes(rows, [name])[name], rows
