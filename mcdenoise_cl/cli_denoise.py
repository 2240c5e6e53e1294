"""The command `mcdenoise denoise`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import click

from .cli_options import COUNT, chosen_devices, debug_option, devices_option, force_option, split, usage
from .console_batch import Teller, note_pairs, tell_outcome, tell_outcomes, tell_plan
from .exr_layers import MOTION
from .frame import PLANES
from .methods import DEFAULT_PRESET, PRESETS, get_method, methods, settle
from .methods.parameters import parse

# batch is imported by the command: it takes its time.


@click.command()
@click.argument("inputs", nargs=-1, metavar="INPUT...")
@click.option("-o", "--output", required=True, metavar="PATH", help="File to write; for anything but one file: folder.")
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
@click.option("--set", "settings", multiple=True, metavar="NAME=VALUE", help="A parameter: see `mcdenoise methods`.")
@click.option(
    "--layer",
    "layers",
    multiple=True,
    metavar="PLANE=NAME",
    help="The layer of a plane, where it is not recognised; none leaves the plane out, as motion=none does the motion "
    f"vectors. Planes: {', '.join(PLANES)}.",
)
@click.option(
    "--also",
    metavar="NAME,...",
    help="Further RGB layers to filter with what is found for the colour, so that light AOVs still sum to it.",
)
@click.option(
    "--layers",
    "automatic",
    type=click.Choice(["auto"]),
    help="auto: instead of --also all layers that in groups sum to the colour.",
)
@click.option("--samples", type=COUNT, metavar="N", help="Samples per pixel, where the file does not tell.")
@devices_option
@click.option(
    "--max-memory-mb",
    type=COUNT,
    metavar="N",
    help="MiB to use besides the frame itself; large frames are filtered in bands. By default what the device has.",
)
@click.option("--halves", nargs=2, metavar="A B", help="Instead of INPUT: two renderings with different seeds.")
@click.option("--pairs", is_flag=True, help="name.a.exr and name.b.exr are two such renderings of name.exr.")
@click.option("--recursive", is_flag=True, help="Look into folders in folders too.")
@click.option("--frames", metavar="RANGE", help="Frames of shot.####.exr: 1-240, 1-240x2 for every second, 1,5,10-20.")
@click.option(
    "--temporal",
    type=click.IntRange(min=0),
    default=0,
    metavar="N",
    help="Merge what N frames before and after show of the same, found by the numbers in their names. Default: 0.",
)
@click.option(
    "--dask", metavar="ADDRESS", help="Hand the frames to a Dask cluster; local: one of this machine's devices."
)
@click.option("--dry-run", is_flag=True, help="Say what would be done and why, and do nothing.")
@click.option("--json", "as_json", is_flag=True, help="A line of JSON on stdout for each thing that happens.")
@force_option
@debug_option
@click.pass_context
def denoise(
    context: click.Context,
    inputs: tuple[str, ...],
    output: str,
    method: str | None,
    preset: str | None,
    settings: tuple[str, ...],
    layers: tuple[str, ...],
    also: str | None,
    automatic: str | None,
    samples: int | None,
    device: str | None,
    max_memory_mb: int | None,
    force: bool,
    dry_run: bool,
    as_json: bool,
    halves: tuple[str, str] | None,
    temporal: int,
    dask: str | None,
    **chosen: Any,
) -> int:
    """Denoise EXR files.

    INPUT is a file, a folder of *.exr, a pattern such as 'shots/*/beauty.exr', or a sequence such as shot.####.exr or
    shot.%04d.exr. Only the colour is replaced, and the layers of --also: the outputs keep every other layer of the
    inputs.

    Of several files those whose output is up to date are skipped: it was made of the same files (by size and time)
    with the same options. Outputs that are out of date are made again. Without --force nothing else is replaced.

    \b
    mcdenoise denoise noisy.exr -o clean.exr
    mcdenoise denoise frames/ -o clean/ --preset balanced
    mcdenoise denoise noisy.exr -o clean.exr --also diffuse,specular
    mcdenoise denoise 'shot.####.exr' --frames 1-240 -o clean/ --device all
    mcdenoise denoise 'shot.####.exr' -o clean/ --temporal 1
    mcdenoise denoise --halves seed1.exr seed2.exr -o clean.exr
    mcdenoise denoise /shared/shot/ -o /shared/clean/ --dask tcp://render01:8786
    """
    from . import batch, farm, selection
    from .job import Recipe
    from .pipeline import run_jobs
    from .quiet import quiet_libraries

    if bool(inputs) == (halves is not None):
        raise usage("INPUT or --halves A B is needed, one of them")
    if method is not None and preset is not None:
        raise usage(f"--method {method} and --preset {preset} are both given: a preset is a method, so give one")
    if also is not None and automatic is not None:
        raise usage(f"--also {also} and --layers {automatic} are both given: give one")
    name, parameters = settle(method, preset, {})
    parameters |= _parameters(name, settings)
    recipe = Recipe.of(
        name,
        layers=_layers(layers),
        samples_per_pixel=samples,
        max_memory_mb=max_memory_mb,
        also=automatic or _names(also),
        temporal=temporal,
        **parameters,
    )
    given = [halves] if halves else inputs
    to_folder = len(given) > 1 or os.path.isdir(output) or output.endswith(("/", os.sep))  # noqa: PTH112
    alone = not to_folder and selection.is_one_file(given[0])
    if alone:
        for option in ("frames", "pairs"):
            if chosen[option]:
                raise usage(f"--{option} is given but {given[0]} is one file: give a folder, a pattern or a sequence")
        jobs = [selection.one_job(given[0], output, recipe.temporal)]
        batch.check_job(jobs[0], recipe, force)
    else:
        jobs = selection.find_jobs(given, output, temporal=recipe.temporal, **chosen)
    if dry_run:
        return 0 if tell_plan(batch.plan(jobs, recipe, force), as_json) else 1
    devices = chosen_devices(device) if dask is None else []
    if alone and not as_json and dask is None:
        with quiet_libraries():
            outcome = batch.do(jobs[0], recipe, device=devices[0], overwrite=force)
        tell_outcome(outcome, automatic=method is None)
        return 0
    batch.prepare(jobs, os.path.dirname(output) if alone else output)  # noqa: PTH120
    if not chosen["pairs"]:
        note_pairs(selection.count_pairs(jobs))
    teller = Teller(f"denoising into {output}", jobs, recipe, as_json)
    with quiet_libraries(), teller:
        if dask is None:
            run_jobs(jobs, recipe, devices, overwrite=force, on_progress=teller.show)
        else:
            more = {"device": device, "overwrite": force, "on_progress": teller.show, "on_note": teller.note}
            farm.run_jobs(jobs, recipe, dask, **more)
    return 0 if tell_outcomes(teller.outcomes, context.obj["debug"]) else 1


def _parameters(method: str, pairs: Sequence[str]) -> dict[str, Any]:
    """Values by name from NAME=VALUE."""
    known = {info.name: info for info in get_method(method).parameters}
    values = {}
    for name, text in split("--set", "NAME=VALUE", pairs):
        if name not in known:
            raise usage(f"--set has {name!r}, but method {method} has the parameters {', '.join(known)}")
        values[name] = parse(known[name], text)
    return values


def _names(text: str | None) -> tuple[str, ...]:
    """Names of layers from what --also was given."""
    names = [name.strip() for name in (text or "").split(",")]
    if text is not None and not all(names):
        raise usage(f"--also is {text!r}, but names of layers separated by commas are needed")
    return tuple(names) if text is not None else ()


def _layers(pairs: Sequence[str]) -> dict[str, str]:
    layers = dict(split("--layer", "PLANE=NAME", pairs))
    for plane in layers:
        if plane not in (*PLANES, MOTION):
            raise usage(f"--layer has {plane!r}, but the planes are {', '.join(PLANES)}")
    return layers
