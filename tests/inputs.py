"""Small deterministic inputs shared by the tests: planes of several kinds and sizes, and a synthetic scene."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

KINDS = ("uniform", "hdr", "constant", "step", "textured")

#: (height, width): one pixel, one row, one column, smaller than any window, and odd sizes that fill no tile.
SIZES = ((1, 1), (1, 9), (7, 1), (3, 2), (13, 17), (31, 64), (37, 101))


def planes(kind: str, height: int, width: int, channels: int | None = None, seed: int = 0) -> np.ndarray:
    """A float32 test image, (H, W, channels), or (H, W) when `channels` is None.

    uniform: random in [0, 1). hdr: lognormal with one pixel in fifty a thousand times brighter, and at least
    one such firefly. constant: 0.5 and a little more per channel. step: dark left half, bright right half.
    textured: checker of four pixels on a diagonal gradient, in [0, 1].

    Example:
        >>> planes("hdr", 3, 2, 3).shape, planes("step", 1, 9).dtype
        ((3, 2, 3), dtype('float32'))
    """
    shape = (height, width, channels or 1)
    rng = np.random.default_rng([seed, KINDS.index(kind), *shape])
    y, x = np.mgrid[:height, :width]
    offset = 0.05 * np.arange(shape[2])
    if kind == "uniform":
        image = rng.random(shape)
    elif kind == "hdr":
        image = rng.lognormal(-1.0, 1.5, shape)
        fireflies = rng.random((height, width)) < 0.02
        fireflies.flat[rng.integers(height * width)] = True
        image[fireflies] *= 1000.0
    elif kind == "constant":
        image = np.full(shape, 0.5) + offset
    elif kind == "step":
        image = np.where(x < width // 2, 0.2, 0.8)[..., None] + offset
    else:
        checker = (x // 4 + y // 4) % 2
        gradient = (x + 2 * y) / (width + 2 * height)
        image = (0.5 * checker + 0.4 * gradient)[..., None] + offset
    image = np.ascontiguousarray(image, dtype=np.float32)
    return image if channels else image[..., 0]


def images(channels: int | None = None, seed: int = 0) -> Iterator[tuple[str, np.ndarray]]:
    """Every kind at every size, each with a name such as `hdr-13x17`."""
    for kind in KINDS:
        for height, width in SIZES:
            yield f"{kind}-{height}x{width}", planes(kind, height, width, channels, seed)


def features(height: int, width: int, seed: int = 0, noise: float = 1.0) -> dict[str, np.ndarray]:
    """A room with a ball, as a path tracer would leave it: `color`, `albedo`, `normal`, `depth`; float32.

    A back wall, a left wall, a floor and a sphere; tiles on the floor, a gradient on the walls, a shadow that
    shows in no feature. `albedo` (H, W, 3) in [0, 1], `normal` (H, W, 3) of unit length, `depth` (H, W) above
    zero, `color` (H, W, 3) scene-linear with gamma noise and fireflies. `noise` scales every disturbance;
    0 gives the noise-free scene.

    Example:
        >>> {name: plane.shape for name, plane in features(31, 64).items()}
        {'color': (31, 64, 3), 'albedo': (31, 64, 3), 'normal': (31, 64, 3), 'depth': (31, 64)}
    """
    rng = np.random.default_rng([seed, height, width])
    y, x = np.mgrid[:height, :width]
    u, v = (x + 0.5) / width, (y + 0.5) / height

    # The surfaces, from the back to the front.
    normal = np.full((height, width, 3), (0.0, 0.0, 1.0))
    albedo = (0.6 + 0.4 * u)[..., None] * (0.4, 0.4, 0.35)
    depth = np.full((height, width), 4.0)

    left = u < 0.2
    normal[left] = (1.0, 0.0, 0.0)
    albedo[left] = (0.8, 0.6, 0.2)
    depth[left] = 2.0 + 10.0 * u[left]

    floor = v > 0.7
    tile = ((x // 9 + y // 6) % 2)[..., None]
    normal[floor] = (0.0, 1.0, 0.0)
    albedo[floor] = np.repeat(0.02 + 0.78 * tile, 3, axis=-1)[floor]
    depth[floor] = 4.0 - 8.0 * (v[floor] - 0.7)

    radius = 0.25
    aspect = width / height
    sx, sy = (u - 0.6) * aspect / radius, (0.55 - v) / radius
    inside = sx**2 + sy**2 < 1.0
    sz = np.sqrt(np.where(inside, 1.0 - sx**2 - sy**2, 0.0))
    normal[inside] = np.stack([sx, sy, sz], -1)[inside]
    albedo[inside] = (0.1, 0.3, 0.8)
    depth[inside] = 2.0 - 0.5 * sz[inside]

    light = np.array([0.4, 0.7, 0.6]) / np.linalg.norm([0.4, 0.7, 0.6])
    irradiance = 0.2 + 2.0 * np.clip(normal @ light, 0.0, None)
    irradiance = np.where((u + 0.5 * v > 0.95) & ~inside, 0.3 * irradiance, irradiance)
    color = albedo * irradiance[..., None]

    # Gamma noise of mean 1: the dimmer the pixel, the noisier, as with few light paths.
    if noise > 0.0:
        variance = 0.05 * noise**2 / irradiance
        color = color * rng.gamma(1.0 / variance, variance)[..., None]
        fireflies = rng.random((height, width)) < 0.005
        color[fireflies] *= 1.0 + 20.0 * noise
        albedo = np.clip(albedo + 0.02 * noise * rng.standard_normal(albedo.shape), 0.0, 1.0)
        normal = normal + 0.05 * noise * rng.standard_normal(normal.shape)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        depth = depth * (1.0 + 0.01 * noise * rng.standard_normal(depth.shape))
    scene = {"color": color, "albedo": albedo, "normal": normal, "depth": depth}
    return {name: np.ascontiguousarray(plane, dtype=np.float32) for name, plane in scene.items()}
