"""A school room in the afternoon: rows of desks, a wall of windows, a chalkboard, lamps left on; shot with a wide lens.

The lens is focused on the second row, so the page, the pencils and the glass on the nearest desk are blurred, and with
them the albedo and normals a denoiser would steer by: what is an edge in focus is a noisy ramp here. Chair legs,
window bars and chalk strokes are a pixel or two wide, mullions throw hard shadows across textured planks and desks,
the far side of the room sees only light that bounced, and the tubes on the ceiling are seen directly.
"""

from itertools import pairwise

import numpy as np

from . import _shapes as s
from . import _textures as t

WIDTH, DEPTH, HEIGHT = 7.0, 8.5, 3.0
SILL, HEAD = 0.95, 2.55
COLUMNS, ROWS = (1.25, 2.6, 3.95, 5.3), (2.0, 3.4, 4.75, 6.1)


def build(width: int, height: int) -> dict:
    """The scene as `mi.load_dict` takes it, filmed at width x height pixels."""
    model = s.Model(
        floor=s.varnish(s.texture(t.planks("8a6038", "d3a56c", rows=8, seed=3), (2.4, 1.0)), 0.18),
        wall=s.matte(t.rgb("e9e4d6")),
        dado=s.matte(s.texture(t.planks("98a88c", "c3cfb4", rows=8, seed=5), (2.4, 0.9))),
        ceiling=s.matte(s.texture(t.weave("eeede8", 0.06, 3), (0.6, 0.6))),
        trim=s.matte(t.rgb("e6e2d8")),
        top=s.varnish(s.texture(t.wood("9a6a3a", "d2a56c", 2), (1.2, 0.4)), 0.15),
        oak=s.varnish(s.texture(t.wood("6e4526", "a9784a", 12), (1.4, 0.4)), 0.2),
        board=s.matte(s.texture(t.script("dfe6df", "24483a", 7, 4, (512, 1280)))),
        page=s.matte(s.texture(t.script("2a2d4a", "f3eddf", 16, 2))),
        paper=s.matte(t.rgb("efe9dc")),
        cork=s.matte(s.texture(t.blend("8a6238", "b98d5c", 0.5 + 0.25 * t.noise((256, 256), 1, 1, 1)), (0.5, 0.5))),
        poster0=s.matte(s.texture(t.hills(4))),
        poster1=s.matte(s.texture(t.discs(8))),
        poster2=s.matte(s.texture(t.script("7a2f2a", "efe6cf", 9, 6))),
        map=s.varnish(s.texture(_map()), 0.05),
        books=s.varnish(
            s.texture(t.palette("8f2f2a", "2f5d7c", "d8a53a", "3e6b4f", "e8e0cc", "5b3f63"), (64, 64)), 0.25
        ),
        bag=s.matte(s.texture(t.weave("7c3a2c", 0.3, 5), (0.1, 0.1))),
        cloth=s.matte(s.texture(t.weave("d9d2bf", 0.2, 8), (0.2, 0.2))),
        steel=s.metal("Al", 0.3),
        brass=s.metal("Au", 0.2),
        black=s.varnish(t.rgb("1a1a1a"), 0.15),
        leaf=s.varnish(t.rgb("4a7a38"), 0.3),
        clay=s.matte(t.rgb("b5643f")),
        apple=s.varnish(t.rgb("b3261e"), 0.08),
        glass=s.glass(),
    )
    _shell(model)
    _windows(model)
    _front(model)
    for row, y in enumerate(ROWS):
        for column, x in enumerate(COLUMNS):
            with model.at(x, y, turn=(-3, 2, 0, 4, -1)[(3 * row + column) % 5]):
                _desk(model, 4 * row + column)
    with model.at(COLUMNS[3] - 0.06, ROWS[0], 0.74):
        _still_life(model)
    for y in (2.6, 5.6):
        for x in (1.9, 4.9):
            _lamp(model, x, y)
    model.sun((1.0, -0.3, -0.78), (7, 6.1, 4.7))
    return model.finish((6.0, 0.25, 1.52), (2.85, 6.2, 0.9), 66, (width, height), lens=(0.022, 4.2))


