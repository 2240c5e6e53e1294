"""What the command line says: progress bars, summaries, lists of devices and methods, and errors in one sentence.

What was asked for goes to stdout, everything said about it to stderr.
"""

from __future__ import annotations

import json
import math
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import click

from .device import DeviceInfo
from .errors import McdenoiseError
from .methods import Method
from .methods.parameters import ParameterInfo

if TYPE_CHECKING:  # metrics and tune take their time to import, and are not always needed
    from .device import Shape
    from .metrics import Scores
    from .tune import Trial

say = partial(click.echo, err=True)


def sentence(error: BaseException) -> str:
    """An error for people: ours as it is, anybody else's by its type and first line."""
    if isinstance(error, McdenoiseError):
        return str(error)
    first = next(iter(str(error).splitlines()), "")
    return f"unexpected {type(error).__name__}{first and f' ({first})'}: run again with --debug to see where"


def show_traceback(error: BaseException) -> None:
    say("".join(traceback.format_exception(error)), nl=False)


class Progress:
    """Bars on stderr, one a stage, with rate and time left; where stderr is no terminal, the name of each stage."""

    def __init__(self) -> None:
        self._stage, self._bar, self._start = "", None, time.time()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar is not None:
            self._bar.__exit__(None, None, None)
            self._bar = None

    def show(self, stage: str, done: int, total: int) -> None:
        """Move the bar of this stage, or begin with it."""
        if stage != self._stage:
            if self._bar is not None:
                self.__exit__()
                self._start = time.time()
            self._stage = stage
            self._bar = click.progressbar(
                length=total, label=stage, file=sys.stderr, show_pos=True, item_show_func=self._rate, width=24
            )
            self._bar.start = self._start  # the first call may come when much is done already
            self._bar.__enter__()
        self._bar.length = total  # fewer where some turn out to need nothing
        self._bar.update(done - self._bar.pos)

    def _rate(self, _: Any) -> str | None:
        done = 0 if self._bar is None else self._bar.pos
        return f"{done / (time.time() - self._start):.1f}/s" if done else None


def print_devices(devices: Sequence[DeviceInfo], default: DeviceInfo | None, as_json: bool) -> None:
    """The list of devices."""
    if as_json:
        names = ("index", "name", "runtime", "version", "driver", "kind", "compute_units", "memory")
        facts = [{name: getattr(device, name) for name in names} | {"default": device == default} for device in devices]
        click.echo(json.dumps(facts, indent=2))
        return
    for device in devices:
        click.echo(
            f"{'*' if device == default else ' '} {device.index}  {device.name}\n"
            f"     {device.kind}, {device.compute_units} compute units, {device.memory / 2**30:.1f} GiB; "
            f"{device.runtime}, {device.version}, driver {device.driver}"
        )


def print_trials(trials: Sequence[Trial], used: Shape) -> None:
    """How long each shape took; the one that is used is marked with *."""
    for trial in trials:
        shape, mark = trial.shape, "*" if trial.shape == used else " "
        cut = (
            f"work-groups of {'x'.join(map(str, shape.group))}"
            if shape.schedule == "group"
            else f"tiles of {'x'.join(map(str, shape.tile))} and {'x'.join(map(str, shape.deep))}"
        )
        click.echo(f"{mark} {1e3 * trial.seconds:7.1f} ms  {cut}")


def print_methods(methods: Sequence[Method], as_json: bool) -> None:
    """The list of methods with their parameters."""
    if as_json:
        facts = [
            {name: getattr(method, name) for name in ("name", "summary", "needs", "uses")}
            | {"parameters": [asdict(info) | {"type": info.type.__name__} for info in method.parameters]}
            for method in methods
        ]
        click.echo(json.dumps(facts, indent=2))
        return
    for number, method in enumerate(methods):
        click.echo(("\n" if number else "") + f"{method.name}: {method.summary}")
        click.echo(f"  needs {', '.join(('color', *method.needs))}")
        if method.uses:
            click.echo(f"  uses where present {', '.join(method.uses)}")
        rows = [(f"{info.name}={_word(info.default)}", _range(info), info.meaning) for info in method.parameters]
        widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
        for setting, allowed, meaning in rows:
            click.echo(f"  {setting:{widths[0]}}  {allowed:{widths[1]}}  {meaning}")


def print_scores(scores: Mapping[str, Scores]) -> None:
    """Scores as JSON, which knows no infinity: null stands for it, as for a metric that is not available."""
    rows = []
    for image, score in scores.items():
        numbers = asdict(score).items()
        rows.append({"image": image} | {k: v if v is not None and math.isfinite(v) else None for k, v in numbers})
    click.echo(json.dumps(rows, indent=2))


def note_missing_metrics() -> None:
    """Say which optional packages of the scores are missing."""
    for module, package, metric in (("skimage", "scikit-image", "SSIM"), ("flip_evaluator", "flip-evaluator", "FLIP")):
        if find_spec(module) is None:
            say(f"note: {metric} needs {package}: pip install 'mcdenoise-cl[demo]'")


def _word(value: Any) -> str:
    """A value as `--set` takes it."""
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def _range(info: ParameterInfo) -> str:
    if info.type is bool:
        return "true, false"
    if info.choices:
        return ", ".join(info.choices)
    low, high = (None if bound is None else f"{bound:g}" for bound in (info.low, info.high))
    return f"{low} to {high}" if high is not None else f"at least {low}" if low is not None else "any number"
