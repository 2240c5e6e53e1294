"""The methods: stages composed, each with one frozen dataclass of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import ParameterError
from . import auto, guided, nlm, regression, ssim_nlm
from .parameters import ParameterInfo, describe


@dataclass(frozen=True)
class Method:
    """One way to denoise.

    Attributes:
        name: as `method=` and `--method` take it.
        summary: one line.
        needs: planes it cannot do without, besides `color`.
        uses: planes it makes use of where they are there.
        parameters: names, defaults, ranges and meanings.
    """

    name: str
    summary: str
    needs: tuple[str, ...]
    uses: tuple[str, ...]
    parameters: tuple[ParameterInfo, ...]
    make: type
    run: Callable[..., Any]


#: What frames are denoised with unless a method is named: the most accurate by measurement (bench/quality.py).
DEFAULT_METHOD = auto.NAME

_METHODS = {
    module.NAME: Method(
        name=module.NAME,
        summary=module.SUMMARY,
        needs=module.NEEDS,
        uses=module.USES,
        parameters=describe(module.Parameters),
        make=module.Parameters,
        run=module.run,
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
    if name not in _METHODS:
        raise ParameterError(f"method is {name!r} but one of {', '.join(_METHODS)} is needed")
    return _METHODS[name]