def _map(size: int = 256) -> np.ndarray:
    """Continents for a globe: land where smooth noise is high."""
    height = t.noise((size, 2 * size), 16, 20, 5)
    pixels = t.blend("1f4e79", "3f7fa6", 0.5 + 0.5 * height)
    land = t.blend("6f8f4a", "c9b377", height - 0.3)
    return np.where((height > 0.35)[..., None], land, pixels)


def _shell(model: s.Model) -> None:
    model.sheet("floor", (0, 0, 0), (WIDTH, 0, 0), (0, DEPTH, 0))
    model.sheet("ceiling", (0, DEPTH, HEIGHT), (WIDTH, 0, 0), (0, -DEPTH, 0))
    model.sheet("wall", (0, DEPTH, 0), (WIDTH, 0, 0), (0, 0, HEIGHT))
    model.sheet("wall", (WIDTH, 0, 0), (-WIDTH, 0, 0), (0, 0, HEIGHT))
    model.sheet("wall", (WIDTH, DEPTH, 0), (0, -DEPTH, 0), (0, 0, HEIGHT))
    model.box("wall", (-0.25, 0, 0), (0, DEPTH, SILL))
    model.box("wall", (-0.25, 0, HEAD), (0, DEPTH, HEIGHT))
    for y in (0, 2.85, 5.7, DEPTH - 0.4):
        model.box("wall", (-0.25, y, SILL), (0.06, y + 0.4, HEAD))
    model.box("dado", (0, 0, 0.1), (0.015, DEPTH, SILL - 0.08))
    model.box("dado", (0, DEPTH - 0.015, 0.1), (WIDTH, DEPTH, SILL - 0.08))
    model.box("trim", (0, 0, SILL - 0.04), (0.16, DEPTH, SILL))
    for x, y in ((0, 0), (0, DEPTH - 0.02)):
        model.box("oak", (x, y, 0), (WIDTH if y else 0.02, DEPTH, 0.1))


def _windows(model: s.Model) -> None:
    for start, end in ((0.4, 2.85), (3.25, 5.7), (6.1, DEPTH - 0.4)):
        for y in np.linspace(start, end, 4):
            model.box("trim", (-0.2, y - 0.022, SILL), (-0.15, y + 0.022, HEAD))
        for z in (SILL + 0.03, SILL + 1.0, HEAD - 0.03):
            model.box("trim", (-0.195, start, z - 0.02), (-0.155, end, z + 0.02))
        for i in range(6):
            y = end + 0.02 + 0.06 * i
            model.rod("cloth", (0.11 + 0.02 * (i % 2), y, SILL - 0.35), (0.11, y, HEAD + 0.12), 0.034)
    model.rod("brass", (0.11, 0.2, HEAD + 0.13), (0.11, DEPTH - 0.1, HEAD + 0.13), 0.013)
    model.panel((-2.5, -1.5, -0.5), (0, 14.5, 0), (0, 0, 4), s.texture(t.garden(8, 0.9, 0.45, 4)), 3)
    # The corridor's windows, high on the opposite wall and out of sight.
    model.panel((WIDTH - 0.01, 1.0, 1.9), (0, 0, 0.7), (0, 6.4, 0), (1.6, 1.7, 1.75))
    with model.at(0.08, 4.5, SILL):
        _pot(model)


def _pot(model: s.Model) -> None:
    random = np.random.default_rng(2)
    model.lathe(
        "clay", [(0, 0), (0.05, 0), (0.05, 0), (0.07, 0.1), (0.07, 0.1), (0.078, 0.1), (0.078, 0.125), (0.06, 0.125)]
    )
    for i in range(26):
        with model.at(0, 0, 0.12 + 0.006 * i, turn=137.5 * i, tilt=random.uniform(-60, -5)):
            model.cushion("leaf", (0.08, 0, 0), (0.16, 0.045, 0.006), 0, detail=6)


