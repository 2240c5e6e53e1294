"""Motion vectors in EXR files: where the pixels of a frame were, or will be, in the frames before and after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .exr_file import Part
from .exr_layers import Layer
from .frame import VECTORS, Frame

#: The channels under which this project writes motion vectors: pixels to the right, and down.
OWN_VECTORS: dict[str, tuple[str, str]] = {
    "to_previous": ("motion.prev.X", "motion.prev.Y"),
    "to_next": ("motion.next.X", "motion.next.Y"),
}


def vectors_of(
    parts: Sequence[Part], layers: Sequence[Layer], color: Layer
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The motion vectors of a frame, `to_previous` and `to_next`, (H, W, 2), as they are stored; and their layers.

    Taken are this project's own channels and Blender's pass Vector, which belongs to the colour by its view layer;
    each is in pixels a frame and says of which frame. Arnold's `motionvector` does not: the time it spans is that of
    the shutter, which is not in the file, and its shader may scale it.

    Args:
        layers: those over the pixels of the colour.
    """
    part = parts[color.part]
    own = {name: channels for name, channels in OWN_VECTORS.items() if all(c in part.planes for c in channels)}
    if own:
        pixels = {name: [part.channels[c][0] for c in channels] for name, channels in own.items()}
        vectors = {name: np.stack(pair, axis=-1) for name, pair in pixels.items()}
        return vectors, tuple(channels[0].rpartition(".")[0] for channels in own.values())
    found = [layer for layer in layers if layer.suffix == "XYZW" and layer.answers_to("vector")]
    if len(found) > 1:
        found = [layer for layer in found if layer.parent == color.parent]
    if len(found) != 1:
        return {}, ()
    return _of_cycles(parts[found[0].part], found[0]), (found[0].title,)


def _of_cycles(part: Part, layer: Layer) -> dict[str, np.ndarray]:
    """Cycles writes X Y = previous - here and Z W = here - next, in pixels with y upwards (`primitive_motion_vector` in
    its kernel/geom/primitive.h), and Blender turns only the order of the rows round when it writes an EXR file."""
    stem = layer.channels[0][:-1]
    last = next(name for name in part.planes if name[:-1] == stem and name[-1:] in "Ww")
    x, y, z, w = (part.channels[name][0] for name in (*layer.channels, last))
    return {"to_previous": np.stack([x, -y], axis=-1), "to_next": np.stack([-z, w], axis=-1)}


def own_vectors(frame: Frame) -> Mapping[str, np.ndarray]:
    """The motion vectors of a frame by the channels under which this project writes them."""
    return {
        channel: getattr(frame, name)[..., i]
        for name in VECTORS
        if getattr(frame, name) is not None
        for i, channel in enumerate(OWN_VECTORS[name])
    }
