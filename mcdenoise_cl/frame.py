"""`Frame`: the named planes of one image, checked once, at the door."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import pyopencl.array as cl_array

from .errors import FrameError

#: Planes with three channels, (H, W, 3).
VECTOR_PLANES = (
    "color",
    "albedo",
    "normal",
    "color_variance",
    "albedo_variance",
    "normal_variance",
    "color_a",
    "color_b",
)
#: Planes with one channel, (H, W).
SCALAR_PLANES = ("depth", "depth_variance")
PLANES = VECTOR_PLANES + SCALAR_PLANES
#: Motion vectors of a frame, (H, W, 2), to the frames before and after it.
VECTORS = ("to_previous", "to_next")
#: What a frame has that is no plane of its picture.
_BESIDE = ("motion", *VECTORS, "metadata")
DTYPES = (np.dtype("f2"), np.dtype("f4"), np.dtype("f8"))


@dataclass(frozen=True, eq=False)
class Frame:
    """One rendered image and what the renderer knows about it.

    Every plane is a NumPy array, or every plane is a `pyopencl.array.Array`; float16, float32 or float64.
    Only `color` is required. Nothing is copied.

    Attributes:
        color: (H, W, 3), scene-linear radiance, any range.
        albedo: (H, W, 3), reflectance, usually in [0, 1]; 0 on lights and where a ray leaves the scene.
        normal: (H, W, 3), shading normal in world space, each component in [-1, 1].
        depth: (H, W), distance from the camera in scene units.
        color_variance, albedo_variance, normal_variance: (H, W, 3), variance of the pixel mean.
        depth_variance: (H, W), variance of the pixel mean.
        color_a, color_b: (H, W, 3), two independent renderings with half the samples each, whose mean is `color`.
        motion: (H, W, 2), only of a neighbour in a sequence: how far what each pixel of the frame shows has moved in
            this neighbour, to the right and down, in pixels. Pixel (x, y) of the frame is found here at
            (x + motion[y, x, 0], y + motion[y, x, 1]). None, and where it fits worse: it is searched for.
        to_previous, to_next: (H, W, 2), the same of this frame's own pixels: how far what they show is moved in the
            frame before and in the one after. `with_motion` makes the `motion` of neighbours of them.
        metadata: free-form facts, for instance `samples_per_pixel`.

    Raises:
        FrameError: a plane is missing its pair, or has a shape or dtype that cannot be used, or host and
            device arrays are mixed.

    Example:
        >>> import numpy as np
        >>> frame = Frame(np.ones((4, 6, 3), np.float32), depth=np.ones((4, 6), np.float16))
        >>> frame.shape, sorted(frame.planes())
        ((4, 6), ['color', 'depth'])
    """

    color: Any
    albedo: Any = None
    normal: Any = None
    depth: Any = None
    color_variance: Any = None
    albedo_variance: Any = None
    normal_variance: Any = None
    depth_variance: Any = None
    color_a: Any = None
    color_b: Any = None
    motion: Any = None
    to_previous: Any = None
    to_next: Any = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.color is None:
            raise FrameError("color is missing: every frame needs a colour plane of shape (H, W, 3)")
        if not isinstance(self.metadata, Mapping):
            raise FrameError(f"metadata is a {type(self.metadata).__name__}: pass a dict, or leave it out")
        for name, plane in self.planes().items():
            _check_type(name, plane)
            _check_shape(name, plane, tuple(self.color.shape[:2]), scalar=name in SCALAR_PLANES)
        vectors = {name: getattr(self, name) for name in ("motion", *VECTORS) if getattr(self, name) is not None}
        for name, plane in vectors.items():
            _check_type(name, plane)
            _check_motion(name, tuple(plane.shape), self.shape)
        if (self.color_a is None) != (self.color_b is None):
            have, lack = ("color_a", "color_b") if self.color_b is None else ("color_b", "color_a")
            raise FrameError(f"{have} is given but {lack} is not: pass both half buffers, or neither")
        for name in PLANES:
            feature = name.removesuffix("_variance")
            if feature != name and getattr(self, name) is not None and getattr(self, feature) is None:
                raise FrameError(f"{name} is given but {feature} is not: pass {feature} too, or leave {name} out")
        arrays = self.planes() | vectors
        kinds = {name: isinstance(plane, cl_array.Array) for name, plane in arrays.items()}
        if len(set(kinds.values())) > 1:
            host = next(name for name, on_device in kinds.items() if not on_device)
            device = next(name for name, on_device in kinds.items() if on_device)
            raise FrameError(
                f"{host} is a NumPy array but {device} is a device array: pass every plane on the same side"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        return tuple(self.color.shape[:2])

    @property
    def on_device(self) -> bool:
        """True when the planes are `pyopencl.array.Array`."""
        return isinstance(self.color, cl_array.Array)

    def planes(self) -> dict[str, Any]:
        """The planes that are present, by name, `color` first; without motion vectors."""
        present = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in _BESIDE}
        return {name: plane for name, plane in present.items() if plane is not None}


def check_vector(name: str, plane: Any, size: tuple[int, int]) -> None:
    """Whether something is an array of three channels that goes with a frame of this height and width.

    Raises:
        FrameError: it is not.
    """
    _check_type(name, plane)
    _check_shape(name, plane, size, scalar=False)


def _check_type(name: str, plane: Any) -> None:
    if not isinstance(plane, np.ndarray | cl_array.Array):
        raise FrameError(
            f"{name} is a {type(plane).__name__}: pass a NumPy array or a pyopencl.array.Array "
            "(numpy.asarray converts most others)"
        )
    dtype = np.dtype(plane.dtype)
    if dtype not in DTYPES:
        why = (
            f"integer pixels carry no scale, so convert them yourself, for instance {name}.astype('float32') / 255"
            if dtype.kind in "iu"
            else f"convert it with .astype('float32'){', after taking the real part' if dtype.kind == 'c' else ''}"
        )
        raise FrameError(f"{name} has dtype {dtype} but float16, float32 or float64 is needed: {why}")
    if isinstance(plane, np.ma.MaskedArray):
        raise FrameError(f"{name} is a masked array, whose mask would be lost: fill it first, {name}.filled(0)")


def _check_motion(name: str, shape: tuple[int, ...], size: tuple[int, int]) -> None:
    if shape != (*size, 2):
        which = "this neighbour" if name == "motion" else "that frame"
        hint = f": pass the two channels that belong to {which}" if shape[:2] == size and len(shape) == 3 else ""
        raise FrameError(f"{name} is {shape} but {(*size, 2)} is needed, pixels to the right and down{hint}")


def _check_shape(name: str, plane: Any, size: tuple[int, int], *, scalar: bool) -> None:
    shape = tuple(plane.shape)
    if 0 in shape:
        raise FrameError(f"{name} is {shape}, which has no pixels: a frame needs at least one")
    if scalar:
        if len(shape) != 2:
            channel_last = len(shape) == 3 and shape[:2] == size
            hint = f"pass one channel, {name}[..., 0]" if channel_last else "pass one value a pixel"
            raise FrameError(f"{name} is {shape} but (H, W) is needed: {hint}")
    elif len(shape) != 3 or shape[2] != 3:
        hint = "stack three channels last"
        if len(shape) == 3 and shape[0] == 3:
            hint = f"the channels come first, so pass numpy.moveaxis({name}, 0, -1)"
        elif len(shape) == 3 and shape[2] > 3:
            hint = f"pass {name}[..., :3]"
        raise FrameError(f"{name} is {shape} but (H, W, 3) is needed: {hint}")
    if shape[:2] != size:
        raise FrameError(f"{name} is {shape} but color is {(*size, 3)}: all planes of a frame share height and width")