def _front(model: s.Model) -> None:
    """The chalkboard wall: board, clock, notices, a platform with the teacher's desk and a globe."""
    y = DEPTH - 0.03
    model.box("oak", (1.1, y, 0.98), (5.1, DEPTH, 2.32))
    model.picture("board", (1.16, y - 0.002, 1.04), (3.88, 0, 0), (0, 0, 1.22))
    model.box("oak", (1.1, y - 0.1, 0.96), (5.1, y, 0.985))
    for i, x in enumerate((1.5, 1.62, 3.2, 4.4)):
        model.box("paper", (x, y - 0.06, 0.985), (x + 0.07, y - 0.048, 0.997))
        model.box("bag", (x + 0.3, y - 0.08, 0.985), (x + 0.44, y - 0.03, 1.02 + 0.004 * i))
    with model.at(3.1, DEPTH - 0.05, 2.66, turn=90, tilt=-90):
        model.lathe("black", [(0.17, -0.05), (0.17, 0.01), (0.17, 0.01), (0.15, 0.01)], sides=36)
        model.lathe("paper", [(0.15, 0.004), (0, 0.004)], sides=36)
        for turn, reach in ((100, 0.085), (215, 0.125)):
            with model.at(0, 0, 0.006, turn=turn):
                model.box("black", (-0.02, -0.006, 0), (reach, 0.006, 0.003))
    model.box("oak", (5.4, y, 1.0), (6.7, DEPTH, 2.2))
    model.sheet("cork", (5.44, y - 0.002, 1.04), (1.22, 0, 0), (0, 0, 1.12))
    for name, x, z, wide, tall in (
        ("poster0", 5.5, 1.6, 0.5, 0.5),
        ("poster1", 6.08, 1.62, 0.44, 0.46),
        ("poster2", 5.54, 1.1, 0.4, 0.42),
    ):
        model.picture(name, (x, y - 0.006, z), (wide, 0, 0), (0, 0, tall))
    model.box("oak", (0.9, DEPTH - 1.5, 0), (5.3, DEPTH, 0.16))
    with model.at(3.6, DEPTH - 0.95, 0.16):
        model.box("oak", (-0.8, -0.32, 0.72), (0.8, 0.32, 0.76))
        model.box("oak", (-0.74, -0.27, 0.1), (0.74, -0.25, 0.72))
        for x in (-0.74, 0.74):
            model.box("oak", (x - 0.02, -0.28, 0), (x + 0.02, 0.28, 0.72))
        for i in range(5):
            with model.at(-0.45, 0, 0.76 + 0.031 * i, turn=8 * (i % 3) - 6):
                model.box("books", (-0.13, -0.1, 0), (0.13, 0.1, 0.03))
        with model.at(0.45, 0, 0.76):
            _globe(model)


def _globe(model: s.Model) -> None:
    model.lathe("oak", [(0, 0), (0.11, 0), (0.11, 0), (0.1, 0.03), (0.02, 0.05), (0.018, 0.1)])
    with model.at(0, 0, 0.26, turn=-40, tilt=23):
        eta = np.linspace(-np.pi / 2, np.pi / 2, 25)
        arc = [(0.172 * np.cos(a), 0, 0.172 * np.sin(a)) for a in eta]
        for start, end in pairwise(arc):
            model.rod("brass", start, end, 0.005)
        model.sphere(model.materials["map"], (0, 0, 0), 0.155)


def _desk(model: s.Model, number: int) -> None:
    """Desk and chair; the pupil looks along +y."""
    random = np.random.default_rng(number)
    model.box("top", (-0.33, -0.23, 0.715), (0.33, 0.23, 0.74))
    model.box("top", (-0.29, -0.2, 0.6), (0.29, 0.2, 0.612))
    model.box("steel", (-0.29, 0.19, 0.6), (0.29, 0.2, 0.715))
    for x in (-0.29, 0.29):
        model.box("steel", (x - 0.004, -0.2, 0.6), (x + 0.004, 0.2, 0.715))
        model.rod("steel", (x, -0.19, 0), (x, -0.19, 0.6), 0.012)
        model.rod("steel", (x, 0.19, 0), (x, 0.19, 0.6), 0.012)
        model.rod("steel", (x, -0.19, 0.07), (x, 0.19, 0.07), 0.01)
    model.rod("steel", (-0.29, 0.19, 0.16), (0.29, 0.19, 0.16), 0.01)
    with model.at(random.uniform(-0.06, 0.06), random.uniform(-0.6, -0.36), turn=random.uniform(-14, 14)):
        _chair(model)
    if number == 3:
        return
    with model.at(random.uniform(-0.2, 0), 0, 0.74, turn=random.uniform(-25, 25)):
        for i in range(random.integers(1, 4)):
            model.box("books", (-0.09, -0.12, 0.018 * i), (0.09 - 0.01 * i, 0.12, 0.018 * i + 0.017))
    if number % 2:
        with model.at(0.17, -0.02, 0.741, turn=random.uniform(-15, 15)):
            model.picture("page", (-0.1, -0.14, 0.002), (0.2, 0, 0), (0, 0.28, 0))
    if number % 3 == 1:
        model.cushion("bag", (0.4, 0.02, 0.43), (0.15, 0.34, 0.28), 0.6)
        model.rod("bag", (0.36, -0.08, 0.55), (0.33, -0.02, 0.69), 0.008)
        model.rod("bag", (0.36, 0.12, 0.55), (0.33, 0.05, 0.69), 0.008)


