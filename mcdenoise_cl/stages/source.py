"""A frame's arrays, let in whole or in bands of rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import pyopencl as cl

from ..engine import Engine, Planes
from .also import each_layer
from .door import Strided, door
from .rows import Rows, cut
from .variance import UNKNOWN

#: What methods find further layers under, among the planes of a frame.
ALSO = "also"


@dataclass(frozen=True)
class Source:
    """A frame's arrays on the device, to be let in whole or in bands.

    Attributes:
        arrays: by the name of the plane.
        height, width: of the frame.
        bad: a counter for each array, of the pixels that were replaced.
        most: rows of a band, at most.
        also: those of the arrays that are further layers of the colour, three channels each.
    """

    engine: Engine
    arrays: dict[str, Strided]
    height: int
    width: int
    bad: cl.MemoryObjectHolder
    most: int
    also: tuple[str, ...] = ()

    def planes(self, rows: Rows, names: Iterable[str] | None = None, count: bool = False) -> dict[str, Planes]:
        """The planes of some rows, by name; `count` the bad pixels among those that are wanted.

        Without names all of them. Under the name ALSO come the layers, if there are any, as one set of planes.
        """
        slots = {name: slot for slot, name in enumerate(self.arrays)}
        size = self.height, self.width

        def let_in(name: str, out: Planes | None = None) -> Planes:
            lost = UNKNOWN if name == "color_variance" else 0.0
            return door(self.engine, self.arrays[name], *size, self.bad, slots[name], rows, count, lost, out)

        if names is None:
            names = [name for name in self.arrays if name not in self.also] + [ALSO] * bool(self.also)
        planes = {}
        for name in names:
            if name != ALSO:
                planes[name] = let_in(name)
                continue
            planes[ALSO] = self.engine.planes(3 * len(self.also), rows.stop - rows.start, self.width)
            for array, layer in zip(self.also, each_layer(planes[ALSO]), strict=True):
                let_in(array, layer)
        return planes

    def sweep(self, name: str, reach: int = 0) -> Iterator[tuple[Planes, Rows]]:
        """One plane after the other, each band with `reach` rows around."""
        for rows in cut(self.height, self.most, reach, 1):
            yield self.planes(rows, [name])[name], rows
