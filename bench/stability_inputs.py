"""Damaged inputs for `stability.py`: values that are not finite, outliers, features that say nothing or mislead."""

from __future__ import annotations

import numpy as np
import stability_damage as damage
from stability_base import HEIGHT, WIDTH
from stability_case import Case
from stability_damage import FEATURE_VARIANCES, FEATURES, SAMPLES, around, rows, scattered

NAN, INF = np.float32(np.nan), np.float32(np.inf)
#: Pixels (y, x) of the room: on the wall with stripes, and on the plain wall above it.
STRIPES, WALL = (66, 40), (52, 60)
ONE, SOME, ROW, HALF, ALL = around(STRIPES, 0), scattered(0.01), rows(95, 96), rows(0, 60), rows(0, HEIGHT)
PAIR = around(WALL, 0) | np.roll(around(WALL, 0), 1, axis=1)
BLOCK = PAIR | np.roll(PAIR, 1, axis=0)
#: Everything but the colour.
HALVES = ("color_a", "color_b")
EXTRAS = (*HALVES, "color_variance", *FEATURES, *FEATURE_VARIANCES)

NEIGHBOURS = "as if the mean of the finite neighbours stood there, and counted"
LIKE_WITHOUT = "no worse than without that feature"
AS_EVER = "as with the healthy frame"
BETTER = "less error than the input"


def _spoilt(name, tried, outcome, where, value, names=SAMPLES, mask=None):
    return name, tried, outcome, lambda: damage.spoilt(where, value, names, mask)


def _nothing_finite():
    frame, _, _ = damage.spoilt(ALL, NAN)
    return frame, None, None


NON_FINITE = (
    _spoilt("nan-pixel", "one pixel is NaN", NEIGHBOURS, ONE, NAN, mask=around(STRIPES, 12)),
    _spoilt("inf-pixel", "one pixel is +Inf", NEIGHBOURS, ONE, INF, mask=around(STRIPES, 12)),
    _spoilt("minus-inf-pixel", "one pixel is -Inf", NEIGHBOURS, ONE, -INF, mask=around(STRIPES, 12)),
    _spoilt("nan-1-percent", "NaN in 1 % of the pixels", NEIGHBOURS, SOME, NAN),
    _spoilt("inf-1-percent", "+Inf in 1 % of the pixels", NEIGHBOURS, SOME, INF),
    _spoilt("nan-row", "a row is NaN in every plane", NEIGHBOURS, ROW, NAN, ("color", *EXTRAS)),
    _spoilt("nan-half", "the upper half is NaN", "the lower half as ever", HALF, NAN, mask=rows(72, HEIGHT)),
    _spoilt("nan-albedo", "NaN in 1 % of the albedo", NEIGHBOURS, SOME, NAN, ("albedo", "albedo_variance")),
    _spoilt("nan-normal", "NaN in 1 % of the normals", NEIGHBOURS, SOME, NAN, ("normal", "normal_variance")),
    _spoilt("inf-depth", "+Inf in 1 % of the depths", NEIGHBOURS, SOME, INF, ("depth", "depth_variance")),
    _spoilt("nan-half-features", "the features of the upper half are NaN", BETTER, HALF, NAN, FEATURES),
    _spoilt("nan-variance", "NaN in 1 % of the colour's variance", NEIGHBOURS, SOME, NAN, ("color_variance",)),
    _spoilt(
        "nan-half-variance", "the upper half of the colour's variance is NaN", BETTER, HALF, NAN, ("color_variance",)
    ),
    _spoilt("inf-variance", "the colour's variance is +Inf everywhere", BETTER, ALL, INF, ("color_variance",)),
    ("all-nan", "every colour is NaN", "an error that says so", _nothing_finite),
    ("negative", "light below 0, from a filter with negative lobes", "it stays below 0", damage.sharpened),
)


def _firefly(power):
    tried = f"one sample of one pixel is 1e{power} times the frame's mean"
    outcome = "it goes, leaves no block, and its light is reported"
    return (
        f"firefly-1e{power}",
        tried,
        outcome,
        lambda: damage.fireflies(around(WALL, 0), 10.0**power, around(WALL, 15)),
    )


