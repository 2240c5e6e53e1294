"""What of ours is measured, in one place: a name as tables and charts show it, and what `Denoiser` gets for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mcdenoise_cl.methods import get_method, settle

#: Name -> keyword arguments of `Denoiser`, besides the frame's size and the device. The presets "fast" and "high" are
#: `guided` and `auto` as they are.
ENTRIES: dict[str, dict[str, Any]] = {
    "nlm": {"method": "nlm"},
    "ssim-nlm": {"method": "ssim-nlm"},
    "guided": {"method": "guided"},
    "regression, balanced": {"preset": "balanced"},
    "regression": {"method": "regression"},
    "auto": {"method": "auto"},
}


@dataclass(frozen=True)
class Entry:
    """One of our denoisers with one choice of settings.

    Attributes:
        name: as tables show it, a key of ENTRIES.
        arguments: keyword arguments of `Denoiser`.
        needs: planes besides `color`.
        planes: every plane that the method looks at.
    """

    name: str
    arguments: dict[str, Any]
    needs: tuple[str, ...]
    planes: tuple[str, ...]


def entry(name: str) -> Entry:
    """The entry of that name."""
    arguments = ENTRIES[name]
    method = get_method(method_of(name))
    return Entry(name, arguments, method.needs, ("color", *method.needs, *method.uses))


def method_of(name: str) -> str:
    """The method that an entry stands for."""
    arguments = ENTRIES[name]
    return settle(arguments.get("method"), arguments.get("preset"), {})[0]


def chosen_entries(names: list[str]) -> list[Entry]:
    """Entries by name, in the order of ENTRIES."""
    return [entry(name) for name in ENTRIES if name in names]
