"""Presets: methods and parameters that no other beats in both time and accuracy (the chart of bench/chart.py)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import ParameterError
from . import auto, guided, regression
from .parameters import shown


@dataclass(frozen=True)
class Preset:
    """A method and those of its parameters that differ from their defaults."""

    method: str
    parameters: Mapping[str, Any]


PRESETS = {
    "fast": Preset(guided.NAME, {}),
    "balanced": Preset(regression.NAME, {"search_radius": 5}),
    "high": Preset(auto.NAME, {}),
}

#: What frames are denoised with unless a method or another preset is named: the most accurate.
DEFAULT_PRESET = "high"


def settle(method: str | None, preset: str | None, parameters: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """The method and the parameters that a method or a preset, or neither, stand for.

    `parameters` go before those of a preset.

    Raises:
        ParameterError: both are given, or there is no such preset.

    Example:
        >>> settle(None, "balanced", {"ridge": 0.1})
        ('regression', {'search_radius': 5, 'ridge': 0.1})
    """
    if method is not None and preset is not None:
        raise ParameterError(
            f"method {shown(method)} and preset {shown(preset)} are both given: pass one, as a preset is a method"
        )
    if method is not None:
        return method, dict(parameters)
    if preset is not None and not (isinstance(preset, str) and preset in PRESETS):
        raise ParameterError(f"preset is {shown(preset)} but one of {', '.join(PRESETS)} is needed")
    chosen = PRESETS[preset or DEFAULT_PRESET]
    return chosen.method, {**chosen.parameters, **parameters}
