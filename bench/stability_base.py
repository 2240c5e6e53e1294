"""A small room path-traced in NumPy: the healthy frame that the cases of `stability_inputs.py` damage, and its truth.

It needs no renderer and comes out the same everywhere. It holds what features say nothing of, or nothing good: soft
shadows, a window through which rays leave the scene, a mirror ball, a lamp; and textures on planes.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from mcdenoise_cl import Frame

HEIGHT, WIDTH, SPP = 120, 160, 16
#: The truth comes from a grid of so many rays a side of each pixel, each with one point of the lamp.
TRUTH_SIDE = 16

EYE = np.float32([0.3, 1.5, 4.5])
BALL, BALL_RADIUS = np.float32([-0.4, 0.6, 0.2]), 0.6
MIRROR, MIRROR_RADIUS = np.float32([1.3, 0.5, 0.8]), 0.5
#: Corner and sides of the lamp under the ceiling, and its radiance.
LAMP, LAMP_SIDES, LAMP_LIGHT = np.float32([-0.5, 2.95, -0.6]), (1.0, 0.8), np.float32([18, 16, 13])
SKY, INDIRECT = np.float32([0.9, 1.4, 2.2]), np.float32([0.10, 0.09, 0.08])
#: The shape of the gamma distribution of a sample's indirect light: few samples carry most of it.
INDIRECT_SHAPE = 0.3
FAR = np.float32(1e6)


def planes_of(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of the mean over axis 0 of samples (spp, H, W, ...)."""
    return samples.mean(0), samples.var(0, ddof=1) / len(samples)


@cache
def room() -> tuple[Frame, np.ndarray]:
    """16 samples per pixel with features, all variances and halves; and the truth (H, W, 3). Not to be written to."""
    rng = np.random.default_rng(1)
    shape = (SPP, HEIGHT, WIDTH)
    found = _traced(*rng.random((2, *shape), np.float32), rng.random((*shape, 2), np.float32))
    indirect = rng.gamma(INDIRECT_SHAPE, 1 / INDIRECT_SHAPE, (*shape, 1)).astype(np.float32)
    color = found["direct"] + indirect * found["indirect"]
    planes = {}
    for name, samples in {"color": color, **{name: found[name] for name in ("albedo", "normal", "depth")}}.items():
        planes[name], planes[f"{name}_variance"] = planes_of(samples)
    planes["color_a"], planes["color_b"] = color[::2].mean(0), color[1::2].mean(0)
    for plane in planes.values():
        plane.flags.writeable = False
    return Frame(**planes), _truth()


