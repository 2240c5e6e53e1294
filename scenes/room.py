"""A living room on a sunny morning: sofa, books, a low table, a window with half-drawn blinds, a lit globe lamp.

The sun draws hard shadows of the blinds across planks and a patterned rug, where normals and depth are flat and only
colour tells the edges; the sky and the globe draw soft ones. Everything else is lit by what the floor and walls
reflect. Book spines, slats, leaves and picture frames are a few pixels wide, a glass bowl bends what lies behind it,
a copper one and the varnished floor mirror the window, and the globe is brighter than anything around it.
"""

import numpy as np

from . import _shapes as s
from . import _textures as t

WIDTH, DEPTH, HEIGHT = 5.4, 4.6, 2.6
WINDOW = (1.25, 3.45, 0.55, 2.3)  # y from, y to, z from, z to
BOOKS = ("7b2d26", "2f4858", "c9a227", "e4dcc8", "4c6b4f", "8a5a44", "23395b", "b5651d", "9aa5a0")


def build(width: int, height: int) -> dict:
    """The scene as `mi.load_dict` takes it, filmed at width x height pixels."""
    model = s.Model(
        floor=s.varnish(s.texture(t.planks("7a5434", "c39a6b", rows=8), (2.4, 1.2)), 0.18),
        wall=s.matte(t.rgb("e6e0d4")),
        accent=s.matte(t.rgb("71908c")),
        ceiling=s.matte(t.rgb("f0eee9")),
        trim=s.matte(t.rgb("eeebe4")),
        oak=s.varnish(s.texture(t.wood("80552f", "c4986a", 4), (1.6, 0.4)), 0.3),
        walnut=s.varnish(s.texture(t.wood("3a2416", "7a5232", 8), (1.6, 0.4)), 0.2),
        cloth=s.matte(s.texture(t.weave("b9b4a6", 0.3), (0.14, 0.14))),
        mustard=s.matte(s.texture(t.weave("c8922c", 0.3, 2), (0.14, 0.14))),
        rust=s.matte(s.texture(t.weave("a4502f", 0.3, 4), (0.14, 0.14))),
        navy=s.matte(s.texture(t.weave("2c4158", 0.3, 6), (0.14, 0.14))),
        linen=s.matte(s.texture(t.weave("ded6c6", 0.2, 8), (0.2, 0.2))),
        rug=s.matte(s.texture(t.rug("d8cdb8", "8f3b30", "2a3f55"))),
        hills=s.matte(s.texture(t.hills(1))),
        discs=s.matte(s.texture(t.discs(5))),
        print=s.matte(s.texture(t.discs(2))),
        page=s.matte(s.texture(t.script("22201e", "f1ead9", 18))),
        paper=s.matte(t.rgb("efe8d8")),
        black=s.varnish(t.rgb("1c1b1a"), 0.15),
        clay=s.matte(t.rgb("b9623f")),
        leaf=s.varnish(t.rgb("3f6b35"), 0.3),
        soil=s.matte(t.rgb("2b211b")),
        china=s.varnish(t.rgb("dfe3e2"), 0.05),
        copper=s.metal("Cu", 0.12),
        brass=s.metal("Au", 0.25),
        glass=s.glass(),
        books=s.varnish(s.texture(t.palette(*BOOKS), (64, 64)), 0.3),
    )
    _shell(model)
    _window(model)
    with model.at(2.2, DEPTH - 0.08):
        _sofa(model)
    with model.at(4.55, DEPTH - 0.02):
        _bookcase(model)
    with model.at(2.25, 2.35, turn=4):
        _table(model)
    with model.at(4.1, 2.75, turn=-118):
        _armchair(model)
    with model.at(0.5, 4.1):
        _plant(model)
    with model.at(3.62, 4.2):
        _floor_lamp(model)
    _pictures(model)
    model.sun((1.0, 0.42, -0.72), (5.5, 4.8, 3.6))
    return model.finish((3.5, 0.14, 1.4), (2.4, 3.6, 0.98), 74, (width, height))


