"""The command `mcdenoise`: arguments in, calls of the other modules out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from . import __version__, methods
from .choose import pick_device
from .cli_denoise import denoise
from .cli_options import COUNT, PATH, chosen_device, debug_option, device_option, force_option, json_option, usage
from .cli_report import report
from .console import (
    Progress,
    note_missing_metrics,
    print_devices,
    print_methods,
    print_scores,
    print_trials,
    say,
    sentence,
    show_traceback,
)
from .device import identity, list_devices, shape_for
from .errors import DeviceError, FrameError, ParameterError
from .frame import Frame
from .quiet import hushed

# batch, demo, exr, metrics, render and report are imported by the commands that use them: they take their time.


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code. Every failure is one sentence on stderr."""
    state = {"debug": False}
    try:
        return mcdenoise.main(arguments, prog_name="mcdenoise", standalone_mode=False, obj=state) or 0
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "mcdenoise"
        failure, text, code = error, f"{error.format_message().rstrip('.')}; see {command} --help", 2
    except click.Abort as error:  # what click makes of Ctrl-C
        failure, text, code = error, "interrupted: files already finished are whole, no other was touched", 130
    except Exception as error:
        failure, text, code = error, sentence(error), 2 if isinstance(error, ParameterError) else 1
    if state["debug"]:
        show_traceback(failure)
    say(f"mcdenoise: {text}")
    return code


@click.group(
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
    epilog="Exit codes: 0 done, 1 failed, 2 wrong usage, 130 interrupted.",
)
@click.version_option(__version__, message="%(prog)s %(version)s")
@debug_option
@click.pass_context
def mcdenoise(context: click.Context) -> None:
    """Denoise Monte Carlo renderings on any OpenCL device."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())


mcdenoise.add_command(denoise)
mcdenoise.add_command(report)


@mcdenoise.command()
@json_option
@debug_option
def devices(as_json: bool) -> None:
    """List the OpenCL devices.

    The one that is used when --device is not given is marked with *.
    """
    found = list_devices()
    try:
        default, wrong = pick_device(), None
    except DeviceError as error:  # such as a MCDENOISE_DEVICE that is none of these: the list shows what it could be
        default, wrong = None, error
    print_devices(found, default, as_json)
    if wrong is not None:
        raise wrong


@mcdenoise.command()
@device_option
@click.option("--reset", is_flag=True, help="Forget what was found, and measure nothing.")
@debug_option
def tune(device: str | None, reset: bool) -> None:
    """Find out which shapes of kernels are fastest on the device.

    Takes a minute or two on a CPU. What is found is kept in the user's cache folder and used from then on; without it,
    shapes are used that should do well on any device of the kind.
    """
    from .measured import forget
    from .tune import tune as measure

    info = pick_device(chosen_device(device))
    if reset:
        forget(identity(info))
        say(f"{info.name}: the usual shapes are used again")
        return
    with Progress() as progress:
        trials = measure(info, lambda done, count: progress.show("trying shapes", done, count))
    print_trials(trials, shape_for(info.device))


@mcdenoise.command("methods")
@json_option
@debug_option
def list_methods(as_json: bool) -> None:
    """List the methods and their parameters.

    A parameter is shown as NAME=DEFAULT, the way --set takes it, with its range and its meaning.
    """
    print_methods(methods(), as_json)


@mcdenoise.command()
@click.argument("scene", required=False)
@click.option("-o", "--output", type=PATH, metavar="FILE", help="EXR file to write.")
@click.option("--spp", type=COUNT, metavar="N", help="Samples per pixel.")
@click.option("--width", type=COUNT, metavar="W", help="In pixels; default: the scene's, or by the height.")
@click.option("--height", type=COUNT, metavar="H", help="In pixels; default: the scene's, or by the width.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the random numbers.")
@click.option("--halves", is_flag=True, help="Also two independent images of half the samples each.")
@click.option("--variant", metavar="V", help="Mitsuba variant; default: the fastest that runs here.")
@click.option("--list", "only_list", is_flag=True, help="List the scenes that come with mcdenoise.")
@force_option
@debug_option
def render(
    scene: str | None, output: Path | None, spp: int | None, only_list: bool, force: bool, **options: Any
) -> None:
    """Render a scene with Mitsuba into one EXR file.

    SCENE is a Mitsuba 3 XML file or the name of one of ours (--list). The file holds all that denoising needs: colour,
    albedo, normal, depth, and their variances.
    """
    from . import batch, exr
    from .render import render, scene_names

    if only_list:
        click.echo("\n".join(scene_names()))
        return
    for value, name in ((scene, "SCENE"), (output, "-o FILE"), (spp, "--spp N")):
        if value is None:
            raise usage(f"{name} is missing")
    batch.check_target(output, force)
    with Progress() as progress:
        frame = render(scene, spp=spp, **options, on_progress=partial(progress.show, f"rendering {scene}"))
    exr.write_exr(output, frame)
    height, width = frame.shape
    say(f"{output}: {width} x {height}, {spp} samples per pixel, {', '.join(frame.planes())}")


@mcdenoise.command()
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@click.option("--reference", required=True, metavar="FILE", help="The EXR file to compare with.")
@click.option("--exposure", type=float, metavar="X", help="Factor for display; default: the reference's, or automatic.")
@json_option
@debug_option
def compare(images: tuple[str, ...], reference: str, exposure: float | None, as_json: bool) -> None:
    """Score EXR files against a reference.

    PSNR, MSE, SSIM and FLIP look at the tonemapped pictures, relMSE at the linear values.
    In JSON null stands for a metric that is not available, and for the infinite PSNR of equal images.
    """
    from . import exr, metrics
    from .report import scores_table

    def read(path: str) -> Frame:
        with hushed():
            return exr.read_exr(path)

    truth, scores = read(reference), {}
    for image in images:
        try:
            scores[image] = metrics.compare(read(image).color, truth, exposure)
        except FrameError as error:
            raise FrameError(f"{image} against {reference}: {error}") from error
    if as_json:
        print_scores(scores)
    else:
        click.echo(scores_table(scores))
    note_missing_metrics()


@mcdenoise.command()
@click.option("--out", "folder", type=PATH, default="mcdenoise-demo", show_default=True, help="Folder for everything.")
@click.option("--scene", default="room", show_default=True, help="See `mcdenoise render --list`.")
@click.option("--spp", type=COUNT, default=16, show_default=True, metavar="N", help="Samples per pixel to denoise.")
@click.option(
    "--reference-spp", type=COUNT, metavar="N", help="Those of the reference; default: about a minute of them."
)
@click.option("--width", type=COUNT, metavar="W", help="In pixels; default: what this machine renders in time.")
@click.option("--height", type=COUNT, metavar="H", help="In pixels; default: by the width.")
@device_option
@debug_option
def demo(folder: Path, device: str | None, **options: Any) -> None:
    """Render a scene, denoise it, look at it.

    Takes two minutes: the scene is rendered with few samples and, as a reference, with many; every method denoises the
    first; a page for the browser, frames, pictures and a report with scores and times are left in a folder. The files
    of an earlier demo in that folder are replaced, nothing else in it is touched.
    """
    from .demo import run_demo

    chosen = chosen_device(device)
    with Progress() as progress:
        result = run_demo(folder, **options, device=chosen, on_progress=progress.show)
    click.echo(result.table)
    note_missing_metrics()
    say(f"Denoised on {result.device}. Open {result.page} in a browser; pictures are in {result.report}.")
