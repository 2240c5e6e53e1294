"""Half the difference of two independent halves of a frame, as it is or made up from the variance."""

from __future__ import annotations

from ..engine import Engine, Planes


def difference_of_halves(engine: Engine, a: Planes, b: Planes, factor: Planes) -> Planes:
    """factor * luminance of (a - b) / 2, one plane; a and b have three planes, factor one."""
    return _run(engine, "difference_of_halves", a, b, factor)


def difference_from_variance(engine: Engine, variance: Planes, first: int = 0) -> Planes:
    """A normal random number a pixel, of the variance that its luminance has; the same in every run.

    `first` is the row of the frame at which the planes begin.

    With n of the variance of c, c + n and c - n are uncorrelated: two halves where a renderer wrote none (Oliveira,
    Lei, Tibshirani 2021, "Unbiased Risk Estimation in the Normal Means Problem via Coupled Bootstrap Techniques").
    """
    return _run(engine, "difference_from_variance", variance, after=(first,))


def _run(engine: Engine, name: str, *inputs: Planes, after: tuple = ()) -> Planes:
    height, width = inputs[0].height, inputs[0].width
    out = engine.planes(1, height, width)
    engine.launch("halves", engine.kernel("halves.cl", name), (width, height), *inputs, height, width, *after, out)
    return out
