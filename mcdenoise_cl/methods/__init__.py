"""The methods: stages composed, each with one frozen dataclass of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..errors import ParameterError
from . import nlm, regression, ssim_nlm
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
    for module in (nlm, ssim_nlm, regression)
}


def methods() -> list[Method]:
    """Every method with its parameters, their defaults and one line each.

    Example:
        >>> [method.name for method in methods()]
        ['nlm', 'ssim-nlm', 'regression']
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


def default_method(planes: Any) -> str:
    """The method for a frame with these planes, the most accurate by measurement (bench/quality.py): `regression`
    where anything but the colour is known, else `nlm`."""
    return regression.NAME if any(name in planes for name in regression.USES) else nlm.NAME
