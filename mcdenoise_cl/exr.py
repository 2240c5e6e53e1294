"""EXR files <-> `Frame`: reading, and writing a result beside everything else the input held."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import OpenEXR
import pyopencl.array as cl_array

from .errors import ExrError, FrameError
from .exr_file import Part, load, save
from .exr_layers import (
    MOTION,
    NONE,
    OWN_CHANNELS,
    Layer,
    describe,
    find_color,
    find_planes,
    find_wanted,
    group_layers,
    moment_base,
    result_layer,
)
from .exr_metadata import attributes_of, metadata_of
from .exr_motion import own_vectors, vectors_of
from .frame import PLANES, Frame

#: The header attribute in which `stamp.py` keeps how a file was made.
STAMP = "mcdenoise"
HALF_MAX = float(np.finfo(np.float16).max)
COMPRESSIONS = {
    name.removesuffix("_COMPRESSION").lower().replace("no", "none"): value
    for name, value in OpenEXR.Compression.__members__.items()
    if name.endswith("_COMPRESSION")
}


def read_exr(
    path: str | os.PathLike[str],
    *,
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
) -> Frame:
    """Read the planes that can be recognised in an EXR file.

    Understood without being told: this project's own layers, Mitsuba 3 (`aov` and `moment` integrators under any
    names), Blender Cycles, pbrt-v4 and Arnold, in one part or many, half or float. A plane for which two layers
    qualify is left out rather than guessed; `metadata["layers"]` tells what was taken.

    Mitsuba's second moments `m2_*` become variances of the pixel mean, max(m2 - m1², 0) / (n - 1) for n samples per
    pixel, which is unbiased for a box reconstruction filter and approximate for wider ones. Without n, or with n = 1,
    they are left out; Mitsuba does not store n, so pass `samples_per_pixel`.

    Args:
        path: the file.
        layers: the layer of a plane by the plane's name, instead of the one that would be recognised: the name of a
            layer or channel, or channel names separated by commas. "" or "none" leaves the plane out. Motion vectors
            are recognised by name alone: {"motion": "none"} leaves them out, and nothing else can be said of them.
        samples_per_pixel: overrides what the header says.

    Returns:
        A frame of (H, W, 3) and (H, W) NumPy planes over the data window, in the dtype that is stored (float16 or
        float32; variances made from moments are float32), with motion vectors, `to_previous` and `to_next`, where
        there are this project's own or Blender's pass Vector. `metadata` has `source` and `layers`, with
        vectors `motion`, their layers, and where the header tells, `samples_per_pixel`, `exposure_scale` and `scene`.

    Raises:
        ExrError: the file is missing, damaged or no EXR file, has no colour that can be recognised, has deep or
            subsampled pixels, or lacks a layer that was asked for.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     frame = Frame(np.ones((4, 6, 3), np.float16), depth=np.ones((4, 6), np.float32))
        ...     write_exr(folder + "/frame.exr", frame)
        ...     read_exr(folder + "/frame.exr").metadata["layers"]
        {'color': 'RGB', 'depth': 'Z'}
    """
    return frame_of(path, load(path), layers, samples_per_pixel)


def frame_of(
    path: str | os.PathLike[str],
    parts: Sequence[Part],
    layers: Mapping[str, str] | None = None,
    samples_per_pixel: int | None = None,
    *,
    motion: bool = True,
) -> Frame:
    """The frame in the parts of a file, with its motion vectors if asked; all else as for `read_exr`."""
    known, wanted, color = layers_of(path, parts, layers)
    metadata = metadata_of(path, parts, color, samples_per_pixel)
    samples = metadata.get("samples_per_pixel")

    def is_direction(layer: Layer) -> bool:
        # A mean of unit vectors is at most 1 long; a little more under a filter with negative lobes.
        squared = np.sum(np.square(stacked(parts, layer).astype(np.float64)), axis=-1)
        return bool(np.all(squared[np.isfinite(squared)] <= 1.25**2))

    # In a file of many parts, only those over the pixels of the colour.
    in_window = [layer for layer in known if parts[layer.part].window == parts[color.part].window]
    from_mitsuba = "mitsuba" in str(parts[color.part].header.get("generatedBy", "")).lower()
    found = find_planes(in_window, color, wanted, from_mitsuba=from_mitsuba, is_direction=is_direction)
    planes = {}
    for plane, layer in list(found.items()):
        if moment_base(layer) is None or not plane.endswith("_variance"):
            planes[plane] = stacked(parts, layer)
        elif (base := _mean_of(in_window, layer)) is not None and samples is not None and samples > 1:
            planes[plane] = _variance_of_mean(stacked(parts, base), stacked(parts, layer), samples)
        elif plane in wanted:
            raise ExrError(
                f"{path}: {layer.title} holds second moments, which need the layer of their means and at least "
                f"2 samples per pixel ({samples} known) to become a variance: pass samples_per_pixel"
            )
        else:
            del found[plane]
    metadata["layers"] = {plane: layer.title for plane, layer in found.items()}
    if motion and MOTION not in (layers or {}):
        vectors, titles = vectors_of(parts, in_window, color)
        planes |= vectors
        metadata |= {MOTION: ", ".join(titles)} if titles else {}
    try:
        return Frame(**planes, metadata=metadata)
    except FrameError as error:
        raise ExrError(f"{path}: {error}") from None


def write_exr(
    path: str | os.PathLike[str],
    image: Frame | np.ndarray,
    *,
    template: str | os.PathLike[str] | None = None,
    layers: Mapping[str, str] | None = None,
    also: Mapping[str, np.ndarray] | None = None,
    compression: str | OpenEXR.Compression | None = None,
    dtype: Any = None,
) -> None:
    """Write an image, alone or in the place of the colour of another EXR file.

    The file appears under its name only when it is complete: a failure leaves what was there before.

    Args:
        path: the file to write; may be the template.
        image: host arrays. A `Frame`, of which every plane is written under this project's layer names, its motion
            vectors, and `samples_per_pixel`, `exposure_scale` and `scene` of its metadata; or an (H, W, 3) array,
            written as R G B.
        template: an EXR file of which everything else is kept: other layers, alpha, parts, header attributes, data
            and display window, scanlines or tiles, compression. Only the colour layer that `read_exr` takes is
            replaced, by `image` or its `color`; for Cycles' "Noisy Image" that is the "Combined" beside it, which
            viewers show. Under a lossy compression the kept half and float layers are compressed once more, so
            they are not bit-exact. Of mipmapped tiles only the full resolution is kept.
        layers: as for `read_exr`; of the template only `color` matters.
        also: further images, (H, W, 3), by the names of the template's RGB layers whose place they take.
        compression: "none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab", or another that
            OpenEXR knows; by default the template's, else "zip".
        dtype: float16 or float32 for the planes, except variances, which half cannot hold; by default what the
            colour of the template, else the plane itself, is stored in (float64 becomes float32). Values beyond
            ±65504, infinities included, become ±65504 in half.

    Raises:
        ExrError: the image does not fit the template, is on a device, has a dtype or shape that cannot be stored,
            the template cannot be read, or the file cannot be written.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_exr(folder + "/a.exr", np.full((2, 3, 3), 1e6, np.float32), dtype="float16")
        ...     float(read_exr(folder + "/a.exr").color.max())
        65504.0
    """
    planes = _host_planes(image)
    packing = None if compression is None else _check_compression(compression)
    stored = None if dtype is None else _check_dtype(dtype)
    if also and template is None:
        raise ExrError("also is given but template is not: pass the file that has these layers")
    if template is None:
        metadata = image.metadata if isinstance(image, Frame) else {}
        vectors = own_vectors(image) if isinstance(image, Frame) else {}
        packing = COMPRESSIONS["zip"] if packing is None else packing
        parts = [_own_part(planes, vectors, metadata, packing, stored)]
    else:
        parts = replace_color(template, load(template), planes["color"], layers, stored)
        if also:
            from .exr_also import replace_also  # which builds on this file

            parts = replace_also(template, parts, also, layers, stored)
        if packing is not None:
            parts = [p if p.deep else replace(p, header=p.header | {"compression": packing}) for p in parts]
    save(path, parts)


def _own_part(
    planes: Mapping[str, np.ndarray],
    vectors: Mapping[str, np.ndarray],
    metadata: Mapping[str, Any],
    compression: OpenEXR.Compression,
    dtype: np.dtype | None,
) -> Part:
    """All planes under this project's layer names, and motion vectors, which have theirs."""
    channels = {}
    for plane, pixels in planes.items():
        kind = np.dtype("f2") if pixels.dtype == np.float16 else np.dtype("f4")
        if dtype is not None and not plane.endswith("_variance"):
            kind = dtype
        split = [pixels] if pixels.ndim == 2 else [pixels[..., c] for c in range(3)]
        channels |= {name: (cast(p, kind), False) for name, p in zip(OWN_CHANNELS[plane], split, strict=True)}
    for name, pixels in vectors.items():
        kind = np.dtype("f2") if pixels.dtype == np.float16 else np.dtype("f4")
        channels[name] = cast(pixels, dtype or kind), False
    header = {"type": OpenEXR.scanlineimage, "compression": compression, **attributes_of(metadata)}
    return Part(header, channels, False)


