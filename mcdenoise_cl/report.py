"""Score tables and Markdown reports for people."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import ParameterError
from .metrics import Scores
from .pictures import make_folder, replace_file, write_png


def scores_table(rows: Mapping[str, Scores], times: Mapping[str, float] | None = None) -> str:
    """Scores as a table that reads well as text and is Markdown; the best of two or more in each column is bold.

    Args:
        rows: name -> scores; None among them is shown as "-".
        times: name -> seconds, of some or all rows.

    Raises:
        ParameterError: a time without a row.

    Example:
        >>> print(scores_table({"noisy": Scores(20.0, 0.01, 0.5, 0.4), "NLM": Scores(30.0, 0.001, 0.05, 0.04)}))
        | image |  PSNR, dB |         MSE |     relMSE | relMSE, trimmed | SSIM | FLIP |
        | :---- | --------: | ----------: | ---------: | --------------: | ---: | ---: |
        | noisy |     20.00 |      0.0100 |      0.500 |           0.400 |    - |    - |
        | NLM   | **30.00** | **0.00100** | **0.0500** |      **0.0400** |    - |    - |
    """
    times = times or {}
    for name in times:
        if name not in rows:
            raise ParameterError(f"times has {name!r} but rows has not: name the times after the rows")
    cells = [["image", *(_escaped(name) for name in rows)]]
    for title, attribute, form, best in COLUMNS:
        values = [getattr(score, attribute) for score in rows.values()]
        cells.append([title, *formatted(values, form, best)])
    if times:
        values = [1000 * times[name] if name in times else None for name in rows]
        cells.append(["time, ms", *formatted(values, "{:.1f}", min)])
    widths = [max(4, *(len(text) for text in column)) for column in cells]
    lines = []
    for row in zip(*cells, strict=True):
        texts = [text.rjust(width) for text, width in zip(row, widths, strict=True)]
        lines.append("| " + " | ".join([row[0].ljust(widths[0]), *texts[1:]]) + " |")
    rule = [":" + "-" * (widths[0] - 1), *("-" * (width - 1) + ":" for width in widths[1:])]
    return "\n".join([lines[0], "| " + " | ".join(rule) + " |", *lines[1:]])


def write_report(
    folder: str | Path,
    scores: Mapping[str, Scores],
    *,
    times: Mapping[str, float] | None = None,
    pictures: Mapping[str, Any] | None = None,
    device: str = "",
    title: str = "Denoising report",
    text: str = "",
) -> Path:
    """Write `report.md` with the table and the pictures, and the pictures beside it as PNG; returns its path.

    Args:
        folder: made where it is missing; files of an earlier report with the same names are replaced.
        scores, times: as in `scores_table`.
        pictures: caption -> picture, as `side_by_side` and `feature_sheet` return them.
        device: what the denoiser ran on.
        text: Markdown to stand above the table.

    Raises:
        McdenoiseError: the folder cannot be made, or a file in it cannot be written.
    """
    folder = Path(folder)
    make_folder(folder)
    blocks = [f"# {_escaped(title)}", *([f"Device: {_escaped(device)}"] if device else []), *([text] if text else [])]
    blocks.append(scores_table(scores, times))
    for number, (caption, picture) in enumerate((pictures or {}).items(), start=1):
        # The number keeps captions apart that differ only in what a file name cannot hold.
        file = f"{number:02d}-{re.sub(r'[^a-z0-9]+', '-', caption.lower()).strip('-')[:40] or 'picture'}.png"
        write_png(folder / file, picture)
        blocks += [f"## {_escaped(caption)}", f"![{_escaped(caption)}]({file})"]
    path = folder / "report.md"
    replace_file(path, ("\n\n".join(blocks) + "\n").encode())
    return path


#: Title, attribute of `Scores`, format and what is best, of each column.
COLUMNS = (
    ("PSNR, dB", "psnr", "{:.2f}", max),
    ("MSE", "mse", "{:#.3g}", min),
    ("relMSE", "relmse", "{:#.3g}", min),
    ("relMSE, trimmed", "relmse_trimmed", "{:#.3g}", min),
    ("SSIM", "ssim", "{:.4f}", max),
    ("FLIP", "flip", "{:.4f}", min),
)


def formatted(values: list[float | None], form: str, best: Any) -> list[str]:
    """Texts of one column, the best in bold, or none where `best` is None.

    What reads the same as the best is bold too: a reader cannot tell them apart.

    Example:
        >>> formatted([0.1, None, 0.301, 0.299], "{:.1f}", max)
        ['0.1', '-', '**0.3**', '**0.3**']
    """
    texts = ["-" if value is None else form.format(value).rstrip(".") for value in values]
    known = [value for value in values if value is not None and not math.isnan(value)]
    winner = form.format(best(known)).rstrip(".") if best and len(known) > 1 else None
    return [f"**{text}**" if text == winner else text for text in texts]


def _escaped(text: str) -> str:
    return re.sub(r"([\\`*\[\]<>|])", r"\\\1", " ".join(text.split()))
