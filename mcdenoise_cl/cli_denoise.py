"""The command `mcdenoise denoise`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import click

from .cli_options import COUNT, chosen_device, debug_option, device_option, force_option, split, usage
from .console import Progress, tell_outcome, tell_outcomes
from .frame import PLANES
from .methods import DEFAULT_PRESET, PRESETS, get_method, methods, settle
from .methods.parameters import parse

# batch is imported by the command: it takes its time.


@click.command()
@click.argument("inputs", nargs=-1, required=True, metavar="INPUT...")
@click.option(
    "-o", "--output", required=True, metavar="PATH", help="File to write; of several inputs or a folder: folder."
)
@click.option(
    "--method",
    type=click.Choice([method.name for method in methods()]),
    help="See `mcdenoise methods`.",
)
@click.option(
    "--preset",
    type=click.Choice(list(PRESETS)),
    help=f"How long it may take; instead of a method. Default: {DEFAULT_PRESET}.",
)
@click.option("--set", "pairs", multiple=True, metavar="NAME=VALUE", help="A parameter: see `mcdenoise methods`.")
@click.option(
    "--layer",
    "layers",
    multiple=True,
    metavar="PLANE=NAME",
    help=f"The layer of a plane, where it is not recognised; none leaves the plane out. Planes: {', '.join(PLANES)}.",
)
@click.option("--samples", type=COUNT, metavar="N", help="Samples per pixel, where the file does not tell.")
@device_option
@click.option(
    "--max-memory-mb",
    type=COUNT,
    metavar="N",
    help="MiB to use besides the frame itself; large frames are filtered in bands. By default what the device has.",
)
@force_option
@debug_option
@click.pass_context
def denoise(
    context: click.Context,
    inputs: tuple[str, ...],
    output: str,
    method: str | None,
    preset: str | None,
    pairs: tuple[str, ...],
    layers: tuple[str, ...],
    samples: int | None,
    device: str | None,
    max_memory_mb: int | None,
    force: bool,
) -> int:
    """Denoise EXR files, or every *.exr directly in a folder.

    Only the colour is replaced: the outputs keep every other layer of the inputs. An existing output is refused (one
    file) or skipped (several) without --force.

    \b
    mcdenoise denoise noisy.exr -o clean.exr
    mcdenoise denoise frames/ -o clean/ --preset balanced
    mcdenoise denoise frames/ -o clean/ --method nlm --set h_factor=1.2
    """
    from . import batch

    if method is not None and preset is not None:
        raise usage(f"--method {method} and --preset {preset} are both given: a preset is a method, so give one")
    name, parameters = settle(method, preset, {})
    options = {"method": name, "layers": _layers(layers), "samples_per_pixel": samples, "overwrite": force}
    options |= parameters | _parameters(name, pairs) | {"device": chosen_device(device), "max_memory_mb": max_memory_mb}
    is_dir = os.path.isdir  # a Path's raises for a name that is too long
    is_folder = is_dir(inputs[0])
    if len(inputs) > 1 and any(map(is_dir, inputs)):
        raise usage("there is a folder among several inputs, but one folder or several files are needed")
    if len(inputs) == 1 and not is_folder and not is_dir(output) and not output.endswith(("/", os.sep)):
        tell_outcome(batch.denoise_file(inputs[0], output, **options), automatic=method is None)
        return 0
    sources = batch.find_exrs(inputs[0]) if is_folder else inputs
    done: list[batch.Outcome] = []
    with Progress() as progress:

        def show(outcome: batch.Outcome) -> None:
            done.append(outcome)
            progress.show(f"denoising into {output}", len(done), len(sources))

        batch.denoise_files(sources, output, **options, on_progress=show)
    return 0 if tell_outcomes(done, context.obj["debug"]) else 1


def _parameters(method: str, pairs: Sequence[str]) -> dict[str, Any]:
    """Values by name from NAME=VALUE."""
    known = {info.name: info for info in get_method(method).parameters}
    values = {}
    for name, text in split("--set", "NAME=VALUE", pairs):
        if name not in known:
            raise usage(f"--set has {name!r}, but method {method} has the parameters {', '.join(known)}")
        values[name] = parse(known[name], text)
    return values


def _layers(pairs: Sequence[str]) -> dict[str, str]:
    layers = dict(split("--layer", "PLANE=NAME", pairs))
    for plane in layers:
        if plane not in PLANES:
            raise usage(f"--layer has {plane!r}, but the planes are {', '.join(PLANES)}")
    return layers