def _shell(model: s.Model) -> None:
    y0, y1, z0, z1 = WINDOW
    model.sheet("floor", (0, 0, 0), (WIDTH, 0, 0), (0, DEPTH, 0))
    model.sheet("ceiling", (0, DEPTH, HEIGHT), (WIDTH, 0, 0), (0, -DEPTH, 0))
    model.sheet("accent", (0, DEPTH, 0), (WIDTH, 0, 0), (0, 0, HEIGHT))
    model.sheet("wall", (WIDTH, 0, 0), (-WIDTH, 0, 0), (0, 0, HEIGHT))
    model.sheet("wall", (WIDTH, DEPTH, 0), (0, -DEPTH, 0), (0, 0, HEIGHT))
    # The window wall is 20 cm thick, so that the sun leaves its reveals in shadow.
    for low, high in (
        ((0, 0), (y0, HEIGHT)),
        ((y1, 0), (DEPTH, HEIGHT)),
        ((y0, 0), (y1, z0)),
        ((y0, z1), (y1, HEIGHT)),
    ):
        model.box("wall", (-0.2, *low), (0, *high))
    model.box("trim", (0, DEPTH - 0.015, 0), (WIDTH, DEPTH, 0.1))
    model.box("trim", (0, 0, 0), (0.015, DEPTH, 0.1))
    model.box("trim", (WIDTH - 0.015, 0, 0), (WIDTH, DEPTH, 0.1))
    with model.at(0.95, 1.35, 0.012, turn=2):
        model.picture("rug", (0, 0, 0), (2.9, 0, 0), (0, 1.9, 0))


def _window(model: s.Model) -> None:
    y0, y1, z0, z1 = WINDOW
    model.box("trim", (-0.2, y0 - 0.05, z0 - 0.04), (0.12, y1 + 0.05, z0))
    for y in np.linspace(y0, y1, 4):
        model.box("trim", (-0.16, y - 0.03, z0), (-0.1, y + 0.03, z1))
    for z in (z0 + 0.03, z0 + 1.18, z1 - 0.03):
        model.box("trim", (-0.155, y0, z - 0.025), (-0.105, y1, z + 0.025))
    for z in np.arange(z1 - 0.62, z1 - 0.02, 0.045):
        with model.at(-0.045, 0, z, tilt=28):
            model.box("trim", (-0.022, y0 + 0.02, -0.001), (0.022, y1 - 0.02, 0.001))
    for y in np.linspace(y0 + 0.3, y1 - 0.3, 3):
        model.rod("paper", (-0.02, y, z1 - 0.64), (-0.02, y, z1), 0.003)
    # Curtains: folds are upright bars that overlap.
    model.rod("brass", (0.1, y0 - 0.55, z1 + 0.12), (0.1, y1 + 0.55, z1 + 0.12), 0.014)
    for side in (y0 - 0.48, y1 + 0.08):
        for i in range(9):
            radius = 0.03 + 0.008 * (i % 3)
            model.rod(
                "linen", (0.09 + 0.015 * (i % 2), side + 0.05 * i, 0.03), (0.1, side + 0.05 * i, z1 + 0.11), radius
            )
    model.panel((-2.2, -0.4, -0.6), (0, 6.8, 0), (0, 0, 3.8), s.texture(t.garden(10, 0.8, 0.4)), 2)
    # A second window behind the camera.
    model.panel((2.9, 0.01, 0.8), (-2.2, 0, 0), (0, 0, 1.4), (1.7, 1.8, 1.9))


def _sofa(model: s.Model) -> None:
    """Against the wall, its middle at the frame's origin, facing -y."""
    model.cushion("cloth", (0, -0.48, 0.27), (2.2, 0.9, 0.26), 0.8)
    model.cushion("cloth", (0, -0.12, 0.5), (2.2, 0.24, 0.72), 0.75)
    for side in (-1, 1):
        model.cushion("cloth", (1.06 * side, -0.46, 0.38), (0.2, 0.92, 0.5), 0.75)
        model.cushion("cloth", (0.49 * side, -0.52, 0.44), (0.96, 0.74, 0.18), 0.65)
        with model.at(0.49 * side, -0.28, 0.68, turn=90, tilt=-14):
            model.cushion("cloth", (0, 0, 0), (0.2, 0.92, 0.44), 0.6)
        for y in (-0.85, -0.1):
            model.rod("walnut", (0.98 * side, y, 0), (0.95 * side, y, 0.16), 0.018, 0.026)
    for x, y, turn, cloth in ((-0.78, -0.48, 68, "mustard"), (-0.42, -0.5, 98, "navy"), (0.76, -0.46, 112, "rust")):
        with model.at(x, y, 0.68, turn=turn, tilt=-24):
            model.cushion(cloth, (0, 0, 0), (0.16, 0.44, 0.42), 0.45)


