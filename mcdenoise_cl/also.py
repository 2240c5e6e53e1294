"""Further layers of a frame, such as light AOVs, that are filtered with what is found for its colour."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pyopencl.array as cl_array

from .errors import FrameError
from .frame import Frame, check_vector

#: The arrays of layers go by this and their names: a layer may be called as a plane is.
PREFIX = "also."


def check_layers(also: Mapping[str, Any] | None, frame: Frame) -> dict[str, Any]:
    """The layers that go with a frame, by PREFIX and name; {} for None.

    Raises:
        FrameError: not a dict of arrays, or one of them has not the shape or side of the frame's colour, or a dtype
            that cannot be used.

    Example:
        >>> import numpy as np
        >>> color = np.ones((4, 6, 3), np.float32)
        >>> list(check_layers({"diffuse": 0.5 * color}, Frame(color)))
        ['also.diffuse']
    """
    if also is None:
        return {}
    if not isinstance(also, Mapping):
        raise FrameError(f"also is a {type(also).__name__}: pass a dict of arrays by their names")
    for name, layer in also.items():
        if not isinstance(name, str):
            raise FrameError(f"also has the name {name!r}: give the names of layers as text")
        title = f"also[{name!r}]"
        check_vector(title, layer, frame.shape)
        if isinstance(layer, cl_array.Array) != frame.on_device:
            kinds = ("a device array", "a NumPy array")
            raise FrameError(
                f"{title} is {kinds[frame.on_device]} but color is {kinds[not frame.on_device]}: "
                "pass every plane on the same side"
            )
    return {PREFIX + name: layer for name, layer in also.items()}
