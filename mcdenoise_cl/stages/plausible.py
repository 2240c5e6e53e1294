"""A filtered frame held to what the noise of its input can explain."""

from __future__ import annotations

from ..engine import Engine, Planes
from .pad import pad

#: Noise is looked for in a block of so many pixels squared and in its eight neighbours.
BLOCK = 8


def keep_plausible(
    engine: Engine, filtered: Planes, frame: Planes, variance: Planes, share: Planes, *, likely: float
) -> None:
    """Give the input back where the filtered frame is further from it than noise explains, in place.

    Args:
        filtered, frame: the filtered frame and its input, three colours and a half difference each.
        variance: of the input's pixels, three planes, not smoothed.
        share: the input's share in `filtered`, one plane; raised where the input comes back.
        likely: squared distances, in variances of the noisiest pixel around, that 5x5 pixels may have on average (noise
            alone, wholly removed, makes them 1, or 2 where the channels have noise of their own); one pixel may have
            five times as much. From 1.5 times that on the input stays.
    """
    height, width = frame.height, frame.width
    down, across = -(-height // BLOCK), -(-width // BLOCK)
    noise, around = engine.planes(3, down, across), engine.planes(3, down, across)
    moved = engine.planes(1, height, width)
    size = engine.vectors(width), height

    def launch(name: str, size: tuple[int, ...], *arguments) -> None:
        engine.launch("plausible", engine.kernel("plausible.cl", name, BLOCK=BLOCK), size, *arguments)

    launch("most_noise", (across, down), frame, variance, height, width, noise)
    launch("most_around", (across, down, 3), noise, down, across, around)
    launch("distances", size, filtered, frame, around, height, width, moved)
    launch("keep_plausible", size, filtered, frame, pad(engine, moved, 2), height, width, float(likely), share)
