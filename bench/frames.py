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

import numpy as np

from mcdenoise_cl import Frame
from mcdenoise_cl.exr import read_exr, write_exr

#: Where a checkout keeps real frames, beside itself; --frames names another place.
BESIDE = Path(__file__).resolve().parents[2] / "shared" / "frames"
#: Sample counts, size and samples of the reference where frames are rendered.
SPP = (4, 32, 128)
SIZE = (480, 270)
REFERENCE_SPP = 1024


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
    parser.add_argument("--rendered", action="store_true", help="render frames even if there is a folder of them")
    parser.add_argument("--spp", type=int, nargs="*", default=[], help="sample counts; all there are by default")
    add_render_arguments(parser)


def add_render_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of frames that are rendered on the spot."""
    parser.add_argument("--cache", type=Path, default=Path("bench/cache"), help="where rendered frames are kept")
    parser.add_argument(
        "--render-size", nargs=2, type=int, default=SIZE, metavar=("W", "H"), help="pixels of rendered frames"
    )
    parser.add_argument("--reference-spp", type=int, default=REFERENCE_SPP, help="samples of rendered references")


def chosen_cases(options: argparse.Namespace) -> Iterator[Case]:
    """The frames that `add_arguments` asked for."""
    if _has_folder(options):
        return folder_cases(options.frames, tuple(options.spp))
    return rendered_cases(options.cache, tuple(options.spp) or SPP, options.reference_spp, *options.render_size)


def noisy_frame(options: argparse.Namespace) -> tuple[str, int, Frame, float]:
    """Scene, samples per pixel, planes and exposure of the first of the frames asked for, without its reference."""
    if _has_folder(options):
        case = next(folder_cases(options.frames, tuple(options.spp)), None)
        if case is None:
            raise SystemExit(f"{options.frames} has no frames with references, or none of the sample counts asked for")
        return case.scene, case.spp, case.frame, case.exposure
    from mcdenoise_cl.metrics import frame_exposure
    from mcdenoise_cl.render import scene_names

    scene, spp = scene_names()[0], min(options.spp or SPP)
    width, height = options.render_size
    frame = read_exr(rendered(options.cache, scene, spp, width, height, seed=1))
    return scene, spp, frame, frame_exposure(frame)


def enlarged(frame: Frame, width: int, height: int) -> Frame:
    """The frame continued by its mirror images, or cut, to a size."""
    planes = {}
    for name, plane in frame.planes().items():
        missing = [(0, max(0, n - have)) for n, have in zip((height, width), plane.shape, strict=False)]
        planes[name] = np.pad(plane, missing + [(0, 0)] * (plane.ndim - 2), mode="symmetric")[:height, :width]
    return Frame(**{name: np.ascontiguousarray(plane, np.float32) for name, plane in planes.items()})


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
    cache: Path,
    spp: tuple[int, ...],
    reference_spp: int,
    width: int,
    height: int,
    seed: int = 0,
    scenes: tuple[str, ...] = (),
) -> Iterator[Case]:
    """Our own scenes, or some of them, rendered once into `cache`."""
    from mcdenoise_cl.metrics import frame_exposure
    from mcdenoise_cl.render import scene_names

    for scene in scenes or scene_names():
        path = rendered(cache, scene, reference_spp, width, height, seed + 2, "reference")
        reference = read_exr(path)
        for n in spp:
            frame = read_exr(rendered(cache, scene, n, width, height, seed + 1))
            yield Case(scene, n, frame, reference, frame_exposure(reference))


def rendered(
    cache: Path, scene: str | Path, spp: int, width: int, height: int, seed: int, name: str = "", folder: str = ""
) -> Path:
    """The file of one rendered frame; `name` is the file's without .exr and stands for one sample count.

    Another sample count under the same name would be served stale, so such a frame is rendered again. `folder` is that
    of the scene, for one that is a file.
    """
    from mcdenoise_cl.render import render

    path = cache / f"{width}x{height}" / (folder or scene) / f"{name or f'spp{spp:04d}'}.exr"
    if path.exists() and (not name or int(read_exr(path).metadata["samples_per_pixel"]) == spp):
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    print(f"rendering {path.name} of {folder or scene}, {spp} samples per pixel", file=sys.stderr, flush=True)
    write_exr(path, render(scene, spp=spp, width=width, height=height, seed=seed, halves=True))
    return path


def _has_folder(options: argparse.Namespace) -> bool:
    if options.rendered:
        return False
    if options.frames.is_dir():
        return True
    if options.frames != BESIDE:
        raise SystemExit(f"{options.frames} is not a folder: give one, or leave --frames out to render scenes")
    return False
