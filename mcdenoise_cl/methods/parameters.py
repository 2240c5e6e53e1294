"""Parameters of methods: frozen dataclasses whose fields know their range and their meaning."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field, fields
from typing import Any

import numpy as np

from ..errors import ParameterError

#: The largest number of any parameter without a range of its own: what float32 can hold.
LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class ParameterInfo:
    """What `methods()` tells of one parameter.

    Attributes:
        name: as `denoise(..., name=value)` and `--set name=value` take it.
        type: bool, int, float or str.
        default: its default; None means "chosen from the frame".
        low, high: the range, both ends included.
        choices: the words a str may be.
        meaning: one line, with the unit.
    """

    name: str
    type: type
    default: Any
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    meaning: str


def parameter(
    default: Any,
    meaning: str,
    *,
    kind: type | None = None,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """A dataclass field with its range; `kind` is needed where the default is None."""
    facts = {"meaning": meaning, "type": kind or type(default), "low": low, "high": high, "choices": choices}
    return field(default=default, metadata=facts)


def describe(cls: type) -> tuple[ParameterInfo, ...]:
    """The parameters of a dataclass made of `parameter` fields."""
    return tuple(
        ParameterInfo(name=f.name, default=None if f.default is MISSING else f.default, **f.metadata)
        for f in fields(cls)
    )


def make(cls: type, method: str, given: dict[str, Any]) -> Any:
    """The dataclass with the given values, each checked.

    Raises:
        ParameterError: an unknown name, a wrong type, or a value out of range.
    """
    known = {info.name: info for info in describe(cls)}
    for name in given:
        if name not in known:
            raise ParameterError(f"method {method!r} has no parameter {name!r}: it has {', '.join(known)}")
    return cls(**{name: _check(known[name], value) for name, value in given.items()})


def parse(info: ParameterInfo, text: str) -> Any:
    """A value written on the command line."""
    words = {"true": True, "yes": True, "on": True, "1": True, "false": False, "no": False, "off": False, "0": False}
    lower = text.strip().lower()
    if lower in ("none", "auto") and info.default is None:
        return None
    try:
        value = words[lower] if info.type is bool else info.type(text.strip())
    except (KeyError, ValueError):
        raise ParameterError(f"{info.name} is {shown(text)} but {_expected(info)} is needed") from None
    return _check(info, value)


def _check(info: ParameterInfo, value: Any) -> Any:
    if value is None and info.default is None:
        return None
    wrong = ParameterError(f"{info.name} is {shown(value)} but {_expected(info)} is needed")
    if info.type is str:
        if not isinstance(value, str) or value not in info.choices:
            raise wrong
        return value
    if isinstance(value, np.ndarray | np.generic) and value.ndim == 0 and value is not np.ma.masked:
        value = value.item()
    if info.type is bool:
        if not isinstance(value, bool):
            raise wrong
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong
    if not abs(value) < float("inf") or (info.type is int and value != int(value)):
        raise wrong
    if (info.low is not None and value < info.low) or (info.high is not None and value > info.high):
        raise wrong
    if abs(value) > LARGEST:
        raise ParameterError(f"{info.name} is {shown(value)}, which float32 cannot hold: {_expected(info)} is needed")
    return info.type(value)


def shown(value: Any) -> str:
    """What was given, on one line that is not too long."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an integer of too many digits, or an object that does not know itself
        return f"a {type(value).__name__}"
    return text if len(text) <= 80 else f"{text[:77]}..."


def _expected(info: ParameterInfo) -> str:
    if info.choices:
        return "one of " + ", ".join(info.choices)
    if info.type is bool:
        return "true or false"
    kind = "a whole number" if info.type is int else "a number"
    if info.low is not None and info.high is not None:
        kind += f" from {info.low:g} to {info.high:g}"
    elif info.low is not None:
        kind += f" of at least {info.low:g}"
    return kind + (", or none" if info.default is None else "")