def _bookcase(model: s.Model) -> None:
    """Against the wall, its middle at the frame's origin, open towards -y."""
    random = np.random.default_rng(11)
    half, deep, top, shelves = 0.62, 0.32, 2.15, np.linspace(0.08, 2.1, 6)
    for x in (-half, half):
        model.box("oak", (x - 0.015, -deep, 0), (x + 0.015, 0, top))
    model.box("oak", (-half, -0.01, 0), (half, 0, top))
    for z in shelves:
        model.box("oak", (-half, -deep, z - 0.012), (half, 0, z + 0.012))
    for row, z in enumerate(shelves[:-1] + 0.012):
        x, end = -half + 0.03, half - (0.42 if row in (1, 3) else 0.1)
        while x < end:
            thick, tall, reach = random.uniform(0.016, 0.05), random.uniform(0.2, 0.32), random.uniform(0.17, 0.24)
            front = -reach - 0.04
            model.box("books", (x, front, z), (x + thick, -0.04, z + tall))
            for band in (0.16, 0.8):
                model.box(
                    "paper",
                    (x + 0.002, front - 0.001, z + band * tall),
                    (x + thick - 0.002, front, z + (band + 0.03) * tall),
                )
            x += thick + 0.0015
    with model.at(0.36, -0.17, shelves[1] + 0.012):
        model.lathe("china", [(0, 0), (0.05, 0), (0.1, 0.08), (0.09, 0.16), (0.03, 0.22), (0.04, 0.27), (0.032, 0.27)])
    with model.at(0.38, -0.18, shelves[3] + 0.012):
        model.cushion("copper", (0, 0, 0.11), (0.22, 0.22, 0.22), 0)


def _table(model: s.Model) -> None:
    """A low walnut table with its middle at the frame's origin, laid for one."""
    model.box("walnut", (-0.62, -0.32, 0.37), (0.62, 0.32, 0.405))
    model.box("walnut", (-0.55, -0.26, 0.14), (0.55, 0.26, 0.155))
    for x in (-0.54, 0.54):
        for y in (-0.25, 0.25):
            model.rod("walnut", (1.06 * x, 1.06 * y, 0), (x, y, 0.37), 0.014, 0.024)
    for i, (book, turn) in enumerate((("navy", 8), ("mustard", -6), ("rust", 14))):
        with model.at(-0.36, 0.03, 0.405 + 0.034 * i, turn=turn):
            model.box(book, (-0.15, -0.11, 0), (0.15, 0.11, 0.003))
            model.box("paper", (-0.145, -0.105, 0.003), (0.147, 0.105, 0.029))
            model.box(book, (-0.15, -0.11, 0.029), (0.15, 0.11, 0.032))
    with model.at(0.06, -0.1, 0.406, turn=-16):
        for side in (-1, 1):
            with model.at(0, 0, 0.004, tilt=-4 * side):
                model.picture("page", (min(0, 0.2 * side), -0.14, 0.006), (0.2, 0, 0), (0, 0.28, 0))
                model.box("navy", (0, -0.145, -0.003), (0.205 * side, 0.145, 0))
    bowl = [(0, 0.012), (0.09, 0.02), (0.15, 0.08), (0.165, 0.14), (0.165, 0.14), (0.158, 0.14), (0.158, 0.14)]
    inside = [(0.143, 0.082), (0.086, 0.028), (0, 0.02)]
    with model.at(0.4, 0.12, 0.405):
        model.lathe("glass", [*bowl, *inside], sides=48)
        for x, y, z in ((0.03, 0.02, 0.065), (-0.05, 0.03, 0.07), (0, -0.05, 0.07), (-0.01, 0.01, 0.12)):
            model.cushion("mustard" if x < 0 else "clay", (x, y, z), (0.075, 0.075, 0.07), 0)
    with model.at(0.18, -0.22, 0.405):
        _mug(model)
    for i in range(14):
        model.box("books", (-0.5 + 0.028 * i, -0.2, 0.156), (-0.474 + 0.028 * i, 0.0, 0.156 + 0.03 * (i % 3) + 0.15))


