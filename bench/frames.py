"""Frames with references for measuring: a folder of them where there is one, else scenes rendered on the spot.

A folder of frames has one folder a scene, with `reference.exr` and one `spp*.exr` a sample count in it. Rendered
frames are kept in a cache folder, so that only the first run pays for them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mcdenoise_cl import Frame
from mcdenoise_cl.exr import read_exr, write_exr

#: Where a checkout keeps real frames, beside itself; MCDENOISE_FRAMES or --frames name another place.
BESIDE = Path(__file__).resolve().parents[2] / "shared" / "frames"


@dataclass(frozen=True)
class Case:
    """One noisy frame: its scene, samples per pixel, planes, reference and the exposure at which it is judged."""

    scene: str
    spp: int
    frame: Frame
    reference: Frame
    exposure: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that say which frames to measure on."""
    parser.add_argument("--frames", type=Path, default=BESIDE, help="folder of frames; rendered if it is not there")
    parser.add_argument("--spp", type=int, nargs="*", default=[], help="sample counts; all there are by default")
    parser.add_argument("--cache", type=Path, default=Path("bench/cache"), help="where rendered frames are kept")


def chosen_cases(options: argparse.Namespace) -> Iterator[Case]:
    """The frames that `add_arguments` asked for."""
    if options.frames.is_dir():
        return folder_cases(options.frames, tuple(options.spp))
    if options.frames != BESIDE:
        raise SystemExit(f"{options.frames} is not a folder: give one, or leave --frames out to render scenes")
    return rendered_cases(options.cache, tuple(options.spp) or (4, 32, 128), 1024, 480, 270)


def folder_cases(folder: Path, spp: tuple[int, ...] = ()) -> Iterator[Case]:
    """Every noisy frame of a folder, or those of the sample counts asked for."""
    for reference_path in sorted(folder.glob("*/reference.exr")):
        reference = read_exr(reference_path)
        for path in sorted(reference_path.parent.glob("spp*.exr")):
            frame = read_exr(path)
            samples = int(frame.metadata["samples_per_pixel"])
            if not spp or samples in spp:
                exposure = float(frame.metadata.get("exposure_scale", reference.metadata.get("exposure_scale", 1.0)))
                yield Case(reference_path.parent.name, samples, frame, reference, exposure)


def rendered_cases(
    cache: Path, spp: tuple[int, ...], reference_spp: int, width: int, height: int, seed: int = 0
) -> Iterator[Case]:
    """Our own scenes, rendered once into `cache`."""
    from mcdenoise_cl.metrics import frame_exposure
    from mcdenoise_cl.render import render, scene_names

    for scene in scene_names():
        folder = cache / f"{width}x{height}" / scene
        folder.mkdir(parents=True, exist_ok=True)
        wanted = {folder / f"spp{n:04d}.exr": (n, seed + 1) for n in spp}
        wanted[folder / "reference.exr"] = (reference_spp, seed + 2)
        for path, (samples, number) in wanted.items():
            if not path.exists():
                print(f"rendering {path.name} of {scene}, {samples} samples per pixel", file=sys.stderr, flush=True)
                write_exr(path, render(scene, spp=samples, width=width, height=height, seed=number, halves=True))
        reference = read_exr(folder / "reference.exr")
        for n in spp:
            frame = read_exr(folder / f"spp{n:04d}.exr")
            yield Case(scene, n, frame, reference, frame_exposure(reference))
