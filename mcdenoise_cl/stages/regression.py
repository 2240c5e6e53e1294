"""First-order regression on the features, weighted by NLM (Bitterli et al. 2016)."""

from __future__ import annotations

from ..engine import LARGEST, Engine, Planes
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
    bounded: bool = True,
    out: tuple[Planes, ...] | None = None,
) -> tuple[Planes, ...]:
    """Fit the colours around each pixel by a linear function of features and position; its value at the pixel.

    Args:
        tone: three planes, in which patches are compared. No plane here has a border.
        variance: one plane, the sum of the variances of `tone`.
        terms: features, chosen for a reach of search_radius * stride or more; None for none.
        color: three planes to fit, or four: the fourth may be negative.
        search_radius, stride: the window is a disc of every `stride`-th pixel, search_radius of them to each side.
        bandwidth: weights fall to 0 at patch distances of 4 bandwidth², in units of the noise; mean of the weights for
            patch_radius and patch_radius // 2.
        ridge: added to the second moment of a feature, or of a position, relative to it.
        noise_ridge: times a feature's variance, added relative to the sum of weights.
        position_ridge: added to the two position terms, relative to the sum of weights (positions span [-1, 1]).
        with_inner: fit the middle of the window alone as well, a disc of search_radius // 2 to each side.
        bounded: a fit that overshoots below 0 becomes 0, or the pixel where that is below 0.
        out: planes to write to, as they are returned; None for new ones.

    Returns:
        The fit of the whole window and, if asked for, that of its middle; as many planes as `color`.
    """
    height, width = color.height, color.width
    reach = search_radius * stride
    border = reach + patch_radius
    in_groups = engine.shape.schedule == "group"
    defines = {"PATCH_RADIUS": patch_radius}
    defines |= engine.group_defines() if in_groups else engine.tile_defines(patch_radius, deep=True)
    defines |= {"SEARCH_RADIUS": search_radius, "STRIDE": stride, "COLORS": color.channels}
    defines |= {"FEATURES": terms.features.channels if terms else 0}
    if with_inner:
        defines["WITH_INNER"] = None
    stack = stack_terms(engine, terms.features if terms else None, color, reach)
    arguments: list = [pad(engine, tone, border), pad(engine, variance, border), stack]
    if terms:
        defines |= {"BLOCK_COLUMNS": BLOCK_COLUMNS, "BLOCK_ROWS": BLOCK_ROWS}
        arguments += [terms.noise, terms.blocks, terms.across]
    darkest = 0.0 if bounded else -LARGEST
    arguments += [height, width, *(float(value) for value in (bandwidth, ridge, noise_ridge, position_ridge, darkest))]
    fits = [engine.planes(color.channels, height, width) for _ in range(1 + with_inner)] if out is None else out[::-1]
    if in_groups:
        offsets, inner = offsets_of_window(search_radius, stride, with_inner)
        kernel = engine.kernel("regression_group.cl", "regress", **defines, OFFSETS=len(offsets), INNER_OFFSETS=inner)
        arguments.insert(0, engine.constant(offsets))
        engine.launch("regression", kernel, (width, height), *arguments, *fits, local=engine.shape.group)
    else:
        kernel = engine.kernel("regression.cl", "regress", **defines)
        engine.launch("regression", kernel, engine.tiles(height, width, deep=True), *arguments, *fits, single=True)
    return tuple(reversed(fits))


def offsets_of_window(radius: int, stride: int, with_inner: bool) -> tuple[list[tuple[int, int]], int]:
    """The pixels (x, y) of a window, row by row, those of the inner one first, and how many the inner one has.

    Both are discs: IN_DISC in first_order.h.
    """

    def disc(r: int) -> list[tuple[int, int]]:
        span = range(-r, r + 1)
        return [(stride * x, stride * y) for y in span for x in span if x * x + y * y <= r * (r + 1)]

    inner = disc(radius // 2) if with_inner else []
    return inner + [offset for offset in disc(radius) if offset not in inner], len(inner)
