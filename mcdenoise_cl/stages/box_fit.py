"""Colours fitted by a linear function of the features over uniform windows (He et al. 2010; He and Sun 2015)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from ..engine import LARGEST, Engine, Planes
from .also import bound_also, each_layer
from .box import box_mean

#: Radius of the box, in pixels, whose mean luminance says what errors are relative to.
LIGHT_RADIUS = 2
#: The largest radius of windows whose rows are joined group by group.
LARGEST_DIRECT = 2
#: Pixels of a plane that a work-item on a CPU reads at a time: long pieces of rows are what processors foresee.
CHUNK = 2560
#: Tiles beside each other that a work-item joins windows of: each tile less has a vector more at either end.
TILES = 2
#: Rows of blocks that a work-item gives functions to: it averages those of two rows more.
ROWS = 8


def box_fit(
    engine: Engine,
    color: Planes,
    variance: Planes,
    features: Sequence[Planes],
    noise: Sequence[Planes],
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
        features: up to three sets of planes of order 1; none leave weighted means.
        noise: the variances of each set; none for exact ones.
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
    blocks = engine.vectors(columns), rows
    count = sum(feature.channels for feature in features)
    wide = engine.shape.width
    in_tiles = engine.shape.schedule == "tile"
    bundled = in_tiles and radius <= LARGEST_DIRECT
    chunk = max(CHUNK // block**2 // wide, 1) * wide if in_tiles else 1
    joint, deep = (TILES * engine.shape.tile[0], ROWS) if bundled else (chunk, 1)
    sizes = itertools.zip_longest(("FIRST", "SECOND", "THIRD"), (each.channels for each in features), fillvalue=0)
    defines = {"FEATURES": count, **dict(sizes), "BLOCK": block, "RADIUS": radius}
    defines |= {"NOISE": None} if noise else {}
    defines |= {"BUNDLED": None} if bundled else {}

    def launch(name: str, size: tuple[int, int], *arguments, file: str = "box_fit.cl", **more: int) -> None:
        kernel = engine.kernel(file, f"box_fit_{name}", **{"CHUNK": chunk, **defines, **more})
        engine.launch("box fit", kernel, size, *arguments, single=name not in ("luminance", "share"))

    light = engine.planes(1, height, width)
    launch("luminance", (engine.vectors(width), height), color, height, width, light)
    light = box_mean(engine, light, LIGHT_RADIUS)

    def of_blocks(channels: int) -> Planes:
        """Planes of blocks, or bundles of them (kernels/bundles.h)."""
        if not bundled:
            return engine.planes(channels, rows, columns)
        row = engine.vectors(columns) * wide * channels
        return Planes(engine.memory(4 * rows * row), channels, rows, columns, border=0, row=row, plane=wide)

    def solved(groups: Planes) -> Planes:
        """The function of each window; if they are no bundles, averaged over the windows around."""
        window = 2 * radius + 1
        phase = first // block % window
        stretches = -(-(rows + phase) // window)
        fit = of_blocks(3 * (count + 1))
        regularised = float(ridge), float(floor), fit
        file = "box_fit_windows.cl"
        if bundled:
            size = -(-columns // joint), stretches
            launch("windows", size, groups, rows, columns, phase, *regularised, file=file, CHUNK=joint)
            return fit
        joined = engine.planes(groups.channels, columns, rows)
        launch("columns", (stretches, engine.vectors(columns)), groups, rows, columns, phase, joined, file=file)
        size = -(-columns // window), engine.vectors(rows)
        launch("solve", size, joined, columns, rows, *regularised, file=file)
        return box_mean(engine, fit, radius)

    def fitted(target: Planes) -> tuple[Planes, Planes]:
        """What the features explain of three planes, and the squares of what they do not."""
        groups = of_blocks(1 + (count + 3) + count * (count + 1) // 2 + 3 * count)
        size, numbers = (-(-columns // chunk), rows), (height, width, float(relative), float(noise_ridge))
        launch("blocks", size, light, target, *features, *noise, *numbers, groups)
        fit = solved(groups)
        out, left = engine.planes(3, height, width), engine.planes(2, rows, columns)
        size = -(-columns // joint), -(-rows // deep)
        arguments = fit, light, target, variance, *features, height, width, float(relative), out, left
        launch("apply", size, *arguments, file="box_fit_apply.cl", CHUNK=joint, ROWS=deep)
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
