"""The command `mcdenoise report`."""

from __future__ import annotations

from pathlib import Path

import click

from .cli_options import COUNT, PATH, chosen_device, debug_option, device_option, force_option, split
from .console import Progress, note_missing_metrics, say
from .frame import PLANES
from .methods import PRESETS, methods

# page is imported by the command: it takes its time.


@click.command()
@click.argument("noisy", metavar="NOISY")
@click.argument("clean", nargs=-1, metavar="[CLEAN]...")
@click.option("-o", "--output", type=PATH, required=True, metavar="FILE", help="HTML file to write.")
@click.option("--reference", metavar="FILE", help="EXR file with the truth: everything is scored against it.")
@click.option(
    "--method",
    "chosen",
    multiple=True,
    type=click.Choice([method.name for method in methods()]),
    help="Denoise with it; may be given more than once.",
)
@click.option("--preset", "presets", multiple=True, type=click.Choice(list(PRESETS)), help="The same, with a preset.")
@click.option(
    "--layer",
    "layers",
    multiple=True,
    metavar="PLANE=NAME",
    help=f"The layer of a plane of NOISY, where it is not recognised. Planes: {', '.join(PLANES)}.",
)
@click.option("--samples", type=COUNT, metavar="N", help="Samples per pixel, where the file does not tell.")
@click.option("--title", metavar="TEXT", help="Of the page; default: the name of NOISY.")
@click.option(
    "--max-mb",
    type=click.FloatRange(min=1),
    metavar="X",
    help="Megabytes of the page, which decide how finely light is stored; default: 10, more above 1280x720.",
)
@device_option
@force_option
@debug_option
def report(
    noisy: str,
    clean: tuple[str, ...],
    output: Path,
    reference: str | None,
    chosen: tuple[str, ...],
    presets: tuple[str, ...],
    layers: tuple[str, ...],
    samples: int | None,
    title: str | None,
    max_mb: float | None,
    device: str | None,
    force: bool,
) -> None:
    """Compare EXR files in a page for the browser.

    One HTML file that needs no network: a divider between any two of the input, the clean images, the reference, error
    maps and features, with zoom and exposure; scores, times and what each method found. Without CLEAN files, NOISY is
    denoised with the methods and presets that are named, or with every preset.

    \b
    mcdenoise report noisy.exr -o report.html
    mcdenoise report noisy.exr clean.exr --reference reference.exr -o report.html
    mcdenoise report noisy.exr --method nlm --preset high -o report.html
    """
    from .page.run import report_files

    with Progress() as progress:
        page = report_files(
            noisy,
            output,
            clean=clean,
            reference=reference,
            methods=chosen,
            presets=presets,
            layers=dict(split("--layer", "PLANE=NAME", layers)),
            samples_per_pixel=samples,
            device=None if clean and not (chosen or presets) else chosen_device(device),
            title=title,
            max_mb=max_mb,
            overwrite=force,
            on_progress=progress.show,
        )
    if reference is not None:
        note_missing_metrics()
    for name, why in page.unscored.items():
        say(f"note: {name} has no scores: {why}")
    size = len(page.html.encode()) / 1e6
    if not page.fits:
        say(f"note: the page is larger than asked for, as light is stored no more coarsely than to {page.worst:.1%}")
    say(f"{output}: {size:.1f} MB, light within {page.worst:.2%}, {page.mean:.2%} on average; open it in a browser")
