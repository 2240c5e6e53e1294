"""Effects that corrupt features, or that features do not show, as cases of the stability table (`stability.py`).

What is judged in each is a mask: the edges that only the colour has, or the pixels whose features are mixtures.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from effects import HEIGHT, REFERENCE_SPP, SPP, WIDTH, rendering, sampling
from stability_case import Case

from mcdenoise_cl import Frame

Made = tuple[Frame, np.ndarray | None, np.ndarray | None]
LUMINANCE = (0.2126, 0.7152, 0.0722)
HALF_MOST = 65504.0


# What is judged


def grown(mask: np.ndarray, radius: int) -> np.ndarray:
    """The mask and the pixels up to `radius` rows and columns from it."""
    padded = np.pad(mask, radius)
    span = range(2 * radius + 1)
    return np.any([padded[y : y + mask.shape[0], x : x + mask.shape[1]] for y in span for x in span], axis=0)


def slope(plane: np.ndarray) -> np.ndarray:
    """The largest difference of a pixel from its right and lower neighbour, over the channels, (H, W)."""
    plane = plane.astype(np.float64).reshape(*plane.shape[:2], -1)
    down = np.abs(np.diff(plane, axis=0, append=plane[-1:]))
    across = np.abs(np.diff(plane, axis=1, append=plane[:, -1:]))
    return np.maximum(down, across).max(-1)


def tone(image: np.ndarray) -> np.ndarray:
    """log2 of the luminance, from a hundredth of its mean on, (H, W)."""
    light = np.maximum(image.astype(np.float64) @ LUMINANCE, 0.0)
    return np.log2(light + 0.01 * light.mean() + 1e-30)


def contrast_kept(image: np.ndarray, reference: Frame, mask: np.ndarray) -> float:
    """How much of the contrast between neighbours that the truth has is left: 1 for the truth and for noise about it.

    Least squares of the image's differences on the reference's, relative to the brightness. Its halves a and b make
    sum dx (da + db) / 2 / sum da db, in which the noise of the reference cancels in the mean.
    """
    light, a, b = (x.astype(np.float64) @ LUMINANCE for x in (image, reference.color_a, reference.color_b))
    weight = 1.0 / ((a + b) ** 2 / 4 + 1e-4 * (a + b).mean() ** 2)
    above = below = 0.0
    for axis in (0, 1):
        inside = np.delete(mask, -1, axis)
        dx, da, db = (np.diff(plane, axis=axis)[inside] for plane in (light, a, b))
        w = np.delete(weight, -1, axis)[inside]
        above, below = above + (w * dx * (da + db) / 2).sum(), below + (w * da * db).sum()
    return float(above / below)


def color_edges(reference: Frame) -> np.ndarray:
    """Pixels within two of an edge of a third of a stop or more that neither albedo, normal nor depth has."""
    in_features = (slope(reference.albedo) > 0.05) | (slope(reference.normal) > 0.1)
    in_features |= slope(np.log2(reference.depth + 1e-3)) > 0.15
    return grown((slope(tone(reference.color)) > 1 / 3) & ~grown(in_features, 1), 2)


def mixed_features(reference: Frame) -> np.ndarray:
    """Pixels whose samples see different surfaces."""
    spread = reference.albedo_variance.max(-1) * reference.metadata["samples_per_pixel"]
    return spread > 1e-3


def mirrored_edges(reference: Frame) -> np.ndarray:
    """Pixels within two of an edge of a third of a stop or more, in things that have a depth and no albedo."""
    shown = (reference.albedo.max(-1) < 0.02) & (reference.depth > 0)
    return grown((slope(tone(reference.color)) > 1 / 3) & shown, 2) & shown


# Sampled scenes: (x, y, t, rng) -> the planes of one ray a pixel, on a canvas of 160 x 120

CENTER = (WIDTH / 2, HEIGHT / 2)


def surfaces(albedo: np.ndarray, depth: np.ndarray, light: np.ndarray, rng: np.random.Generator) -> dict:
    """Upright surfaces under a light that a quarter of the rays find."""
    found = 4.0 * (rng.random(light.shape) < 0.25)
    normal = np.broadcast_to((0.0, -1.0, 0.0), albedo.shape)
    return {
        "color": albedo * (light * (0.3 + 0.7 * found))[..., None],
        "albedo": albedo,
        "normal": normal,
        "depth": depth,
    }


def moving_card(x, y, t, rng):
    """A chequered card that moves by 24 pixels across a striped wall while the shutter is open."""
    at = x - 56 - 24 * t
    card = (abs(at - 16) < 16) & (abs(y - 60) < 30)
    checks = (at // 8 + y // 8) % 2
    stripes = (x // 12) % 2
    albedo = np.where(card, 0.1 + 0.7 * checks, 0.35 + 0.15 * stripes)[..., None] * (0.9, 0.8, 0.6)
    return surfaces(albedo, np.where(card, 3.0, 6.0), np.ones(x.shape), rng)


def foliage(x, y, t, rng):
    """Blades about a pixel wide at every angle before a bright sky and a wall."""
    albedo = np.where(y[..., None] < 50, (0.0, 0.0, 0.0), (0.6, 0.55, 0.5))
    light, depth = np.where(y < 50, 0.0, 1.0), np.where(y < 50, 0.0, 9.0)
    sky = np.where(y < 50, 2.0, 0.0)
    for i in range(60):
        angle, place, width = i * 2.4, (37 * i) % 190 - 95, 0.5 + 0.25 * (i % 3)
        away = (x - CENTER[0]) * np.cos(angle) + (y - CENTER[1]) * np.sin(angle) - place
        blade = abs(away) < width
        albedo[blade] = (0.1 + 0.03 * (i % 5), 0.3 + 0.05 * (i % 4), 0.05)
        light[blade], depth[blade], sky[blade] = 0.6 + 0.2 * (i % 4), 4.0 + 0.05 * i, 0.0
    planes = surfaces(albedo, depth, light, rng)
    planes["color"] = planes["color"] + sky[..., None]
    return planes


def sun(x, y, t, rng):
    """A disc a million times as bright as the wall around it, whose upper half another shape hides."""
    disc = ((x - 80) ** 2 + (y - 60) ** 2 < 100) & (y > 56)
    albedo = np.where(disc, 0.0, 0.3 + 0.2 * ((x // 16 + y // 16) % 2))[..., None] * (0.9, 0.8, 0.7)
    planes = surfaces(albedo, np.where(disc, 0.0, 5.0), np.ones(x.shape), rng)
    planes["color"] = planes["color"] + np.where(disc, 4e5, 0.0)[..., None]
    return planes


# Cases


def rendered_truth(name: str) -> Frame:
    return rendering(name, REFERENCE_SPP, seed=2)


def sampled_truth(shade: Callable) -> Frame:
    return sampling(shade, REFERENCE_SPP, seed=2)


def rendered_case(name: str, judged: Callable[[Frame], np.ndarray]) -> Made:
    reference = rendered_truth(name)
    return rendering(name, SPP, seed=1), reference.color, judged(reference)


def sampled_case(shade: Callable, judged: Callable[[Frame], np.ndarray]) -> Made:
    reference = sampled_truth(shade)
    return sampling(shade, SPP, seed=1), reference.color, judged(reference)


def beside_the_sun(reference: Frame) -> np.ndarray:
    """The wall within 12 pixels of the disc; no pixel that the disc touches."""
    bright = grown(reference.color.max(-1) > 10.0, 1)
    return grown(bright, 12) & ~bright


def without_variance() -> Made:
    """The sun known from two halves alone."""
    frame, truth, mask = sampled_case(sun, beside_the_sun)
    planes = {name: plane for name, plane in frame.planes().items() if name != "color_variance"}
    return Frame(**planes), truth, mask


def in_halves() -> Made:
    """The sun in 16 bits: 65504 is the most that they hold, and a renderer writes infinity beyond."""
    frame, truth, mask = sampled_case(sun, beside_the_sun)
    with np.errstate(over="ignore"):
        planes = {name: plane.astype(np.float16) for name, plane in frame.planes().items()}
    return Frame(**planes), np.minimum(truth, HALF_MOST), mask


TOPIC = "effects that features do not show"
KEPT = (
    "auto is nearer to the truth than its input on the judged pixels, and the edges there keep 80 % of their contrast"
)

CASES: tuple[Case, ...] = (
    Case(
        TOPIC,
        "defocus",
        "a wide lens, at 4 spp: features are mixtures",
        KEPT,
        partial(rendered_case, "defocus", mixed_features),
        partial(rendered_truth, "defocus"),
    ),
    Case(
        TOPIC,
        "motion blur",
        "a card that moves by 24 pixels, at 4 spp",
        KEPT,
        partial(sampled_case, moving_card, mixed_features),
        partial(sampled_truth, moving_card),
    ),
    Case(
        TOPIC,
        "mirror and glass",
        "what a mirror and a glass ball show is in no feature",
        KEPT,
        partial(rendered_case, "mirror and glass", mirrored_edges),
        partial(rendered_truth, "mirror and glass"),
    ),
    Case(
        TOPIC,
        "alpha edges",
        "holes of an opacity texture, which the features do not have",
        KEPT,
        partial(rendered_case, "alpha", color_edges),
        partial(rendered_truth, "alpha"),
    ),
    Case(
        TOPIC,
        "foliage",
        "blades one pixel wide",
        KEPT,
        partial(sampled_case, foliage, mixed_features),
        partial(sampled_truth, foliage),
    ),
    Case(
        TOPIC,
        "shadow",
        "the sharp shadow of a sun on a plane without texture",
        KEPT,
        partial(rendered_case, "shadow", color_edges),
        partial(rendered_truth, "shadow"),
    ),
    Case(
        TOPIC,
        "caustic",
        "light that a glass ball focuses on a plane without texture",
        KEPT,
        partial(rendered_case, "caustic", color_edges),
        partial(rendered_truth, "caustic"),
    ),
    Case(
        TOPIC,
        "sun",
        "a disc a million times as bright as its surroundings",
        "none of its light is seen around it: auto is nearer to the truth than its input there",
        partial(sampled_case, sun, beside_the_sun),
    ),
    Case(
        TOPIC,
        "sun-halves",
        "the same, known from two halves alone",
        "as with variances",
        without_variance,
    ),
    Case(
        TOPIC,
        "half floats",
        "the same in 16 bits, where the disc overflows",
        "the result is finite, and around the disc as with 32 bits",
        in_halves,
    ),
)
