"""Putting a page together and writing it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ..frame import Frame
from ..metrics import Scores
from ..pictures import replace_file
from .budget import Packed, bytes_for, pack
from .content import REFERENCE, Content, gather
from .planes import MARKS, Plane
from .tables import about_table, chart_section, method_sections, scores_section

SCRIPTS = ("decode.js", "paint.js", "view.js", "probe.js", "main.js")


@dataclass(frozen=True)
class Page:
    """What `make_page` returns.

    Attributes:
        html: the whole file.
        worst, mean: largest and mean relative error with which light is stored, of what is at least 1/128 of display
            white.
        fits: whether it is as small as was asked for.
        scores: name -> scores, where there is a reference.
        unscored: name -> why it has none.
    """

    html: str
    worst: float
    mean: float
    fits: bool
    scores: Mapping[str, Scores]
    unscored: Mapping[str, str]


def make_page(
    frame: Frame,
    results: Mapping[str, Any],
    *,
    reference: Any = None,
    title: str = "Denoising report",
    about: Mapping[str, str] | None = None,
    scores: Scores | None = None,
    max_mb: float | None = None,
    on_progress: Callable[[str, int, int], None] | None = None,
) -> Page:
    """A page that compares a frame with its results.

    Args:
        frame: the noisy one; its albedo, normal and depth are shown where it has them.
        results: name -> array (H, W, 3), `Denoised`, or `Entry` with times and more.
        reference: (H, W, 3) or a `Frame`: the truth, against which everything is scored and errors are shown.
        about: further facts for the page, such as the file's name.
        scores: the input's, where they are known.
        max_mb: megabytes of the page; None: 10, and for frames of more than 1280 x 720 pixels more in proportion.
            Light is stored as finely as that allows: the page says how finely.
        on_progress: called with the name of what is being done, and how much of how much is done.

    Raises:
        FrameError: an image has another size than the frame.
        ParameterError: a result has a name that the page uses itself, or `max_mb` is less than 1.

    Example:
        >>> import numpy as np
        >>> frame = Frame(np.ones((8, 8, 3), np.float32))
        >>> page = make_page(frame, {"half": frame.color / 2}, title="Half <of> it")
        >>> "<title>Half &lt;of&gt; it</title>" in page.html, page.worst < 0.005
        (True, True)
    """
    progress = on_progress or (lambda stage, done, total: None)
    budget = bytes_for(*frame.shape, max_mb)
    if reference is not None:
        progress("scoring", 0, 1)
    content = gather(frame, results, reference, scores)
    stored = pack(content.planes, budget, lambda done, total: progress("encoding", done, total))
    folder = files(__package__)
    parts = {
        "title": escape(title),
        "style": folder.joinpath("page.css").read_text("utf-8"),
        "script": "\n".join(folder.joinpath(name).read_text("utf-8") for name in SCRIPTS),
        "summary": escape(_summary(content)),
        "scores": scores_section(content),
        "chart": chart_section(content),
        "methods": method_sections(content),
        "about": about_table(content, stored, about or {}),
        "facts": _json(_facts(content, stored)),
        "data": "\n".join(
            f'<script type="text/plain" id="plane-{index}">{text}</script>' for index, text in enumerate(stored.texts)
        ),
    }
    template = folder.joinpath("page.html").read_text("utf-8")
    html = re.sub(r"<!--(\w+)-->", lambda match: parts[match[1]], template)
    return Page(html, stored.worst, stored.mean, stored.fits, content.scores, content.unscored)


def write_page(path: str | Path, frame: Frame, results: Mapping[str, Any], **options: Any) -> Page:
    """`make_page` into a file, which appears whole or not at all; an existing one is replaced.

    Args:
        path: of the file; its folder must exist.
        frame, results, **options: as for `make_page`.

    Raises:
        McdenoiseError: the file cannot be written.
    """
    page = make_page(frame, results, **options)
    replace_file(Path(path), page.html.encode())
    return page


def _summary(content: Content) -> str:
    height, width = content.size
    samples = content.metadata.get("samples_per_pixel")
    parts = [f"{width} × {height} pixels", f"{samples} samples per pixel" if samples else ""]
    devices = {entry.report.device.split(" (")[0] for entry in content.entries.values() if entry.report}
    return " · ".join([*filter(None, parts), *sorted(devices)])


def _facts(content: Content, stored: Packed) -> dict[str, Any]:
    height, width = content.size
    planes = [_plane_facts(plane) for plane in stored.planes]
    names = [plane.name for plane in stored.planes if plane.kind == "light"]
    judged = [name for name in names if name != REFERENCE] if REFERENCE in names else []
    return {
        "width": width,
        "height": height,
        "marks": MARKS,
        "planes": planes,
        "judged": judged,
        "reference": REFERENCE if judged else None,
    }


def _plane_facts(plane: Plane) -> dict[str, Any]:
    facts = {"name": plane.name, "kind": plane.kind, "scale": plane.scale, "step": plane.step, "dark": plane.dark}
    facts["channels"] = 3 if np.ndim(plane.values) == 3 else 1
    return facts | {"labels": list(plane.labels)} | plane.facts


def _json(facts: Any) -> str:
    """JSON in which no tag can begin or end."""
    text = json.dumps(facts, allow_nan=False, default=float)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
