"""The parts of an EXR file: loading them all, saving them all, and nothing seen half done."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from .errors import ExrError
from .temporary import unfinished

MAGIC = b"\x76\x2f\x31\x01"
DEEP = (OpenEXR.deepscanline, OpenEXR.deeptile)
#: Bytes of pixels that one byte of a file can stand for at most. A constant image of 16384 x 4096 in HTJ2K, the
#: smallest there is, has 150000; more than a million is a damaged header.
DENSEST = 1_000_000
#: The same for the table of how many samples the pixels of a deep part have, four bytes a pixel: ZIP makes a
#: thousandth of it at best, ZSTD less than a ten-thousandth. It is bounded closer as it costs more memory: OpenEXR
#: hands out an object a pixel.
DENSEST_DEEP = 50_000
#: Pixels to the side of a tile, where the image is not larger. OpenEXR takes memory for whole tiles.
WIDEST_TILE = 4096


@dataclass(frozen=True)
class Part:
    """One part of a file: its header, and by channel name the pixels and the linearity flag."""

    header: dict[str, Any]
    channels: dict[str, tuple[np.ndarray, bool]]
    deep: bool

    @property
    def window(self) -> tuple[int, ...]:
        (x0, y0), (x1, y1) = self.header["dataWindow"]
        return int(x0), int(y0), int(x1), int(y1)

    @property
    def planes(self) -> list[str]:
        """The channels that can be a plane or a part of one: integers are identifiers, deep pixels are lists."""
        return [] if self.deep else [name for name, (pixels, _) in self.channels.items() if pixels.dtype.kind == "f"]


def load(path: str | os.PathLike[str]) -> list[Part]:
    """Every part of a file, with all its pixels; nothing of it stays open."""
    _check_signature(path)
    try:
        # OpenEXR 3.5 leaves out the parts whose pixels it cannot read, so they are counted first.
        with _open(path) as source, OpenEXR.File(source, header_only=True) as file:
            expected = len(file.parts)
            _check_claims(path, [part.header for part in file.parts])
        with _open(path) as source, OpenEXR.File(source, separate_channels=True) as file:
            parts = [_extract(path, part) for part in file.parts]
    except ExrError:
        raise
    except Exception as error:  # the module raises whatever its C++ code throws
        raise _damaged(path, error) from None
    if len(parts) < max(expected, 1):
        raise ExrError(f"{path} is damaged or cut short, its pixels cannot be read: render or copy it again")
    return parts


def read_header(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The attributes of the first part of a file, without its pixels."""
    _check_signature(path)
    try:
        with _open(path) as source, OpenEXR.File(source, header_only=True) as file:
            return dict(file.parts[0].header)
    except Exception as error:
        raise _damaged(path, error) from None


def _check_signature(path: str | os.PathLike[str]) -> None:
    try:
        start = b""
        if not Path(path).is_fifo():  # to open one would wait for whoever writes to it
            with Path(path).open("rb") as stream:
                start = stream.read(4)
    except (OSError, ValueError) as error:  # a ValueError: there is a zero in the name
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{path} cannot be read ({reason}): give the path of an EXR file that can be") from None
    if start != MAGIC:
        raise ExrError(f"{path} is not an EXR file, whatever its name: it does not start with the EXR signature")


def _damaged(path: str | os.PathLike[str], error: Exception) -> ExrError:
    return ExrError(
        f"{path} cannot be read, it is damaged or uses a feature that OpenEXR {OpenEXR.__version__} for Python "
        f"lacks ({error}): render or copy it again"
    )


