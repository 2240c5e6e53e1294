"""Further layers of an EXR file that are filtered with its colour: finding, reading and replacing them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .errors import ExrError
from .exr import cast, frame_of, layers_of, stacked
from .exr_file import Part, load
from .exr_layers import Layer, describe, moment_base, result_layer
from .frame import Frame
from .light_groups import find_groups

Also = Sequence[str] | Literal["auto"]
StrPath = str | os.PathLike[str]

#: Words that Blender Cycles gives the passes whose product, and not whose sum, is light.
CYCLES = {f"{kind}{what}" for kind in ("diff", "gloss", "trans") for what in ("dir", "ind")}


@dataclass(frozen=True)
class AlsoLayers:
    """Layers to be filtered with the colour.

    Attributes:
        images: (H, W, 3) by the name of the layer, as it is stored.
        groups: those names whose layers sum to the colour, where they were looked for.
        notes: what a user may not expect.
    """

    images: Mapping[str, np.ndarray]
    groups: tuple[tuple[str, ...], ...] = ()
    notes: tuple[str, ...] = ()


def read_also(path: StrPath, also: Also = "auto", *, layers: Mapping[str, str] | None = None) -> dict[str, np.ndarray]:
    """Further RGB layers of an EXR file, to be filtered with its colour: what `denoise` takes as `also`.

    Args:
        path: the file.
        also: names of layers, as for `also_of`; "auto" for all that in groups sum to the colour, {} if there are none.
        layers: as for `read_exr`; of them only `color` matters, and that features are no light.

    Raises:
        ExrError: the file cannot be read, or a name is not that of one RGB layer over the pixels of the colour.

    Example:
        >>> import tempfile
        >>> from mcdenoise_cl import write_exr
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_exr(folder + "/frame.exr", Frame(*[np.ones((4, 6, 3), np.float32)] * 2))
        ...     {name: layer.shape for name, layer in read_also(folder + "/frame.exr", ["albedo"]).items()}
        {'albedo': (4, 6, 3)}
    """
    parts = load(path)
    return dict(also_of(path, parts, also, frame_of(path, parts, layers), layers).images)


def also_of(
    path: StrPath, parts: Sequence[Part], also: Also, frame: Frame, layers: Mapping[str, str] | None = None
) -> AlsoLayers:
    """The layers that were asked for, or "auto": those that in groups sum to the colour.

    Args:
        path: the name of the file, for messages.
        parts: what `load` made of it.
        also: names of RGB layers as the file has them, whole or, like "diffuse" for "ViewLayer.diffuse", their ends.
        frame: what `frame_of` made of the parts: a feature is no light.
        layers: as for `read_exr`; of them only `color` matters.

    Raises:
        ExrError: a name is not that of one RGB layer over the pixels of the colour, or is that of the colour.
    """
    if not also:
        return AlsoLayers({})
    color, light = _light(path, parts, layers)
    if also == "auto":
        taken = frame.metadata["layers"].values()
        return _found(parts, color, [c for c in light if c.title not in taken and moment_base(c) is None])
    wanted = {layer.title: layer for layer in (_named(path, light, color, name) for name in also)}
    return AlsoLayers({name: stacked(parts, layer) for name, layer in wanted.items()})


def replace_also(
    path: StrPath,
    parts: Sequence[Part],
    images: Mapping[str, np.ndarray],
    layers: Mapping[str, str] | None = None,
    dtype: np.dtype | None = None,
) -> list[Part]:
    """The parts of a file with images, by the names of layers that `also_of` gives, in the place of these layers.

    Raises:
        ExrError: there is no such layer, or an image has not its height and width, or lies on a device.
    """
    parts = list(parts)
    color, light = _light(path, parts, layers) if images else (None, [])
    for name, image in images.items():
        layer = _named(path, light, color, name)
        old = parts[layer.part].channels
        shape = (*old[layer.channels[0]][0].shape, 3)
        if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype.kind != "f":
            kind = f"{image.dtype} of {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
            raise ExrError(f"the image for the layer {name} is a {kind} but a host array of {shape} floats is needed")
        new = {c: (cast(image[..., i], dtype or old[c][0].dtype), old[c][1]) for i, c in enumerate(layer.channels)}
        parts[layer.part] = replace(parts[layer.part], channels=old | new)
    return parts


def _light(path: StrPath, parts: Sequence[Part], layers: Mapping[str, str] | None) -> tuple[Layer, list[Layer]]:
    """The colour, and all other RGB layers over its pixels, but that in whose place it goes."""
    known, _, color = layers_of(path, parts, layers)
    window, whole = parts[color.part].window, (color, result_layer(known, color))
    return color, [
        c for c in known if c.suffix in ("RGB", "RGBA") and c not in whole and parts[c.part].window == window
    ]


def _named(path: StrPath, light: Sequence[Layer], color: Layer, name: str) -> Layer:
    key = name.strip().casefold()
    found = [layer for layer in light if layer.title == name.strip()]
    found = found or [layer for layer in light if layer.title.casefold() == key]
    found = found or [layer for layer in light if layer.answers_to(key)]
    if len(found) == 1:
        return found[0]
    if found:
        raise ExrError(f"{path}: {name} could be any of {describe(found)}: give the full name")
    if color.title.casefold() == key or color.answers_to(key):
        raise ExrError(f"{path}: {name} is the colour itself, which is filtered anyway: leave it out")
    raise ExrError(f"{path}: {name} is no RGB layer over the pixels of the colour: there are {describe(light)}")


def _found(parts: Sequence[Part], color: Layer, light: Sequence[Layer]) -> AlsoLayers:
    titles = [layer.title for layer in light]
    images = {layer.title: stacked(parts, layer) for layer in light if titles.count(layer.title) == 1}
    groups = find_groups(stacked(parts, color), images)
    chosen = {name for group in groups for name in group}
    notes = []
    if not groups:
        notes.append(f"no group of the layers {describe(light)} sums to the colour, which alone was filtered")
        if any(layer.title.rpartition(".")[2].casefold() in CYCLES for layer in light):
            notes.append("light passes of Cycles sum to it only after they are multiplied by their colours")
    return AlsoLayers({name: image for name, image in images.items() if name in chosen}, groups, tuple(notes))
