"""What several commands of `mcdenoise` share: options, and the errors of wrong usage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from .choose import pick_device, pick_devices
from .device import list_devices
from .errors import DeviceError


def _debug(context: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        context.find_root().obj["debug"] = True


# Taken before and after the command's name: whoever runs a command again appends it.
debug_option = click.option(
    "--debug", is_flag=True, expose_value=False, is_eager=True, callback=_debug, help="Show the traceback of an error."
)
device_option = click.option(
    "--device",
    metavar="D",
    help="Index or part of a name, as `mcdenoise devices` lists them (or set MCDENOISE_DEVICE).",
)
devices_option = click.option(
    "--device",
    metavar="D",
    help="Index or part of a name, as `mcdenoise devices` lists them (or set MCDENOISE_DEVICE); all: share the frames.",
)
force_option = click.option("--force", is_flag=True, help="Replace existing output files; inputs are never replaced.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
COUNT = click.IntRange(min=1)
PATH = click.Path(path_type=Path)


def usage(message: str) -> click.UsageError:
    """Wrong usage of the command that runs, to be raised."""
    return click.UsageError(message, click.get_current_context())


def chosen_device(choice: str | None) -> Any:
    """The device, before any work is done. A wrong --device is wrong usage; to have no device at all is not."""
    return _chosen(choice, lambda: pick_device(choice).device)


def chosen_devices(choice: str | None) -> list[Any]:
    """The same where there may be several."""
    return _chosen(choice, lambda: [info.device for info in pick_devices(choice)])


def _chosen(choice: str | None, pick: Callable[[], Any]) -> Any:
    known = list_devices()
    try:
        return pick()
    except DeviceError as error:
        if choice is None or not known:
            raise
        raise usage(str(error)) from error


def split(option: str, form: str, pairs: Sequence[str]) -> list[tuple[str, str]]:
    """Names and values of a repeated option such as --set NAME=VALUE."""
    for pair in pairs:
        if "=" not in pair:
            raise usage(f"{option} is {pair!r}, but {form} is needed")
    return [(name.strip(), text) for name, _, text in (pair.partition("=") for pair in pairs)]