OUTLIERS = (
    *(_firefly(power) for power in (2, 3, 4, 5)),
    (
        "firefly-colour-alone",
        "the same, 1e4, with nothing but the colour",
        "it goes and leaves no block",
        lambda: damage.without(EXTRAS, damage.fireflies(around(WALL, 0), 1e4, around(WALL, 15))),
    ),
    (
        "firefly-pair",
        "two pixels beside each other with a sample of 1e4",
        "they go and leave no block",
        lambda: damage.fireflies(PAIR, 1e4, around(WALL, 15)),
    ),
    (
        "firefly-block",
        "two by two such pixels",
        "they go and leave no block",
        lambda: damage.fireflies(BLOCK, 1e4, around(WALL, 15)),
    ),
    (
        "firefly-pair-features",
        "the pair, with colour and features but no variance",
        "nothing tells it from a small lamp, so it may stay",
        lambda: damage.without((*HALVES, "color_variance"), damage.fireflies(PAIR, 1e4, around(WALL, 15))),
    ),
    (
        "fireflies-1-percent",
        "rare light: one sample of 1e3 in 1 % of the pixels, in the truth everywhere",
        "they go; their light is spread, not lost",
        damage.rare_light,
    ),
    (
        "one-pixel-lamp",
        "a lamp of one pixel, 100 times the mean, in every sample",
        "it stays",
        lambda: damage.lamps(around(WALL, 0), 100.0, around(WALL, 3)),
    ),
    (
        "one-pixel-lamp-halves",
        "the same, known from two halves alone",
        "two halves may agree by chance, so it may go",
        lambda: damage.without(("color_variance",), damage.lamps(around(WALL, 0), 100.0, around(WALL, 3))),
    ),
    (
        "small-lamp",
        "a lamp of two by two pixels, the same",
        "it stays",
        lambda: damage.lamps(BLOCK, 100.0, around(WALL, 3)),
    ),
    (
        "filament",
        "a glowing wire, one pixel thick, 100 times the mean, in every sample",
        "it stays",
        lambda: damage.lamps(damage.filament(), 100.0, damage.filament()),
    ),
    (
        "filament-halves",
        "the same, known from two halves alone",
        "it stays",
        lambda: damage.without(("color_variance",), damage.lamps(damage.filament(), 100.0, damage.filament())),
    ),
)

LENGTHS = np.random.default_rng(5).uniform(0.2, 5, (HEIGHT, WIDTH, 1))
NO_FEATURES = (*FEATURES, *FEATURE_VARIANCES)
NOTHING = {"albedo": (0, 0, 0), "normal": (0, 0, 0), "depth": 0}

DEGENERATE = (
    ("healthy", "nothing is wrong", "the bar for the rows below", damage.healthy),
    ("equal-normals", "one normal everywhere", LIKE_WITHOUT, lambda: damage.constant({"normal": (0, 0, 1)})),
    ("one-plane", "a plane with stripes of 6 pixels and a shadow", BETTER, lambda: damage.one_plane(6)),
    ("one-plane-fine", "the same with stripes of 3 pixels", BETTER, lambda: damage.one_plane(3)),
    ("opposite-normals", "normals turn round every 3 pixels: SSIM is below 0", LIKE_WITHOUT, damage.opposite_normals),
    ("no-noise", "no noise, and variances of 0", "the input, but for rounding", damage.without_noise),
    ("zero-normals", "every normal is 0, as in the sky", LIKE_WITHOUT, lambda: damage.constant({"normal": (0, 0, 0)})),
    ("zero-albedo", "every albedo is 0, as of metal", LIKE_WITHOUT, lambda: damage.constant({"albedo": (0, 0, 0)})),
    ("zero-features", "every feature is 0", "as with the colour's planes alone", lambda: damage.constant(NOTHING)),
    ("bright-albedo", "albedo up to 4", LIKE_WITHOUT, lambda: damage.scaled("albedo", 4 / 0.75)),
    ("long-normals", "normals of length 10", AS_EVER, lambda: damage.scaled("normal", 10)),
    ("uneven-normals", "normals of lengths 0.2 to 5", LIKE_WITHOUT, lambda: damage.scaled("normal", LENGTHS)),
    ("infinite-sky", "depth is +Inf in the sky", AS_EVER, lambda: damage.depth_of_the_sky(INF)),
    ("huge-sky", "depth is 1e9 in the sky", AS_EVER, lambda: damage.depth_of_the_sky(1e9)),
    ("huge-depth", "every depth is 1e9 times as large", AS_EVER, lambda: damage.scaled("depth", 1e9)),
    ("zero-depth", "every depth is 0", LIKE_WITHOUT, lambda: damage.constant({"depth": 0})),
    ("no-features", "colour, variance and halves", BETTER, lambda: damage.without(NO_FEATURES, damage.healthy())),
    ("colour-alone", "nothing but the colour", BETTER, lambda: damage.without(EXTRAS, damage.healthy())),
    ("noise-known", "features are noise, their variances say so", LIKE_WITHOUT, lambda: damage.noise_alone(True)),
    ("noise-unknown", "features are noise, no variance says so", BETTER, lambda: damage.noise_alone(False)),
    ("swapped", "albedo and normal change places", BETTER, damage.swapped),
    ("another-frame", "features mirrored left to right", BETTER, damage.of_another_frame),
)

TOPICS = {"non-finite input": NON_FINITE, "outliers": OUTLIERS, "degenerate features": DEGENERATE}
CASES: tuple[Case, ...] = tuple(Case(topic, *row) for topic, rows_ in TOPICS.items() for row in rows_)