@contextlib.contextmanager
def _open(path: str | os.PathLike[str]) -> Iterator[Any]:
    """What OpenEXR reads: a path, or a stream where the name is none that it takes, such as one in Latin-1."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        with Path(path).open("rb") as stream:
            yield stream
    else:
        yield str(path)


def _check_claims(path: str | os.PathLike[str], headers: Sequence[Mapping[str, Any]]) -> None:
    """Refuse, before any memory is taken for them, pixels that cannot be in the file or do not fit into memory."""
    size, total = Path(path).stat().st_size, 0
    for header in headers:
        (x0, y0), (x1, y1) = (corner.tolist() for corner in header["dataWindow"])
        width, height = x1 - x0 + 1, y1 - y0 + 1
        deep = header["type"] in DEEP
        least = (4 if deep else 2 * len(header["channels"])) * width * height  # a channel has two bytes a pixel or more
        if least > (DENSEST_DEEP if deep else DENSEST) * size:
            raise ExrError(
                f"{path} is damaged: its header tells of {width} x {height} pixels, at least {least / 2**30:.3g} GiB, "
                f"but the file has {size} bytes: render or copy it again"
            )
        tiles = header.get("tiles")
        if tiles is not None and any(
            side > max(WIDEST_TILE, of) for side, of in ((tiles.xSize, width), (tiles.ySize, height))
        ):
            raise ExrError(
                f"{path} is damaged: its header tells of tiles of {tiles.xSize} x {tiles.ySize} pixels in an image of "
                f"{width} x {height}: render or copy it again"
            )
        total += least
    try:
        np.empty(total, np.uint8)  # OpenEXR would call a file damaged for which there is no memory
    except MemoryError:
        raise ExrError(
            f"{path} has pixels of at least {total / 2**30:.3g} GiB, for which there is no memory: read it on a "
            "machine that has more, or save it smaller"
        ) from None


def _extract(path: str | os.PathLike[str], part: OpenEXR.Part) -> Part:
    coarse = [c.name for c in part.header["channels"] if (c.xSampling, c.ySampling) != (1, 1)]
    if coarse:
        # Asked for before the pixels: OpenEXR fails on those, or hands out a plane padded with garbage.
        raise ExrError(
            f"{path} stores {', '.join(coarse)} at a lower resolution (subsampled), which is not supported: save it "
            "with full-resolution R, G and B"
        )
    channels = {name: (channel.pixels, channel.pLinear) for name, channel in part.channels.items()}
    # An old file of one part does not say of what kind it is; written back it must not become another.
    return Part(dict(part.header) | {"type": part.type()}, channels, part.type() in DEEP)


def save(path: str | os.PathLike[str], parts: Sequence[Part]) -> None:
    """Write beside the final name and rename, so that nobody ever sees half a file."""
    try:
        final = Path(os.path.realpath(path))  # a link keeps pointing to the file
    except ValueError as error:
        raise ExrError(f"{path} cannot be written ({error}): give the path of a file") from None
    if os.path.exists(final) and not os.path.isfile(final):  # noqa: PTH110, PTH113 (a Path's raise for odd names)
        raise ExrError(f"{path} is not a regular file: give the path of a file to write")
    try:
        with unfinished(final) as temporary:
            _write(temporary, parts)
    except Exception as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ExrError(
            f"{path} cannot be written ({reason}): check the folder, its permissions and its free space"
        ) from error


def _write(path: Path, parts: Sequence[Part]) -> None:
    # OpenEXR changes the dictionaries and channels it is given, so it gets its own.
    files = [
        OpenEXR.Part(
            _writable(part.header),
            {name: OpenEXR.Channel(name, pixels, 1, 1, linear) for name, (pixels, linear) in part.channels.items()},
            part.header.get("name", ""),
        )
        for part in parts
    ]
    OpenEXR.File(files).write(str(path))


def _writable(header: Mapping[str, Any]) -> dict[str, Any]:
    """A header that OpenEXR accepts. Channels and chunks follow from the pixels; it has no type for an empty list."""
    kept = {
        key: value
        for key, value in header.items()
        if key not in ("channels", "chunkCount") and not (isinstance(value, list) and not value)
    }
    if "tiles" in kept and kept["tiles"].mode != OpenEXR.ONE_LEVEL:
        # Only the first level was read, and OpenEXR would leave the others as holes in the file.
        tiles = OpenEXR.TileDescription()
        tiles.xSize, tiles.ySize = kept["tiles"].xSize, kept["tiles"].ySize
        kept["tiles"] = tiles
    return kept