def _truth() -> np.ndarray:
    """Light along a regular grid of rays; points on the lamp from a low-discrepancy sequence, no other chance."""
    truth = np.zeros((HEIGHT, WIDTH, 3))
    golden = np.float64([0.7548776662466927, 0.5698402909980532])  # the R2 sequence
    pixel = np.arange(HEIGHT * WIDTH).reshape(1, HEIGHT, WIDTH, 1)
    for i in range(TRUTH_SIDE**2):
        across, down = ((i % TRUTH_SIDE + 0.5) / TRUTH_SIDE, (i // TRUTH_SIDE + 0.5) / TRUTH_SIDE)
        offsets = (np.full((1, HEIGHT, WIDTH), offset, np.float32) for offset in (across, down))
        found = _traced(*offsets, ((i * golden + pixel * 0.618034 * golden) % 1).astype(np.float32))
        truth += (found["direct"] + found["indirect"])[0]
    truth = (truth / TRUTH_SIDE**2).astype(np.float32)
    truth.flags.writeable = False
    return truth


def _traced(across: np.ndarray, down: np.ndarray, on_lamp: np.ndarray) -> dict[str, np.ndarray]:
    """Camera rays through points of the pixels, (spp, H, W), each in [0, 1): light and features of what they meet."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    span = np.float32(1.1 / HEIGHT)
    rays = np.stack([(x + across - WIDTH / 2) * span, -(y + down - HEIGHT / 2) * span, np.full_like(across, -1.2)], -1)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    flat, points = rays.reshape(-1, 3), on_lamp.reshape(-1, 2)
    origin = np.broadcast_to(EYE, flat.shape)
    first = _seen(origin, flat)
    direct, indirect = _light(first, points)
    mirror = np.flatnonzero(first["mirror"])
    normal = first["normal"][mirror]
    ahead = flat[mirror] - 2 * (flat[mirror] * normal).sum(-1, keepdims=True) * normal
    second = _light(_seen(first["place"][mirror] + 1e-3 * normal, ahead), points[mirror])
    direct[mirror], indirect[mirror] = (0.9 * light for light in second)
    depth = np.where(first["t"] < FAR, first["t"], 0)
    found = {"direct": direct, "indirect": indirect, "albedo": first["albedo"], "normal": first["normal"]}
    return {name: plane.reshape(*across.shape, 3) for name, plane in found.items()} | {
        "depth": depth.reshape(across.shape)
    }


def _sphere(origin: np.ndarray, rays: np.ndarray, middle: np.ndarray, radius: float) -> np.ndarray:
    """How far along unit rays (N, 3) a sphere is; FAR where it is not."""
    to = middle - origin
    along = (to * rays).sum(-1)
    inside = radius**2 - ((to * to).sum(-1) - along**2)
    t = along - np.sqrt(np.maximum(inside, 0))
    return np.where((inside > 0) & (t > 1e-4), t, FAR)


def _seen(origin: np.ndarray, rays: np.ndarray) -> dict[str, np.ndarray]:
    """The nearest surface along rays (N, 3): distance t, place, normal, albedo, emitted light, and what is a mirror."""
    t = np.full(len(rays), FAR, np.float32)
    normal, albedo, emitted = (np.zeros((len(rays), 3), np.float32) for _ in range(3))
    mirror = np.zeros(len(rays), bool)

    def nearer(distance: np.ndarray, where: np.ndarray | bool = True) -> np.ndarray:
        hit = (distance > 1e-4) & (distance < t) & where
        t[hit] = distance[hit]
        return hit

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for axis, at, facing in ((1, 0.0, 1), (2, -2.0, 1), (0, -2.4, 1), (1, 3.0, -1)):  # floor, back, left, ceiling
            distance = np.where(rays[:, axis] * facing < 0, (at - origin[:, axis]) / rays[:, axis], FAR)
            place = origin + distance[:, None] * rays
            window = (axis == 2) & (np.abs(place[:, 0] - 1.3) < 0.6) & (np.abs(place[:, 1] - 1.7) < 0.5)
            hit = nearer(distance, ~window & (distance < 30))
            normal[hit] = np.eye(3, dtype=np.float32)[axis] * facing
            albedo[hit] = _texture(axis, at, place[hit])
    hit = nearer(_sphere(origin, rays, BALL, BALL_RADIUS))
    normal[hit] = (origin[hit] + t[hit, None] * rays[hit] - BALL) / BALL_RADIUS
    albedo[hit] = (0.15, 0.35, 0.7)
    mirror = nearer(_sphere(origin, rays, MIRROR, MIRROR_RADIUS))
    normal[mirror] = (origin[mirror] + t[mirror, None] * rays[mirror] - MIRROR) / MIRROR_RADIUS
    albedo[mirror] = 0
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance = np.where(rays[:, 1] > 0, (LAMP[1] - origin[:, 1]) / rays[:, 1], FAR)
        on = (origin + distance[:, None] * rays - LAMP)[:, ::2]
        lamp = nearer(distance, ((on >= 0) & (on <= LAMP_SIDES)).all(-1))
    normal[lamp], albedo[lamp], emitted[lamp] = (0, -1, 0), 0, LAMP_LIGHT
    mirror &= ~lamp
    place = origin + np.where(t < FAR, t, 0)[:, None] * rays
    emitted[t >= FAR] = SKY
    return {"t": t, "place": place, "normal": normal, "albedo": albedo, "emitted": emitted, "mirror": mirror}


def _texture(axis: int, at: float, place: np.ndarray) -> np.ndarray:
    """Tiles on the floor, fine stripes on the back wall, plain paint elsewhere: albedo (N, 3)."""
    if axis == 1 and at == 0:
        tile = (np.floor(place[:, 0] / 0.35) + np.floor(place[:, 2] / 0.35)) % 2
        return np.where(tile[:, None] > 0, np.float32([0.75, 0.7, 0.6]), np.float32([0.12, 0.1, 0.1]))
    if axis == 2:
        stripe = 0.5 + 0.25 * np.sin(place[:, 0] * 30) * (place[:, 1] < 1.2)
        return stripe[:, None] * np.float32([0.9, 0.8, 0.7])
    return np.broadcast_to(np.float32([0.6, 0.25, 0.2] if axis == 0 else [0.7, 0.7, 0.7]), place.shape)


def _light(seen: dict[str, np.ndarray], on_lamp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Emitted light and that of one point of the lamp, with its shadow; and the mean indirect light. Both (N, 3)."""
    to = LAMP + np.stack([on_lamp[:, 0] * LAMP_SIDES[0], np.zeros(len(on_lamp)), on_lamp[:, 1] * LAMP_SIDES[1]], -1)
    to = (to - seen["place"]).astype(np.float32)
    distance = np.linalg.norm(to, axis=-1)
    to /= np.maximum(distance, 1e-3)[:, None]
    start = seen["place"] + 1e-3 * seen["normal"]
    free = np.ones(len(to), bool)
    for middle, radius in ((BALL, BALL_RADIUS), (MIRROR, MIRROR_RADIUS)):
        free &= _sphere(start, to, middle, radius) >= FAR
    cosines = np.clip((to * seen["normal"]).sum(-1), 0, None) * np.clip(to[:, 1], 0, None)
    area = LAMP_SIDES[0] * LAMP_SIDES[1]
    irradiance = free * cosines * area / np.maximum(distance**2, 0.05) / np.pi
    return seen["emitted"] + seen["albedo"] * irradiance[:, None] * LAMP_LIGHT, seen["albedo"] * INDIRECT
