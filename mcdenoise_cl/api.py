"""`denoise` for one frame, `Denoiser` for many of one size."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from .denoiser import Denoiser
from .details import Denoised
from .errors import DeviceError, ParameterError
from .frame import Frame
from .inputs import as_frame

__all__ = ["Denoiser", "denoise"]


def denoise(
    frame_or_color: Frame | np.ndarray | cl_array.Array,
    *,
    albedo: Any = None,
    normal: Any = None,
    depth: Any = None,
    color_variance: Any = None,
    albedo_variance: Any = None,
    normal_variance: Any = None,
    depth_variance: Any = None,
    color_a: Any = None,
    color_b: Any = None,
    neighbours: Iterable[Frame] = (),
    method: str | None = None,
    preset: str | None = None,
    device: str | int | cl.Device | None = None,
    out: Any = None,
    also: Mapping[str, Any] | None = None,
    details: bool = False,
    max_memory_mb: int | None = None,
    **parameters: Any,
) -> Any:
    """Denoise one Monte Carlo rendering.

    Args:
        frame_or_color: a `Frame`, or an array (H, W, 3) of scene-linear colour, float16, float32 or float64: NumPy,
            or `pyopencl.array.Array`, which is filtered in its own context and on its own queue without a copy to
            the host.
        albedo, normal, depth, color_variance, albedo_variance, normal_variance, depth_variance, color_a, color_b:
            further planes of the frame where `frame_or_color` is an array; see `Frame`.
        neighbours: frames before and after it in a sequence, as for `Denoiser.__call__`: what they show of the same is
            merged into the frame first.
        method: a name of `methods()`.
        preset: "fast", "balanced" or "high" instead of a method; "high" if neither is given.
        device: index, part of a name, or `pyopencl.Device`, for NumPy input; None: the default device.
        out: an array of the same shape and side to write the result to.
        also: further layers by name, (H, W, 3) of the colour's side, to be filtered with the weights, models and shares
            found for the colour, which stays the same to the last bit. Layers that sum to the colour sum to the clean
            one, to about 1e-6 of what lies in the window; one may go a little below 0 where a fit overshoots. The clean
            layers are in `Denoised.also`, so pass `details`. With `average="tonemapped"` a layer is filtered as a part
            of each pixel, and is 0 where the colour is.
        details: return a `Denoised`, with the layers of `also`, the maps of what was used where and of the estimated
            error.
        max_memory_mb: MiB that may be kept at a time besides input and output; see `Denoiser`.
        **parameters: the method's, by name: see `methods()`.

    Returns:
        The clean image, (H, W, 3), scene-linear, of the colour's dtype, on the side the frame came from; with
        `details` a `Denoised` that holds it.

    Raises:
        FrameError: the planes do not fit together, or the method needs one that is missing.
        ParameterError: an unknown method, preset or parameter, or a value out of range.
        DeviceError: no OpenCL device, or it cannot run the method.

    Example:
        >>> import numpy as np
        >>> rng = np.random.default_rng(0)
        >>> noisy = (0.5 + 0.1 * rng.standard_normal((32, 32, 3))).astype(np.float32)
        >>> clean = denoise(noisy, method="nlm")
        >>> clean.shape, clean.dtype, bool(clean.std() < noisy.std())
        ((32, 32, 3), dtype('float32'), True)
    """
    planes = {
        "albedo": albedo,
        "normal": normal,
        "depth": depth,
        "color_variance": color_variance,
        "albedo_variance": albedo_variance,
        "normal_variance": normal_variance,
        "depth_variance": depth_variance,
        "color_a": color_a,
        "color_b": color_b,
    }
    frame = as_frame(frame_or_color, planes)
    queue = None
    if frame.on_device:
        if device is not None:
            raise ParameterError("device is given but the frame is on a device already: leave device out")
        queue = frame.color.queue
        if queue is None:
            raise DeviceError("color has no queue to run on: pass color.with_queue(queue)")
    denoiser = Denoiser(
        *frame.shape,
        method=method,
        preset=preset,
        device=device,
        queue=queue,
        max_memory_mb=max_memory_mb,
        **parameters,
    )
    image = denoiser(frame, out=out, also=also, neighbours=neighbours)
    if not details:
        return image
    return Denoised(image, denoiser.model_map, denoiser.error_map, denoiser.report, also=denoiser.also)
