"""Pictures for people: PNGs, side-by-side comparisons with crops, feature sheets.

Pictures are uint8 arrays (H, W, 3), ready for `write_png`. Wherever an image is taken, (H, W, 3) floats are
scene-linear colour and uint8 is shown as it is. Needs Pillow.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import secrets
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pyopencl.array as cl_array

from .errors import FrameError, McdenoiseError, ParameterError
from .frame import Frame
from .metrics import LUMINANCE, exposed, frame_exposure, tonemap

#: Crop colours that people of any colour vision tell apart: Okabe and Ito, "Color Universal Design", 2008.
CROP_COLORS = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (204, 121, 167), (240, 228, 66), (213, 94, 0))
#: Pixels that are NaN are shown in this colour, which no rendering is likely to hold.
NAN_COLOR = (255, 0, 255)
PAPER, INK = 255, 24
#: x, y of the top left pixel and the width and height of a square crop.
Crop = tuple[int, int, int]


def to_png(image: Any, exposure: float = 1.0) -> np.ndarray:
    """The displayed picture of a linear image: (H, W, 3) uint8, sRGB-encoded clip(exposure * image, 0, 1).

    The curve is that of IEC 61966-2-1. Pixels that are NaN become magenta, so that they are seen.

    Example:
        >>> to_png(np.array([[[-1.0, 0.18, 9.0]]])).tolist()
        [[[0, 118, 255]]]
    """
    if getattr(image, "dtype", None) == np.uint8 and image.ndim == 3 and image.shape[2] == 3:
        return np.asarray(image)
    linear = exposed(image, exposure)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    lost = np.isnan(encoded).any(axis=2)
    encoded[lost] = 0
    picture = (255 * encoded + 0.5).astype(np.uint8)
    picture[lost] = NAN_COLOR
    return picture


def write_png(path: str | Path, image: Any, exposure: float = 1.0) -> None:
    """Write an image as PNG; the file appears whole or not at all, also when it replaces another.

    Raises:
        McdenoiseError: the folder does not exist, or Pillow is not installed.
    """
    data = io.BytesIO()
    pillow("Image").fromarray(to_png(image, exposure)).save(data, format="PNG")
    replace_file(Path(path), data.getvalue())


def find_crops(noisy: Any, reference: Any, n: int = 2, size: int = 64, exposure: float = 1.0) -> list[Crop]:
    """Up to `n` squares that do not overlap and tell most about a denoiser: much structure and much noise at once.

    Structure is the mean gradient of the tonemapped reference, noise the mean difference from it; the places with the
    largest product are taken one by one, so fewer come back where no more fit.

    Args:
        noisy, reference: (H, W, 3), scene-linear, of the same size.
        size: width and height of a square in pixels.

    Example:
        >>> reference = np.zeros((8, 12, 3))
        >>> reference[2:6, 6:8] = 1
        >>> find_crops(reference * 0.5, reference, n=1, size=4)
        [(5, 2, 4)]
    """
    shown, wanted = tonemap(noisy, exposure) @ LUMINANCE, tonemap(reference, exposure) @ LUMINANCE
    if shown.shape != wanted.shape:
        raise FrameError(f"noisy is {shown.shape} but reference is {wanted.shape}: pass images of the same size")
    if not 2 <= size <= min(wanted.shape):
        raise ParameterError(
            f"size is {size} but the image is {wanted.shape}: pass a size from 2 to {min(wanted.shape)}"
        )
    score = _window_sums(np.hypot(*np.gradient(wanted)), size) * _window_sums(np.abs(shown - wanted), size)
    crops: list[Crop] = []
    while len(crops) < n and np.isfinite(score.max()):
        y, x = (int(i) for i in np.unravel_index(np.argmax(score), score.shape))
        crops.append((x, y, size))
        # No overlap, and rather somewhere else than right beside: another place tells more.
        score[max(0, y - 2 * size) : y + 2 * size, max(0, x - 2 * size) : x + 2 * size] *= 0.5
        score[max(0, y - size + 1) : y + size, max(0, x - size + 1) : x + size] = -np.inf
    return crops


def side_by_side(
    images: Mapping[str, Any],
    exposure: float = 1.0,
    *,
    crops: Sequence[Crop] | None = None,
    labels: Mapping[str, str] | None = None,
    columns: int | None = None,
    gap: int = 12,
    max_width: int = 3840,
) -> np.ndarray:
    """Images beside each other, each over its label and the same magnified crops; more than four go into a grid.

    Args:
        images: name -> (H, W, 3), all of one size.
        exposure: for every image.
        crops: (x, y, size) squares, magnified by a whole number; outlined in the first image in their colours.
        labels: name -> text to show in place of that name; it may hold line breaks. Pillow's own font, which draws
            them, knows ASCII.
        columns: images in a row; None for all of them up to four, then rows of equal length.
        gap: white pixels between the parts and around the picture.
        max_width: where the full images would make a wider picture, they are reduced by a whole number; the crops
            keep every pixel.

    Returns:
        The picture, (H', W', 3) uint8.

    Raises:
        FrameError: sizes differ.
        ParameterError: no image at all, or a crop that is not inside the images.
        McdenoiseError: Pillow is not installed.

    Example:
        >>> images = {"noisy": np.zeros((90, 160, 3)), "denoised": np.ones((90, 160, 3))}
        >>> picture = side_by_side(images, crops=[(10, 10, 20)])
        >>> picture.dtype, picture.shape[1]
        (dtype('uint8'), 356)
    """
    if not images:
        raise ParameterError("images is empty: pass at least one image by name")
    pictures = {name: to_png(image, exposure) for name, image in images.items()}
    first, shape = next(iter(pictures)), next(iter(pictures.values())).shape
    for name, picture in pictures.items():
        if picture.shape != shape:
            raise FrameError(f"{name} is {picture.shape} but {first} is {shape}: pass images of the same size")
    crops = crops or ()
    for x, y, size in crops:
        if size < 1 or x < 0 or y < 0 or x + size > shape[1] or y + size > shape[0]:
            raise ParameterError(f"crop {(x, y, size)} is not inside images of {shape}: pass (x, y, size) in pixels")

    columns = columns or math.ceil(len(pictures) / math.ceil(len(pictures) / 4))
    reduction = max(1, math.ceil(columns * shape[1] / max_width))
    cell = math.ceil(shape[1] / reduction)
    total = columns * (cell + gap)
    # Such a picture is mostly looked at reduced to the width of a page, so lines and letters grow with it.
    line = max(2, total // 500)
    texts = [(labels or {}).get(name, name) for name in pictures]
    captions = _captions(texts, cell, size=min(48, max(14, total // 56)))
    cell = max([cell, captions[0].shape[1], *(size + 2 * line for _, _, size in crops)])
    cells = []
    for (name, picture), caption in zip(pictures.items(), captions, strict=True):
        full = np.asarray(pillow("Image").fromarray(picture).reduce(reduction))
        if name == first:
            full = _outlined(full, crops, reduction, line)
        parts = [full, caption] + ([_magnified(picture, crops, cell, gap, line)] if crops else [])
        cells.append(_arranged(parts, 1, gap // 2))
    return np.pad(_arranged(cells, columns, gap, 2 * gap), ((gap, gap), (gap, gap), (0, 0)), constant_values=PAPER)


def feature_sheet(frame: Frame) -> np.ndarray:
    """Colour, albedo, normal and depth of a frame in one labelled picture, (H', W', 3) uint8; absent planes left out.

    Albedo is shown as reflectance in [0, 1], a normal n as (n + 1) / 2, depth from white (nearest) to dark grey
    (farthest, the outermost 1 % aside), and black where a ray leaves the scene.

    Example:
        >>> frame = Frame(np.ones((90, 160, 3)), depth=np.ones((90, 160)))
        >>> feature_sheet(frame).shape[1]
        356
    """
    planes = {
        name: plane.get() if isinstance(plane, cl_array.Array) else plane for name, plane in frame.planes().items()
    }
    images = {"color": to_png(planes["color"], frame_exposure(frame))}
    if "albedo" in planes:
        images["albedo"] = to_png(planes["albedo"])
    if "normal" in planes:
        images["normal"] = normal_picture(planes["normal"])
    if "depth" in planes:
        images["depth"] = _depth_picture(planes["depth"].astype(np.float64))
    return side_by_side(images, columns=min(2, len(images)))


def normal_picture(normal: np.ndarray) -> np.ndarray:
    """(n + 1) / 2 of normals (H, W, 3) in [-1, 1], as uint8.

    Example:
        >>> normal_picture(np.array([[[0.0, 0.0, 1.0]]])).tolist()
        [[[128, 128, 255]]]
    """
    normal = np.clip(np.nan_to_num(normal.astype(np.float64)), -1, 1)
    return np.round(255 * (normal + 1) / 2).astype(np.uint8)


def _window_sums(values: np.ndarray, size: int) -> np.ndarray:
    """Sums over every size x size window inside the array; NaN counts as 0."""
    sums = np.pad(np.nan_to_num(values).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    return sums[size:, size:] - sums[:-size, size:] - sums[size:, :-size] + sums[:-size, :-size]


def _depth_picture(depth: np.ndarray) -> np.ndarray:
    hit = np.isfinite(depth) & (depth > 0)
    near, far = np.percentile(depth[hit], (1, 99)) if hit.any() else (0, 0)
    nearness = np.clip((far - np.where(hit, depth, far)) / max(far - near, 1e-30), 0, 1)
    grey = np.where(hit, 40 + 215 * nearness, 0)
    return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, axis=2)


def _captions(texts: list[str], width: int, size: int) -> list[np.ndarray]:
    """The labels as pictures of one size, `width` wide or, where the smallest legible letters ask for it, wider."""
    image, draw, fonts = pillow("Image"), pillow("ImageDraw"), pillow("ImageFont")
    ruler = draw.Draw(image.new("RGB", (1, 1)))
    while True:
        font = fonts.load_default(size=size)
        boxes = [ruler.multiline_textbbox((0, 0), text, font=font) for text in texts]
        widest = math.ceil(max(box[2] for box in boxes)) + 2
        if widest <= width or size <= 12:
            break
        size -= 1
    # Room for the descenders of the last line, whether this text has any or not, keeps the baselines level.
    height = math.ceil(max(ruler.multiline_textbbox((0, 0), text + "gÅ", font=font)[3] for text in texts)) + 2
    captions = []
    for text in texts:
        picture = image.new("RGB", (max(width, widest), height), (PAPER,) * 3)
        pen = draw.Draw(picture)
        pen.multiline_text((picture.width / 2, 0), text, fill=(INK,) * 3, font=font, anchor="ma", align="center")
        captions.append(np.asarray(picture))
    return captions


def _outlined(picture: np.ndarray, crops: Sequence[Crop], reduction: int, line: int) -> np.ndarray:
    image = pillow("Image").fromarray(picture)
    pen = pillow("ImageDraw").Draw(image)
    for index, (x, y, size) in enumerate(crops):
        left, top, right, bottom = (v // reduction for v in (x, y, x + size, y + size))
        # A dark line outside the coloured one: together they show on any background.
        for width, color in ((line + 1, (INK,) * 3), (line, CROP_COLORS[index % len(CROP_COLORS)])):
            corners = max(0, left - width), max(0, top - width)
            corners += min(image.width, right + width) - 1, min(image.height, bottom + width) - 1
            pen.rectangle(corners, outline=color, width=line if color[0] != INK else 1)
    return np.asarray(image)


def _magnified(picture: np.ndarray, crops: Sequence[Crop], width: int, gap: int, line: int) -> np.ndarray:
    """The crops, each in a frame of its colour, in rows not wider than `width`, all by the same whole factor."""
    largest = max(size for _, _, size in crops)

    def factor(columns: int) -> int:
        return ((width - (columns - 1) * gap) // columns - 2 * line) // largest

    columns = next((n for n in range(len(crops), 1, -1) if factor(n) >= 2), 1)
    tiles = []
    for index, (x, y, size) in enumerate(crops):
        tile = picture[y : y + size, x : x + size].repeat(factor(columns), axis=0).repeat(factor(columns), axis=1)
        framed = np.empty((tile.shape[0] + 2 * line, tile.shape[1] + 2 * line, 3), np.uint8)
        framed[:] = CROP_COLORS[index % len(CROP_COLORS)]
        framed[line:-line, line:-line] = tile
        tiles.append(framed)
    return _arranged(tiles, columns, gap)


def _arranged(parts: Sequence[np.ndarray], columns: int, gap: int, row_gap: int | None = None) -> np.ndarray:
    """Pictures in rows of `columns`, all columns as wide as the widest, each centred in its column."""
    width = max(part.shape[1] for part in parts)
    rows = [parts[i : i + columns] for i in range(0, len(parts), columns)]
    row_gap = gap if row_gap is None else row_gap
    heights = [max(part.shape[0] for part in row) for row in rows]
    whole = np.full((sum(heights) + row_gap * (len(rows) - 1), columns * (width + gap) - gap, 3), PAPER, np.uint8)
    top = 0
    for row, height in zip(rows, heights, strict=True):
        for column, part in enumerate(row):
            left = column * (width + gap) + (width - part.shape[1]) // 2
            whole[top : top + part.shape[0], left : left + part.shape[1]] = part
        top += height + row_gap
    return whole


def replace_file(path: Path, data: bytes) -> None:
    """Write a file by way of another in its folder, so that a reader meets the old one or the new one, whole."""
    is_dir = os.path.isdir  # a Path's raises for a name that is too long, or a folder that may not be seen
    if not is_dir(path.parent):
        raise McdenoiseError(f"{path} cannot be written because its folder does not exist: make {path.parent} first")
    # Opened plainly, since tempfile would make it readable for its owner only.
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError as error:
        raise McdenoiseError(
            f"{path} cannot be written ({error.strerror}): check the folder, its permissions and its free space"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


def make_folder(folder: Path) -> None:
    """Make a folder, with those above it; one that is there is left as it is.

    Raises:
        McdenoiseError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a name with a zero in it
        reason = getattr(error, "strerror", None) or error
        raise McdenoiseError(
            f"folder {folder} cannot be made ({reason}): choose another, or check permissions and free space"
        ) from error


def pillow(module: str) -> Any:
    """A module of Pillow, imported on use, since Pillow is optional."""
    try:
        return import_module(f"PIL.{module}")
    except ImportError as error:
        raise McdenoiseError(
            "pictures need Pillow, which cannot be imported: pip install 'mcdenoise-cl[demo]'"
        ) from error
