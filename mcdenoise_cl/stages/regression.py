"""First-order regression on the features, weighted by NLM (Bitterli et al. 2016)."""

from __future__ import annotations

from ..engine import Engine, Planes
from .pad import pad
from .terms import BLOCK_COLUMNS, BLOCK_ROWS, Terms, stack_terms


def first_order_regression(
    engine: Engine,
    tone: Planes,
    variance: Planes,
    terms: Terms | None,
    color: Planes,
    *,
    search_radius: int,
    patch_radius: int,
    bandwidth: float,
    ridge: float,
    noise_ridge: float,
    position_ridge: float,
    stride: int = 1,
    with_inner: bool = False,
) -> tuple[Planes, ...]:
    """Fit the colours around each pixel by a linear function of features and position; its value at the pixel.

    Args:
        tone: three planes, in which patches are compared. No plane here has a border.
        variance: one plane, the sum of the variances of `tone`.
        terms: features, chosen for a reach of search_radius * stride; None for none.
        color: three planes to fit, or four: the fourth may be negative.
        search_radius, stride: the window is every `stride`-th pixel, search_radius of them to each side.
        bandwidth: weights fall to 0 at patch distances of 4 bandwidth², in units of the noise; mean of the weights for
            patch_radius and patch_radius // 2.
        ridge: added to a term's own second moment, relative to it.
        noise_ridge: times a feature's variance, added relative to the sum of weights.
        position_ridge: added to the two position terms, relative to the sum of weights (positions span [-1, 1]).
        with_inner: fit the middle of the window alone as well, search_radius // 2 to each side.

    Returns:
        The fit of the whole window and, if asked for, that of its middle; as many planes as `color`.
    """
    height, width = color.height, color.width
    reach = search_radius * stride
    border = reach + patch_radius
    defines = engine.tile_defines(patch_radius, deep=True)
    defines |= {"SEARCH_RADIUS": search_radius, "STRIDE": stride, "COLORS": color.channels}
    defines |= {"FEATURES": terms.features.channels if terms else 0}
    if with_inner:
        defines["WITH_INNER"] = None
    stack = stack_terms(engine, terms.features if terms else None, color, reach)
    arguments: list = [pad(engine, tone, border), pad(engine, variance, border), stack]
    if terms:
        defines |= {"BLOCK_COLUMNS": BLOCK_COLUMNS, "BLOCK_ROWS": BLOCK_ROWS}
        arguments += [terms.noise, terms.blocks, terms.across]
    arguments += [height, width, *(float(value) for value in (bandwidth, ridge, noise_ridge, position_ridge))]
    fits = [engine.planes(color.channels, height, width) for _ in range(1 + with_inner)]
    kernel = engine.kernel("regression.cl", "regress", **defines)
    engine.launch("regression", kernel, engine.tiles(height, width, deep=True), *arguments, *fits, single=True)
    return tuple(reversed(fits))