def _chair(model: s.Model) -> None:
    model.cushion("top", (0, 0, 0.43), (0.38, 0.38, 0.022), 0.75)
    for side in (-1, 1):
        x = 0.17 * side
        model.rod("steel", (1.1 * x, 0.18, 0), (x, 0.16, 0.42), 0.011)
        model.rod("steel", (1.1 * x, -0.2, 0), (x, -0.17, 0.42), 0.011)
        model.rod("steel", (x, -0.17, 0.42), (x, -0.23, 0.78), 0.011)
        model.rod("steel", (1.08 * x, -0.19, 0.1), (1.08 * x, 0.18, 0.1), 0.009)
    with model.at(0, -0.215, 0.69, turn=90, tilt=9):
        model.cushion("top", (0, 0, 0), (0.022, 0.38, 0.17), 0.7)


def _still_life(model: s.Model) -> None:
    """What lies on the nearest desk: an open exercise book, pencils in a glass, an apple."""
    with model.at(-0.06, -0.03, 0.001, turn=12):
        model.box("books", (-0.215, -0.152, 0), (0.215, 0.152, 0.004))
        model.picture("page", (-0.21, -0.147, 0.009), (0.209, 0, 0), (0, 0.294, 0))
        model.picture("page", (0.001, -0.147, 0.009), (0.209, 0, 0), (0, 0.294, 0))
        model.rod("apple", (0.03, -0.06, 0.014), (0.14, 0.08, 0.014), 0.004)
    with model.at(-0.2, 0.16):
        outside = [(0, 0), (0.038, 0), (0.038, 0), (0.042, 0.11), (0.042, 0.11), (0.038, 0.11), (0.038, 0.11)]
        model.lathe("glass", [*outside, (0.035, 0.012), (0.035, 0.012), (0, 0.012)], sides=36)
        for i, name in enumerate(("bag", "leaf", "clay", "books", "brass")):
            angle = 1.3 * i
            foot = (0.02 * np.cos(angle + 2.6), 0.02 * np.sin(angle + 2.6), 0.014)
            model.rod(name, foot, (0.034 * np.cos(angle), 0.034 * np.sin(angle), 0.17 + 0.008 * i), 0.0042)
    model.cushion("apple", (0.22, 0.12, 0.038), (0.078, 0.078, 0.074), 0.1)
    model.rod("oak", (0.22, 0.12, 0.068), (0.226, 0.124, 0.088), 0.002)


def _lamp(model: s.Model, x: float, y: float) -> None:
    z = HEIGHT - 0.3
    for end in (-0.5, 0.5):
        model.rod("trim", (x, y + end, z), (x, y + end, HEIGHT), 0.006)
    model.box("trim", (x - 0.06, y - 0.66, z), (x + 0.06, y + 0.66, z + 0.05))
    model.tube(s.matte((0, 0, 0)), (x, y - 0.6, z - 0.035), (x, y + 0.6, z - 0.035), 0.017, (14, 14, 13))
    for end in (-0.62, 0.62):
        model.box("trim", (x - 0.02, y + end - 0.02, z - 0.06), (x + 0.02, y + end + 0.02, z))
