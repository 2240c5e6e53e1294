"""A filtered frame drawn back to its input where the input's noise cannot explain what the filter changed."""

from __future__ import annotations

from ..engine import Engine, Planes
from .also import each_layer

#: Pixels of a block, squared, over which means are taken.
BLOCK = 8


def shrink_to_input(
    engine: Engine,
    filtered: Planes,
    frame: Planes,
    variance: Planes,
    share: Planes,
    also: Planes | None = None,
    also_input: Planes | None = None,
    *,
    disturbed: tuple[Planes, Planes] | None = None,
) -> None:
    """Mix the input in, channel by channel, as far as the filtered frame lies further from it than noise explains.

    The mix has the least error (James and Stein 1961, "Estimation with Quadratic Loss"). In place; where blocks of 8x8
    pixels lie as near to their input as they should, nothing changes, to the last bit.

    Args:
        filtered, frame: the filtered frame and its input, three colours and a half difference each, exposed.
        variance: of the input's pixels, three planes, not smoothed.
        share: the input's share in `filtered`, one plane; raised where the input comes back.
        also, also_input: further layers and their input, drawn back as far as the three colours are.
        disturbed: the input with a little noise added and what the filter makes of that, three planes each, which tell
            how much of its noise the filtered frame has; without them the half differences do.
    """
    height, width = frame.height, frame.width
    down, across = -(-height // BLOCK), -(-width // BLOCK)
    means, shares = engine.planes(12 if disturbed else 8, down, across), engine.planes(3, down, across)

    def launch(name: str, size: tuple[int, ...], *arguments, **defines: None) -> None:
        engine.launch("shrink", engine.kernel("shrink.cl", name, **defines), size, *arguments)

    tried, defines = (disturbed, {"DISTURBED": None}) if disturbed else ((), {})
    launch("block_means", (across, down), filtered, frame, variance, *tried, height, width, means, **defines)
    launch("block_shares", (across, down, 3), means, down, across, shares, **defines)
    size = engine.vectors(width), height
    launch("shrink", size, filtered, frame, shares, height, width, share, WITH_SHARE=None)
    for layer, before in zip(each_layer(also), each_layer(also_input), strict=True):
        launch("shrink", size, layer, before, shares, height, width)
