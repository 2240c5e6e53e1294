"""The demo: render a scene with few samples and with many, denoise the first, compare with the second."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .api import Denoiser
from .choose import pick_device
from .details import Denoised
from .errors import McdenoiseError, ParameterError
from .exr import write_exr
from .frame import Frame
from .maps import map_sheet
from .metrics import Scores, compare, frame_exposure
from .page import Entry, write_page
from .page.run import timed
from .pictures import Crop, feature_sheet, find_crops, normal_picture, pillow, side_by_side, to_png, write_png
from .render import pick_variant, render
from .report import scores_table, write_report

TITLE = "mcdenoise demo"
NOISY, REFERENCE = "noisy", "reference"
#: What the reference may take by default, so that all of the demo takes less than two minutes.
REFERENCE_SECONDS = 60
#: File name -> label, method and parameters, in the order in which people should see them.
METHODS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "nlm": ("NLM", "nlm", {}),
    "ssim-nlm-printed": ("SSIM-NLM as printed", "ssim-nlm", {"stabilised": False}),
    "ssim-nlm": ("SSIM-NLM", "ssim-nlm", {}),
    "guided": ("guided", "guided", {}),
    "auto": ("auto", "auto", {}),  # the last one, whose maps are shown
}
#: What stands above the table in the report.
ABOUT = """\
The scene `{scene}`, rendered with {spp} samples per pixel (`noisy.exr`), was denoised by each method. The scores
tell how far the results are from a rendering with {reference_spp} other samples per pixel (`reference.exr`): PSNR and
SSIM want to be high, MSE, relMSE and FLIP low. The time is that of one frame, from and to the memory of the host."""


@dataclass(frozen=True)
class Demo:
    """What `run_demo` returns.

    Attributes:
        page: path of report.html, which is opened in a browser.
        report: path of report.md, everything else is beside it.
        table: the scores, as in the report.
        device: what the methods ran on.
        scores: label -> scores.
    """

    page: Path
    report: Path
    table: str
    device: str
    scores: dict[str, Scores]


def run_demo(
    folder: str | Path,
    *,
    scene: str = "room",
    spp: int = 16,
    reference_spp: int | None = None,
    width: int | None = None,
    height: int | None = None,
    device: Any = None,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Demo:
    """Render, denoise, and write frames (EXR), pictures (PNG), `report.html` and `report.md` into a folder.

    Args:
        folder: made where it is missing; the files of an earlier demo are replaced, others are left alone.
        scene: name or path, as for `render`.
        spp: samples per pixel of the frame to denoise, an even number.
        reference_spp: those of the reference, an even number; None: what this machine renders in about a minute.
        width, height: in pixels; None: what suits the variant of Mitsuba that is picked. One alone keeps the aspect
            ratio.
        device: as for `Denoiser`.
        on_progress: called with the name of what is being done, and how much of how much is done.

    Raises:
        ParameterError: a number of samples that cannot be halved.
        McdenoiseError: the folder holds files of these names that are not a demo's, or Pillow is missing.
        RenderError, DeviceError: as for `render` and `Denoiser`.
    """
    folder, progress = Path(folder), on_progress or (lambda stage, done, total: None)
    for name, value in (("spp", spp), ("reference_spp", reference_spp)):
        if value is not None and (value < 2 or value % 2):
            raise ParameterError(f"{name} is {value} but an even number is needed, as each half of it makes an image")
    _check_folder(folder)
    pillow("Image")  # asked for now, rather than missed after minutes of rendering
    device = pick_device(device).device
    if width is None and height is None:
        # scalar_rgb renders without vectors, half as fast.
        width = 320 if pick_variant().startswith("scalar") else 400
    size = {"width": width, "height": height}

    noisy, done = _rendered(scene, spp, 0, size, progress)
    reference_spp = reference_spp or _affordable(done)
    reference, _ = _rendered(scene, reference_spp, 1, size, progress)

    images, times, found = {NOISY: noisy.color}, {}, {}
    for number, (name, (label, method, parameters)) in enumerate(METHODS.items()):
        progress("denoising", number, len(METHODS))
        denoiser = Denoiser(*noisy.shape, method=method, device=device, **parameters)
        images[name], times[label] = timed(denoiser, noisy)
        found[label] = Denoised(images[name], denoiser.model_map, denoiser.error_map, denoiser.report)
    progress("denoising", len(METHODS), len(METHODS))
    report = denoiser.report
    labels = {NOISY: f"input, {spp} spp"} | {name: label for name, (label, _, _) in METHODS.items()}
    scores = {labels[name]: compare(image, reference) for name, image in images.items()}

    progress("writing", 0, 1)
    exposure = frame_exposure(reference)
    images[REFERENCE], labels[REFERENCE] = reference.color, f"reference, {reference_spp} spp"
    # The noise that is left in the reference would pass for structure when places to magnify are looked for.
    crops = _crops(noisy.color, denoiser(reference), exposure)
    pictures = {
        "Side by side": _side_by_side(noisy, images, exposure, crops, labels, scores),
        "Features": feature_sheet(noisy),
        "What auto did": map_sheet(found["auto"]),
    }
    # Written first: by this report the next demo knows the folder as one it may use.
    about = ABOUT.format(scene=scene, spp=spp, reference_spp=reference_spp)
    path = write_report(folder, scores, times=times, pictures=pictures, device=report.device, title=TITLE, text=about)
    entries = {label: Entry(result.image, times[label], result, scores[label]) for label, result in found.items()}
    page = folder / "report.html"
    facts = {"scene": scene, "reference": f"{reference_spp} other samples per pixel"}
    write_page(page, noisy, entries, reference=reference, title=TITLE, about=facts, scores=scores[labels[NOISY]])
    write_exr(folder / f"{NOISY}.exr", noisy)
    write_exr(folder / f"{REFERENCE}.exr", reference)
    for name, image in images.items():
        write_png(folder / f"{name}.png", image, exposure)
        if name in METHODS:
            write_exr(folder / f"{name}.exr", image, template=folder / f"{NOISY}.exr")
    progress("writing", 1, 1)
    return Demo(page, path, scores_table(scores, times), report.device, scores)


def _check_folder(folder: Path) -> None:
    ours = folder / "report.md"
    try:
        if ours.is_file() and ours.read_text(encoding="utf-8").startswith(f"# {TITLE}\n"):
            return
    except (OSError, UnicodeDecodeError):
        pass  # then it is not ours
    names = [
        "report.md",
        "report.html",
        *(f"{name}.{end}" for name in (NOISY, REFERENCE, *METHODS) for end in ("exr", "png")),
    ]
    taken = next((name for name in names if (folder / name).exists()), None)
    if taken is not None:
        raise McdenoiseError(f"{folder} holds a {taken} that is not from a demo: choose another folder with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise McdenoiseError(f"{folder} cannot be made ({error.strerror}): choose another folder with --out") from None


def _rendered(
    scene: str, spp: int, seed: int, size: dict[str, int | None], progress: Callable[[str, int, int], None]
) -> tuple[Frame, list[tuple[float, int]]]:
    """A frame, and how many of its samples per pixel were done when."""
    stage, done = f"rendering {scene} with {spp} samples per pixel", []

    def note(samples: int, total: int) -> None:
        done.append((time.perf_counter(), samples))
        progress(stage, samples, total)

    note(0, spp)
    return render(scene, spp=spp, seed=seed, halves=True, on_progress=note, **size), done


def _affordable(done: list[tuple[float, int]]) -> int:
    """How many samples per pixel fit into `REFERENCE_SECONDS`, judged by the noisy frame: even, at least 16."""
    (start, _), (first, few), (last, all_of_them) = done[0], done[1], done[-1]
    seconds = (last - first) / (all_of_them - few)
    once = first - start - few * seconds  # loading the scene and compiling for it
    return 2 * int(np.clip((REFERENCE_SECONDS - once) / seconds, 16, 2048) / 2)


def _crops(noisy: np.ndarray, smooth: np.ndarray, exposure: float) -> list[Crop]:
    size = min(noisy.shape[:2]) // 4
    return find_crops(noisy, smooth, size=size, exposure=exposure) if size >= 2 else []


def _side_by_side(
    noisy: Frame,
    images: dict[str, np.ndarray],
    exposure: float,
    crops: list[Crop],
    labels: dict[str, str],
    scores: dict[str, Scores],
) -> np.ndarray:
    """Two rows: what there is to go by (input, its features, the truth), and what the methods make of it."""
    features = {"albedo": to_png(noisy.albedo), "normals": normal_picture(noisy.normal)}
    shown = {NOISY: images[NOISY], **features, REFERENCE: images[REFERENCE]}
    shown |= {name: images[name] for name in METHODS}
    texts = {name: f"its {name}" for name in features}
    for name, label in labels.items():
        score = scores.get(label)
        flip = "" if score is None or score.flip is None else f", FLIP {score.flip:.3f}"
        texts[name] = label if score is None else f"{label}\n{score.psnr:.1f} dB{flip}"
    return side_by_side(shown, exposure, crops=crops, labels=texts, columns=len(METHODS))
