"""The methods: stages composed, each with one frozen dataclass of its parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from ..errors import ParameterError
from . import auto, guided, nlm, regression, ssim_nlm
from .parameters import ParameterInfo, describe, shown
from .presets import DEFAULT_PRESET, PRESETS, settle

__all__ = ["DEFAULT_PRESET", "PRESETS", "Method", "get_method", "methods", "settle"]


@dataclass(frozen=True)
class Method:
    """One way to denoise.

    Attributes:
        name: as `method=` and `--method` take it.
        summary: one line.
        needs: planes it cannot do without, besides `color`.
        uses: planes it makes use of where they are there.
        halves_too: whether it makes use of half buffers where the variance of the colour is there as well.
        parameters: names, defaults, ranges and meanings.
        make: the parameters' dataclass.
        run: (engine, planes, parameters, facts) -> `Result`; facts None: the planes are a whole frame.
        survey: (engine, source, parameters) -> `Facts` of a frame that is to be filtered in bands.
        reach: (parameters) -> rows to each side that a row depends on, besides the facts.
        align: (engine, parameters) -> bands begin at multiples of so many rows.
    """

    name: str
    summary: str
    needs: tuple[str, ...]
    uses: tuple[str, ...]
    halves_too: bool
    parameters: tuple[ParameterInfo, ...]
    make: type
    run: Callable[..., Any]
    survey: Callable[..., Any]
    reach: Callable[..., int]
    align: Callable[..., int]

    def takes(self, present: Iterable[str]) -> list[str]:
        """Which of these planes of a frame it makes use of, in their order."""
        present = list(present)
        wanted = {"color", *self.needs, *self.uses}
        if "color_variance" in present and not self.halves_too:
            wanted -= {"color_a", "color_b"}
        return [name for name in present if name in wanted]


_METHODS = {
    module.NAME: Method(
        name=module.NAME,
        summary=module.SUMMARY,
        needs=module.NEEDS,
        uses=module.USES,
        halves_too=module is auto,
        parameters=describe(module.Parameters),
        make=module.Parameters,
        run=module.run,
        survey=module.survey,
        reach=module.reach,
        align=module.align,
    )
    for module in (nlm, ssim_nlm, regression, auto, guided)
}


def methods() -> list[Method]:
    """Every method with its parameters, their defaults and one line each.

    Example:
        >>> [method.name for method in methods()]
        ['nlm', 'ssim-nlm', 'regression', 'auto', 'guided']
        >>> methods()[0].parameters[0].name, methods()[0].parameters[0].default
        ('search_radius', 3)
    """
    return list(_METHODS.values())


def get_method(name: str) -> Method:
    """The method of that name.

    Raises:
        ParameterError: there is none.
    """
    if not isinstance(name, str) or name not in _METHODS:
        raise ParameterError(f"method is {shown(name)} but one of {', '.join(_METHODS)} is needed")
    return _METHODS[name]