def replace_color(
    template: str | os.PathLike[str],
    parts: Sequence[Part],
    image: np.ndarray,
    layers: Mapping[str, str] | None = None,
    dtype: np.dtype | None = None,
) -> list[Part]:
    """The parts of the file `template` with the image in the place of its colour, and without our stamp."""
    parts = [replace(part, header={k: v for k, v in part.header.items() if k != STAMP}) for part in parts]
    found, _, color = layers_of(template, parts, layers)
    color = result_layer(found, color)
    old = {name: parts[color.part].channels[name] for name in color.channels}
    shape = old[color.channels[0]][0].shape
    if image.shape[:2] != shape:
        raise ExrError(
            f"the image is {image.shape[:2]} but the colour of {template} is {shape}: height and width must be the same"
        )
    new = {
        name: (cast(image[..., c], dtype or pixels.dtype), linear)
        for c, (name, (pixels, linear)) in enumerate(old.items())
    }
    parts[color.part] = replace(parts[color.part], channels=parts[color.part].channels | new)
    return parts


def layers_of(
    path: str | os.PathLike[str], parts: Sequence[Part], asked: Mapping[str, str] | None
) -> tuple[list[Layer], dict[str, Layer | None], Layer]:
    """The layers of a file, those a user asked for by plane, and the one that is the colour."""
    layers = group_layers([(part.header.get("name", ""), part.planes) for part in parts])
    if not layers and any(part.deep for part in parts):
        raise ExrError(f"{path} holds only deep pixels, which are not supported: flatten it first")
    asked = _check_layers(asked)
    integers = {name for part in parts for name, (pixels, _) in part.channels.items() if pixels.dtype.kind == "u"}
    for plane, name in asked.items():
        if name in integers:
            raise ExrError(f"{path}: {plane}={name} is a channel of integers: the layers are {describe(layers)}")
    try:
        wanted = find_wanted(layers, asked)
        color = wanted.get("color") or find_color(layers)
    except ExrError as error:
        deep = " (its deep parts are not supported)" if any(part.deep for part in parts) else ""
        raise ExrError(f"{path}: {error}{deep}") from None
    for plane, layer in wanted.items():
        if layer is not None and parts[layer.part].window != parts[color.part].window:
            raise ExrError(
                f"{path}: the layer {layer.title} for {plane} has the data window {parts[layer.part].window} but the "
                f"colour has {parts[color.part].window}: name a layer over the same pixels"
            )
    return layers, wanted, color


