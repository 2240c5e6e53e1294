"""The parts of a page that are text: scores, times, parameters and what the page is about."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from .. import __version__
from ..details import Report
from ..report import COLUMNS, formatted
from .budget import Packed
from .chart import chart
from .content import INPUT, REFERENCE, Content

#: Which way a score wants to go.
DIRECTION = {max: "higher is better", min: "lower is better"}


def scores_section(content: Content) -> str:
    """A table of what is known of each image, or "" where nothing is."""
    names = [INPUT, *content.entries] if content.scores else list(content.entries)
    columns = []
    for title, attribute, form, best in COLUMNS if content.scores else ():
        values = [getattr(content.scores.get(name), attribute, None) for name in names]
        if any(value is not None for value in values):
            columns.append((title, DIRECTION[best], formatted(values, form, best)))
    seconds = [content.entries[name].seconds if name in content.entries else None for name in names]
    if any(value is not None for value in seconds):
        milliseconds = [None if value is None else 1e3 * value for value in seconds]
        columns.append(("time, ms", DIRECTION[min], formatted(milliseconds, "{:.1f}", min)))
    reports = [content.entries[name].report if name in content.entries else None for name in names]
    guesses = [None if report is None else report.estimated_error for report in reports]
    if any(value is not None for value in guesses):
        columns.append(("estimated relMSE", "what the method expects", formatted(guesses, "{:#.3g}", None)))
    if not columns:
        return ""
    head = "".join(f'<th scope="col">{escape(title)}<small>{escape(hint)}</small></th>' for title, hint, _ in columns)
    rows = []
    for number, name in enumerate(names):
        cells = "".join(f"<td>{_cell(texts[number])}</td>" for _, _, texts in columns)
        rows.append(f'<tr><th scope="row">{escape(name)}</th>{cells}</tr>')
    table = f'<table class="scores"><thead><tr><th scope="col">image</th>{head}</tr></thead>'
    table += f"<tbody>{''.join(rows)}</tbody></table>"
    notes = [f"<p>{escape(f'{name} has no scores: {why}')}</p>" for name, why in content.unscored.items()]
    return (
        f"<section><h2>{'Scores' if content.scores else 'Times'}</h2>"
        f"{_wide('Scores', table)}"
        f"<p>Bold: the best, or as good as it.</p>{''.join(notes)}</section>"
    )


def chart_section(content: Content) -> str:
    """Time against error, or "" where one of them is unknown."""
    times = {name: entry.seconds for name, entry in content.entries.items() if entry.seconds is not None}
    errors = {name: score.relmse for name, score in content.scores.items()}
    picture = chart(times, errors, errors.get(INPUT))
    return (
        f"<section><h2>Time against error</h2>{_wide('Chart', picture)}<p>Down and to the left is better.</p></section>"
        * bool(picture)
    )


def method_sections(content: Content) -> str:
    """What is known of each method: stages, parameters, what it found."""
    parts = []
    for name, entry in content.entries.items():
        if entry.report is not None:
            report = entry.report
            head = f"<summary>{escape(name)}</summary>" if name == report.method else ""
            head = head or f"<summary>{escape(name)} <small>{escape(report.method)}</small></summary>"
            parts.append(
                f"<details>{head}{_stages(report)}{_pairs(_found(report))}{_pairs(report.parameters)}</details>"
            )
    return f"<section><h2>Methods</h2>{''.join(parts)}</section>" if parts else ""


def about_table(content: Content, stored: Packed, about: Mapping[str, str]) -> str:
    """Where the page comes from and how exact it is."""
    held = f"light is stored to within {_percent(stored.worst)}, {_percent(stored.mean)} on average"
    held += f", of itself from 1/128 of display white up ({1 / content.exposure:.3g} in the file's units is white)"
    if not stored.fits:
        held += "; more than the size that was asked for, as no coarser one is offered"
    facts = dict(about) | {"exactness": held, "made with": f"mcdenoise_cl {__version__}"}
    if REFERENCE in (plane.name for plane in content.planes):
        facts["error maps"] = "squared error over the squared reference + 0.01, of what this page holds"
    return _pairs(facts)


def _stages(report: Report) -> str:
    if not report.stage_ms:
        return ""
    total, most = sum(report.stage_ms.values()), max(report.stage_ms.values()) or 1.0
    rows = "".join(
        f'<tr><th scope="row">{escape(stage)}</th><td>{ms:.2f}</td>'
        f'<td class="bar"><span style="width:{100 * ms / most:.1f}%"></span></td></tr>'
        for stage, ms in report.stage_ms.items()
    )
    return (
        f'<table class="stages"><caption>Stages on the device, ms; {total:.1f} in all</caption>'
        f"<tbody>{rows}</tbody></table>"
    )


def _found(report: Report) -> dict[str, str]:
    facts = {"device": report.device, "noise level": f"{report.noise_level:.3g}"}
    facts["light taken from outliers"] = _percent(report.energy_removed)
    for title, parts in (("features used", report.features_used), ("shares", report.shares)):
        if parts:
            facts[title] = ", ".join(f"{name} {100 * part:.0f} %" for name, part in parts.items())
    if report.replaced:
        facts["pixels replaced"] = ", ".join(f"{plane} {count}" for plane, count in report.replaced.items())
    return facts


def _wide(name: str, inside: str) -> str:
    """What scrolls by itself where the window is too narrow, by keys too."""
    return f'<div class="wide" tabindex="0" role="region" aria-label="{name}">{inside}</div>'


def _pairs(facts: Mapping[str, Any]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(str(k))}</dt><dd>{escape(str(v))}</dd>" for k, v in facts.items()) + "</dl>"


def _cell(text: str) -> str:
    return f"<b>{escape(text.strip('*'))}</b>" if text.startswith("**") else escape(text)


def _percent(part: float) -> str:
    return f"{100 * part:.2g} %"
