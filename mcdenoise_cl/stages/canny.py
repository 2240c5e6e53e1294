"""Canny's edge detector on the device (Yang 2022, section 2.2)."""

from __future__ import annotations

import math

import numpy as np
import pyopencl as cl

from ..engine import Engine, Planes
from .pad import pad


def gaussian_taps(sigma: float, radius: int) -> np.ndarray:
    """2 radius + 1 samples of a Gaussian, of sum 1; sigma 0 is a single one in the middle."""
    x = np.arange(-radius, radius + 1)
    taps = np.exp(-0.5 * (x / sigma) ** 2) if sigma > 0 else (x == 0).astype(float)
    return taps / taps.sum()


def albedo_luminance(engine: Engine, albedo: Planes, out: Planes | None = None) -> Planes:
    """sRGB-encoded Rec. 709 luminance of the albedo, clipped to [0, 1]: one plane, `out` if given."""
    out = out or engine.planes(1, albedo.height, albedo.width)
    kernel = engine.kernel("canny.cl", "albedo_luminance")
    size = (engine.vectors(albedo.width), albedo.height)
    engine.launch("canny", kernel, size, albedo, albedo.height, albedo.width, out)
    return out


def gaussian_blur(engine: Engine, image: Planes, sigma: float) -> Planes:
    """Separable Gaussian of radius ceil(3 sigma) over one plane."""
    if sigma <= 0:
        return image
    radius = math.ceil(3 * sigma)
    taps = engine.constant(gaussian_taps(sigma, radius))
    kernel = engine.kernel("canny.cl", "convolve")
    for dx, dy in ((1, 0), (0, 1)):
        out = engine.planes(1, image.height, image.width)
        size = (engine.vectors(image.width), image.height)
        padded = pad(engine, image, radius)
        engine.launch("canny", kernel, size, padded, image.height, image.width, out, taps, radius, dx, dy)
        image = out
    return image


def canny_thresholds(
    engine: Engine, image: Planes, low: float | None = None, high: float | None = None
) -> cl.MemoryObjectHolder:
    """(low, high) as two floats on the device; what is None is 0.67, or 1.33, times the median (256 bins on [0, 1])."""
    if low is not None and high is not None:
        return engine.constant([low, high])
    bins, out = engine.zeros(256), engine.memory(8)
    rows = (image.height,)
    histogram = engine.kernel("canny.cl", "histogram")
    engine.launch("canny", histogram, rows, image, image.height, image.width, bins, single=True)
    kernel = engine.kernel("canny.cl", "thresholds_from_median")
    given = [-1.0 if value is None else float(value) for value in (low, high)]
    engine.launch("canny", kernel, (1,), bins, image.height * image.width, *given, out, single=True)
    return out


def canny(
    engine: Engine, image: Planes, low: float | None = None, high: float | None = None, sigma: float = 1.4
) -> Planes:
    """Edges of one plane: 1 on an edge, 0 elsewhere.

    Args:
        image: one plane, in [0, 1] for thresholds to mean what they do elsewhere.
        low, high: thresholds on the magnitude of the un-normalised 3x3 Sobel gradient (a step of 1 has magnitude
            4); None: from the median of the image.
        sigma: standard deviation of the Gaussian before, in pixels; 0 leaves it out.
    """
    height, width = image.height, image.width
    size = (width, height)
    thresholds = canny_thresholds(engine, image, low, high)
    smooth = gaussian_blur(engine, image, sigma)
    gradient = engine.planes(2, height, width)
    engine.launch("canny", engine.kernel("canny.cl", "sobel"), size, smooth, height, width, gradient)
    root, strong, flag = (engine.memory(4 * height * width) for _ in range(3))
    suppress = engine.kernel("canny.cl", "suppress")
    engine.launch("canny", suppress, size, gradient, height, width, thresholds, root, strong, flag)
    engine.launch("canny", engine.kernel("canny.cl", "link"), size, height, width, root, flag)
    engine.launch("canny", engine.kernel("canny.cl", "mark"), size, height, width, root, strong, flag)
    out = engine.planes(1, height, width)
    engine.launch("canny", engine.kernel("canny.cl", "edges"), size, height, width, root, flag, out)
    return out
