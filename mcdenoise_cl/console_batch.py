"""What `mcdenoise denoise` says: progress, a summary, plans, and lines of JSON for machines."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from . import __version__
from .console import Progress, say, sentence, show_traceback

if TYPE_CHECKING:  # batch takes its time to import
    from .job import Job, Outcome, Recipe
    from .stamp import Verdict


class Teller:
    """Follows a batch: a bar on stderr, and with `as_json` a line on stdout for each thing that happens.

    The events are "start", "file" for each frame when it is finished, and "end", also after an interruption.
    """

    def __init__(self, label: str, jobs: Sequence[Job], recipe: Recipe, as_json: bool) -> None:
        self._label, self._total, self._as_json = label, len(jobs), as_json
        self._progress, self._started = Progress(), time.perf_counter()
        self._stdout = sys.stdout  # libraries that write there are hushed later
        self.outcomes: list[Outcome] = []
        self._skipped = 0
        facts = {"method": recipe.method, "parameters": dict(recipe.parameters), "version": __version__}
        self._event("start", files=len(jobs), **facts)

    def __enter__(self) -> Teller:
        self._progress.__enter__()
        return self

    def __exit__(self, kind: type | None, *error: object) -> None:
        self._progress.__exit__()
        counts = {name: sum(o.status == name for o in self.outcomes) for name in ("done", "skipped", "failed")}
        rest = {"left": self._total - len(self.outcomes), "interrupted": kind is not None}
        self._event("end", **counts, **rest, seconds=round(time.perf_counter() - self._started, 3))

    def show(self, outcome: Outcome) -> None:
        """One more is finished."""
        self.outcomes.append(outcome)
        self._skipped += outcome.status == "skipped"
        # What is skipped takes no time, and would make the rate and the time left look better than they are.
        self._progress.show(self._label, len(self.outcomes) - self._skipped, self._total - self._skipped)
        self._event("file", **_facts(outcome))

    def note(self, text: str) -> None:
        """Something to know while it runs."""
        say(f"\r\033[K{text}" if sys.stderr.isatty() else text)  # over the bar, which is drawn again
        self._event("note", text=text)

    def _event(self, name: str, **facts: Any) -> None:
        if self._as_json:
            click.echo(json.dumps({"event": name, **facts}), file=self._stdout)


def _facts(outcome: Outcome) -> dict[str, Any]:
    """An outcome for machines."""
    facts: dict[str, Any] = {
        "status": outcome.status,
        "source": str(outcome.source),
        "target": str(outcome.target),
        "reason": outcome.reason if outcome.error is None else sentence(outcome.error),
        "seconds": {name: round(value, 4) for name, value in outcome.seconds.items()},
    }
    if outcome.report is not None:
        report = outcome.report
        facts |= {"method": report.method, "device": report.device, "layers": dict(outcome.layers)}
        facts |= {"replaced": report.replaced, "estimated_error": report.estimated_error, "notes": outcome.notes}
    return facts


def tell_plan(plan: Sequence[tuple[Job, Verdict | Exception]], as_json: bool) -> bool:
    """What would be done and why; False if something would fail."""
    words = {"denoise": 0, "skip": 0, "fail": 0}
    for job, verdict in plan:
        failed = isinstance(verdict, Exception)
        action = "fail" if failed else "denoise" if verdict.needed else "skip"
        reason = sentence(verdict) if failed else verdict.reason
        words[action] += 1
        if as_json:
            names = [str(path) for path in job.inputs]
            facts = {"action": action, "inputs": names, "target": str(job.target), "reason": reason}
            click.echo(json.dumps({"event": "plan", **facts}))
        else:
            source = " + ".join(str(path) for path in job.halves or (job.source,))
            click.echo(f"{action:7}  {source} -> {job.target}: {reason}")
    say(f"nothing was done: {words['denoise']} to denoise, {words['skip']} to skip, {words['fail']} would fail")
    return words["fail"] == 0


def note_pairs(count: int) -> None:
    """Where names look like halves that are denoised one by one."""
    if count:
        say(
            f"note: {count} pair{'s' * (count != 1)} of name.a.exr and name.b.exr: if these are renderings of one "
            "frame with different seeds, --pairs denoises them as one, and better"
        )


def tell_outcome(outcome: Outcome, automatic: bool) -> None:
    """One file: how it was denoised, and what its user may not expect. `automatic`: no method was asked for."""
    report = outcome.report
    if report is None:
        say(f"{outcome.target}: {outcome.reason}, so nothing was done (--force does it again)")
        return
    layers = ", ".join(f"{plane}={layer}" for plane, layer in outcome.layers.items())
    time_taken = f" in {sum(report.stage_ms.values()):.0f} ms" if report.stage_ms else ""
    say(f"{outcome.target}: {report.method} from {layers}{time_taken} on {report.device}")
    if automatic and outcome.layers.keys() <= {"color", "also", "motion"}:
        say("note: nothing but the colour was found, albedo and normal would help; --layer names them if they exist")
    for plane, count in report.replaced.items():
        pixels = "pixel" if count == 1 else "pixels"
        say(f"note: replaced {count} {pixels} of {plane}, not being finite")
    for note in outcome.notes:
        say(f"note: {note}")


def tell_outcomes(outcomes: Sequence[Outcome], debug: bool) -> bool:
    """A summary of many files, why some stayed as they were, and why some failed; False if any did."""
    failed = [outcome for outcome in outcomes if outcome.status == "failed"]
    done = [outcome for outcome in outcomes if outcome.status == "done"]
    skipped = [outcome for outcome in outcomes if outcome.status == "skipped"]
    from .stamp import UP_TO_DATE

    current = [outcome for outcome in skipped if outcome.reason == UP_TO_DATE]
    parts = [f"{len(done)} of {len(outcomes)} file{'s' * (len(outcomes) != 1)} denoised"]
    if done:
        used = " and ".join(sorted({outcome.report.method for outcome in done}))
        parts[0] += f" with {used} on {' and '.join(sorted({outcome.report.device for outcome in done}))}"
    if current:
        parts.append(f"{len(current)} skipped, being up to date (--force does them again)")
    if len(skipped) > len(current):
        parts.append(f"{len(skipped) - len(current)} skipped, as something else is there")
    if failed:
        parts.append(f"{len(failed)} failed")
    say("; ".join(parts))
    repaired = sum(bool(outcome.report.replaced) for outcome in done)
    if repaired:
        say(f"note: pixels that were not finite were replaced in {repaired} of them")
    for outcome in done:
        for note in outcome.notes:
            say(f"note: {outcome.source}: {note}")
    for outcome in skipped:
        if outcome not in current:
            say(f"note: {outcome.target} was skipped: {outcome.reason}")
    for outcome in failed:
        if debug:
            show_traceback(outcome.error)
        text = sentence(outcome.error)
        say(f"mcdenoise: {text if str(outcome.source) in text else f'{outcome.source}: {text}'}")
    return not failed
