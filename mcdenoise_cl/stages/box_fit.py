"""Colours fitted by a linear function of the features over uniform windows (He et al. 2010; He and Sun 2015)."""

from __future__ import annotations

from ..engine import LARGEST, Engine, Planes
from .also import bound_also, each_layer
from .box import box_mean

#: Radius of the box, in pixels, whose mean luminance says what errors are relative to.
LIGHT_RADIUS = 2
#: The largest radius of windows whose rows are joined group by group.
LARGEST_DIRECT = 2
#: Pixels of a plane that a work-item on a CPU reads at a time.
CHUNK = 512


def box_fit(
    engine: Engine,
    color: Planes,
    variance: Planes,
    features: Planes | None,
    noise: Planes | None,
    *,
    block: int,
    radius: int,
    residual_radius: int,
    relative: float,
    ridge: float,
    noise_ridge: float,
    floor: float,
    residual_noise: float,
    first: int = 0,
    also: Planes | None = None,
) -> tuple[Planes, Planes | None]:
    """Fit the colours by linear functions of the features, and give back what of the residual is not noise.

    One function a block is fitted by least squares over the blocks around it, samples weighted by
    1 / (luminance + 0.02)^relative, and averaged over the same window (He et al. 2010, with several guides). Pixels
    take the functions of the blocks around them, interpolated, of their own features (He and Sun 2015). Of the
    residual, color - fit, the share max(0, 1 - residual_noise V / S) is added back, S the weighted sum of its squares
    over a window of blocks and V that of the variance. Windows are mirrored at block level.

    Args:
        color, variance: three planes each, in exposed units; the variance of the pixel mean.
        features: planes of order 1; None for none, which leaves weighted means.
        noise: the variance of each feature; None for exact ones.
        block: side of a block in pixels.
        radius, residual_radius: windows are (2 r + 1)² blocks.
        relative: 0 counts errors as they are, 2 relative to the luminance of the surroundings.
        ridge: added to a feature's variance in the window, relative to it.
        noise_ridge: times the variance of a feature, added as well.
        floor: added as well.
        residual_noise: what noise explains of the residual, in units of the variance; 0 gives `color` back.
        first: row of the frame at which the planes begin, a multiple of `block`: windows are joined in stretches that
            begin with the first row of the frame.
        also: further layers, three planes each, filtered with the weights and shares of `color`.

    Returns:
        Three planes; not below 0 where the pixel is not. And those of `also`.
    """
    height, width = color.height, color.width
    rows, columns = -(-height // block), -(-width // block)
    count = features.channels if features else 0
    guides = [features] if features else []
    noises = [noise] if noise else []
    blocks = (engine.vectors(columns), rows)
    chunk = engine.shape.width
    if engine.shape.schedule == "tile":
        chunk *= max(1, CHUNK // block**2 // chunk)
    chunks = (-(-columns // chunk), rows)
    defines = {"FEATURES": count, "BLOCK": block, "RADIUS": radius, "CHUNK": chunk}
    if noise:
        defines["NOISE"] = None

    def launch(name: str, size: tuple[int, int], *arguments, file: str = "box_fit.cl", **more: int) -> None:
        kernel = engine.kernel(file, f"box_fit_{name}", **defines, **more)
        engine.launch("box fit", kernel, size, *arguments, single=True)

    light = engine.planes(1, height, width)
    launch("luminance", (engine.vectors(width), height), color, height, width, light)
    light = box_mean(engine, light, LIGHT_RADIUS)

    def solved(groups: Planes) -> Planes:
        """The function of each window."""
        window = 2 * radius + 1
        phase = first // block % window
        stretches = -(-(rows + phase) // window)
        fit = engine.planes(3 * (count + 1), rows, columns)
        regularised = float(ridge), float(floor), fit
        file = "box_fit_windows.cl"
        if engine.shape.schedule == "tile" and radius <= LARGEST_DIRECT:
            wide = engine.shape.tile[0]
            size = -(-columns // wide), stretches
            launch("windows", size, groups, rows, columns, phase, *regularised, file=file, COLUMNS=wide)
            return fit
        joined = engine.planes(groups.channels, columns, rows)
        launch("columns", (stretches, engine.vectors(columns)), groups, rows, columns, phase, joined, file=file)
        size = -(-columns // window), engine.vectors(rows)
        launch("solve", size, joined, columns, rows, *regularised, file=file)
        return fit

    def fitted(target: Planes) -> tuple[Planes, Planes]:
        """What the features explain of three planes, and the squares of what they do not."""
        group = 1 + (count + 3) + count * (count + 1) // 2 + 3 * count
        groups = engine.planes(group, rows, columns)
        numbers = height, width, float(relative), float(noise_ridge)
        launch("blocks", chunks, light, target, *guides, *noises, *numbers, groups)
        fit = box_mean(engine, solved(groups), radius)
        out, left = engine.planes(3, height, width), engine.planes(2, rows, columns)
        launch("apply", chunks, fit, light, target, variance, *guides, height, width, float(relative), out, left)
        return out, left

    def restored(target: Planes, fit: Planes, out: Planes) -> None:
        launch("restore", blocks, share, target, fit, height, width, 0.0 if also is None else -LARGEST, out)

    fit, residual = fitted(color)
    residual = box_mean(engine, residual, residual_radius)
    share, out = engine.planes(1, rows, columns), engine.planes(3, height, width)
    launch("share", blocks, residual, rows, columns, float(residual_noise), share)
    restored(color, fit, out)
    if also is None:
        return out, None
    layers = engine.planes(also.channels, height, width)
    for layer, filtered in zip(each_layer(also), each_layer(layers), strict=True):
        restored(layer, fitted(layer)[0], filtered)
    bound_also(engine, out, color, layers, also)
    return out, layers
