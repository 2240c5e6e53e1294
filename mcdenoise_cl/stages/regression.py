"""First-order regression on the features, weighted by NLM (Bitterli et al. 2016)."""

from __future__ import annotations

from ..engine import Engine, Planes


def first_order_regression(
    engine: Engine,
    tone: Planes,
    variance: Planes,
    features: tuple[Planes, Planes] | None,
    color: Planes,
    *,
    search_radius: int,
    patch_radius: int,
    bandwidth: float,
    ridge: float,
    noise_ridge: float,
    position_ridge: float,
) -> Planes:
    """Fit the colours around each pixel by a linear function of features and position; its value at the pixel.

    Args:
        tone, variance: three planes each, in which patches are compared, border of search_radius + patch_radius.
        features: planes of features (border of search_radius) and of their variances (no border); None for none.
        color: three planes to fit, border of search_radius.
        bandwidth: weights are exp(-d / bandwidth²), d the patch distance in units of its noise; mean of the weights
            for patch_radius and patch_radius // 2.
        ridge: added to a term's own second moment, relative to it.
        noise_ridge: times a feature's variance, added relative to the sum of weights.
        position_ridge: added to the two position terms, relative to the sum of weights (positions span [-1, 1]).
    """
    count = features[0].channels if features else 0
    defines = engine.tile_defines(patch_radius, deep=True) | {"SEARCH_RADIUS": search_radius, "FEATURES": count}
    kernel = engine.kernel("regression.cl", "regress", **defines)
    height, width = color.height, color.width
    out = engine.planes(3, height, width)
    numbers = [float(value) for value in (bandwidth, ridge, noise_ridge, position_ridge)]
    size = engine.tiles(height, width, deep=True)
    arguments = (tone, variance, *(features or ()), color, height, width, *numbers, out)
    engine.launch("regression", kernel, size, *arguments, single=True)
    return out