def _mean_of(layers: Sequence[Layer], moment: Layer) -> Layer | None:
    count = len(moment.channels)
    return next((c for c in layers if c.name == moment_base(moment) and len(c.channels) == count), None)


def stacked(parts: Sequence[Part], layer: Layer) -> np.ndarray:
    """(H, W, 3) of a layer of three channels, (H, W) of one."""
    pixels = [parts[layer.part].channels[name][0] for name in layer.channels]
    return pixels[0] if len(pixels) == 1 else np.stack(pixels, axis=-1)


def _variance_of_mean(mean: np.ndarray, moment: np.ndarray, samples: int) -> np.ndarray:
    """max(m2 - m1², 0) / (n - 1), float32. From moments stored in half it carries their rounding, 3e-4 m2 / (n - 1)."""
    # The moments are all the renderer left, so subtracting before squaring is not possible here; float64 at least
    # adds no rounding of its own.
    spread = moment.astype(np.float64) - np.square(mean.astype(np.float64))
    return (np.maximum(spread, 0) / (samples - 1)).astype(np.float32)


def _check_layers(layers: Mapping[str, str] | None) -> dict[str, str]:
    for plane, name in (layers or {}).items():
        if plane not in (*PLANES, MOTION):
            raise ExrError(f"{plane!r} is not a plane: layers can be given for {', '.join(PLANES)}")
        if not isinstance(name, str):
            raise ExrError(f"the layer given for {plane} is {name!r}: give its name as text")
        if plane == MOTION and name.casefold() not in NONE:
            raise ExrError(
                f"motion={name} is given, but motion vectors are recognised by name alone: motion=none leaves them out"
            )
    return {plane: name for plane, name in (layers or {}).items() if plane != MOTION}


def _check_compression(compression: str | OpenEXR.Compression) -> OpenEXR.Compression:
    if isinstance(compression, OpenEXR.Compression):
        return compression
    if str(compression).lower() not in COMPRESSIONS:
        raise ExrError(f"{compression!r} is not a compression: choose one of {', '.join(COMPRESSIONS)}")
    return COMPRESSIONS[str(compression).lower()]


def _check_dtype(dtype: Any) -> np.dtype:
    try:
        wanted = np.dtype({"half": "f2", "float": "f4"}.get(dtype, dtype) if isinstance(dtype, str) else dtype)
    except TypeError:
        wanted = None
    if wanted not in (np.dtype("f2"), np.dtype("f4")):
        raise ExrError(f"dtype is {dtype!r} but an EXR file stores float16 or float32: choose one of them")
    return wanted


def _host_planes(image: Any) -> dict[str, np.ndarray]:
    if isinstance(image, cl_array.Array) or (isinstance(image, Frame) and image.on_device):
        raise ExrError("the image is on the device: copy it to the host with .get() first")
    if isinstance(image, Frame):
        return image.planes()
    try:
        return Frame(image).planes()  # a frame checks shape and dtype at the door
    except FrameError as error:
        raise ExrError(f"the image cannot be written: {error}") from None


def cast(pixels: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Pixels as OpenEXR stores them; what half cannot hold becomes the most it can."""
    if dtype == np.float16 and pixels.dtype != np.float16:
        pixels = np.clip(pixels, -HALF_MAX, HALF_MAX)
    # OpenEXR ignores strides: anything but a contiguous array would be written scrambled.
    return np.ascontiguousarray(pixels, dtype=dtype)
