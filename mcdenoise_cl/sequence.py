"""Sequences: files that differ in the number of their frame."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path

from .errors import ExrError, ParameterError
from .methods.parameters import shown

#: `####`, or `%04d` and `%d`.
_TOKEN = re.compile(r"(?P<hashes>#+)|%(?:0(?P<width>\d+))?d")
_RANGE = re.compile(r"(?P<first>-?\d+)(?:-(?P<last>-?\d+)(?:x(?P<every>\d+))?)?")
#: The number of a frame is the last in its name.
_NUMBERED = re.compile(r"(?P<start>.*?)(?P<number>\d+)(?P<end>\D*)")
#: More frames than anybody renders: a slip of the keyboard.
MOST = 1_000_000


def parse_frames(text: str | Iterable[int]) -> list[int]:
    """Numbers of frames from text such as "1-240", "1-240x2" for every second, or "1,5,10-20"; or from numbers.

    Raises:
        ParameterError: it is none of these, or more than a million.

    Example:
        >>> parse_frames("1-9x4,20")
        [1, 5, 9, 20]
    """
    if not isinstance(text, str):
        try:
            return [int(number) for number in text]
        except (TypeError, ValueError):
            raise ParameterError(
                f"frames is {shown(text)} but text such as '1-240' or whole numbers are needed"
            ) from None
    ranges: list[range] = []
    for word in text.split(","):
        match = _RANGE.fullmatch(word.strip())
        if match is None or match["every"] == "0":
            raise ParameterError(f"frames is {shown(text)} but something like 1-240, 1-240x2 or 1,5,10-20 is needed")
        first = int(match["first"])
        last = first if match["last"] is None else int(match["last"])
        if last < first:
            raise ParameterError(f"frames is {shown(text)} but {last} comes before {first}: give the first frame first")
        ranges.append(range(first, last + 1, int(match["every"] or 1)))
    if sum(map(len, ranges)) > MOST:
        raise ParameterError(f"frames is {shown(text)}, which is more than {MOST} frames: give fewer at a time")
    return list(dict.fromkeys(number for each in ranges for number in each))


def is_sequence(text: str) -> bool:
    """Whether a path stands for a sequence, such as `shot.####.exr` or `shot.%04d.exr`."""
    return _TOKEN.search(text) is not None


def expand(text: str, frames: Iterable[int]) -> list[Path]:
    """The files of a sequence, whether they are there or not.

    Example:
        >>> [path.name for path in expand("shot.####.exr", (7, 12345))], expand("%02d.exr", [3])[0].name
        (['shot.0007.exr', 'shot.12345.exr'], '03.exr')
    """
    return [Path(_TOKEN.sub(lambda token: f"{number:0{_width(token)}d}", text)) for number in frames]  # noqa: B023


def find_frames(text: str) -> list[Path]:
    """The files of a sequence that are there, in the order of their numbers.

    Raises:
        ExrError: there are none, their folder cannot be read, or the number is not in the name alone.
    """
    folder, name = Path(text).parent, Path(text).name
    tokens = list(_TOKEN.finditer(name))
    if len(tokens) != 1 or is_sequence(str(folder)):
        raise ExrError(f"{text} has its number in more than one place: say which frames with --frames, such as 1-240")
    token = tokens[0]
    number = rf"(-?\d{{{_width(token)},}})"
    form = re.compile(re.escape(name[: token.start()]) + number + re.escape(name[token.end() :]), re.IGNORECASE)
    found = sorted((int(match[1]), entry) for entry in _names(folder) if (match := form.fullmatch(entry)))
    if not found:
        raise ExrError(f"no file is called {text}, with a number in the place of {token[0]}: look at the name")
    return [folder / entry for _, entry in found]


def find_neighbours(path: Path, count: int, listing: dict[Path, list[str]] | None = None) -> tuple[Path, ...]:
    """The frames before and after one in its sequence, up to `count` on each side, in order.

    The number of a frame is the last in its name; neighbours are the nearest numbers that are there.

    Args:
        listing: remembers what is in a folder from one call to the next.
    """
    match = _NUMBERED.fullmatch(path.name)
    if match is None or count == 0:
        return ()
    listing = {} if listing is None else listing
    if path.parent not in listing:
        listing[path.parent] = _names(path.parent)
    form = re.compile(re.escape(match["start"]) + r"(\d+)" + re.escape(match["end"]))
    numbers = {int(m[1]): name for name in listing[path.parent] if (m := form.fullmatch(name))}
    own = int(match["number"])
    before = sorted(number for number in numbers if number < own)[-count:]
    after = sorted(number for number in numbers if number > own)[:count]
    return tuple(path.parent / numbers[number] for number in (*before, *after))


def frames_between(one: Path, other: Path) -> int | None:
    """How many frames after one the other is, by their names; None where these have no numbers.

    Example:
        >>> frames_between(Path("shot2.0010.a.exr"), Path("shot2.0008.a.exr")), frames_between(Path("a"), Path("b"))
        (-2, None)
    """
    first, second = (_NUMBERED.fullmatch(path.name) for path in (one, other))
    return None if first is None or second is None else int(second["number"]) - int(first["number"])


def _width(token: re.Match[str]) -> int:
    return len(token["hashes"]) if token["hashes"] else int(token["width"] or 1)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)  # noqa: PTH208 (names are all that is needed)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ExrError(f"{folder} cannot be read ({reason}): give a folder of EXR files") from None