def _mug(model: s.Model) -> None:
    outside = [(0, 0), (0.038, 0), (0.038, 0), (0.04, 0.09), (0.04, 0.09), (0.036, 0.09), (0.036, 0.09), (0.035, 0.01)]
    model.lathe("china", outside)
    model.lathe("soil", [(0, 0.075), (0.036, 0.075)])
    for i in range(8):
        a, b = (np.pi * (j / 8 - 0.5) for j in (i, i + 1))
        start, end = ((0.038 + 0.026 * np.cos(x), 0, 0.047 + 0.028 * np.sin(x)) for x in (a, b))
        model.rod("china", start, end, 0.005)


def _armchair(model: s.Model) -> None:
    """Facing the frame's -y."""
    with model.at(0, 0, 0.4, turn=90, tilt=-6):
        model.cushion("navy", (0, 0, 0), (0.66, 0.62, 0.17), 0.65)
    with model.at(0, 0.33, 0.72, turn=90, tilt=-16):
        model.cushion("navy", (0, 0, 0), (0.17, 0.62, 0.66), 0.6)
    for side in (-1, 1):
        x = 0.35 * side
        model.rod("oak", (x, -0.36, 0), (x, -0.32, 0.6), 0.02, 0.024)
        model.rod("oak", (x, 0.44, 0), (x, 0.36, 0.58), 0.02, 0.024)
        model.box("oak", (x - 0.03, -0.38, 0.59), (x + 0.03, 0.42, 0.62))
        model.rod("oak", (x, -0.34, 0.28), (x, 0.4, 0.28), 0.018)
    model.rod("oak", (-0.35, -0.34, 0.28), (0.35, -0.34, 0.28), 0.018)
    model.rod("oak", (-0.35, 0.4, 0.28), (0.35, 0.4, 0.28), 0.018)


def _plant(model: s.Model) -> None:
    """A rubber plant in a clay pot."""
    random = np.random.default_rng(3)
    pot = [(0, 0), (0.13, 0), (0.13, 0), (0.18, 0.3), (0.18, 0.3), (0.2, 0.3), (0.2, 0.36), (0.2, 0.36), (0.17, 0.36)]
    model.lathe("clay", pot)
    model.lathe("soil", [(0, 0.33), (0.19, 0.33)])
    for stem in range(4):
        lean = np.array([*random.uniform(-0.2, 0.2, 2), random.uniform(0.95, 1.4)])
        start = np.array([*random.uniform(-0.05, 0.05, 2), 0.3])
        model.rod("walnut", start, start + lean, 0.012, 0.005)
        for i in range(13):
            place = start + lean * (0.25 + 0.75 * i / 12)
            with model.at(*place, turn=137.5 * i + 40 * stem, tilt=random.uniform(-35, 25)):
                model.cushion("leaf", (0.15, 0, 0.0), (0.27, random.uniform(0.09, 0.13), 0.008), 0, detail=6)


def _floor_lamp(model: s.Model) -> None:
    base = [(0, 0), (0.14, 0), (0.14, 0), (0.14, 0.015), (0.14, 0.015), (0.02, 0.03), (0.012, 0.05), (0.012, 1.5)]
    model.lathe("brass", base)
    model.sphere(s.matte((0, 0, 0)), (0, 0, 1.62), 0.13, (13, 9.2, 5.4))


def _pictures(model: s.Model) -> None:
    wall = DEPTH - 0.004
    for name, x, z, wide, tall in (
        ("discs", 1.15, 1.3, 0.5, 0.66),
        ("hills", 1.83, 1.34, 0.84, 0.6),
        ("print", 2.85, 1.3, 0.5, 0.66),
    ):
        model.box("black", (x, wall - 0.025, z), (x + wide, wall, z + tall))
        model.sheet("paper", (x + 0.02, wall - 0.026, z + 0.02), (wide - 0.04, 0, 0), (0, 0, tall - 0.04))
        model.picture(name, (x + 0.08, wall - 0.027, z + 0.08), (wide - 0.16, 0, 0), (0, 0, tall - 0.16))
