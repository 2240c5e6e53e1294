"""An entrance hall with a wooden staircase: turned balusters before a flowered wallpaper, a glazed door, bare bulbs.

The balusters are thinner than a patch and repeat in front of a texture that repeats as well, so a non-local filter
finds many false friends. The sun falls through the door's panes onto glossy chequered stone, where hard shadows, tile
joints and the door's reflection cross on one flat plane. Two windows out of sight and light that bounced do the rest;
three small bulbs are seen directly, and a glass vase and a round mirror show parts of the hall twice.
"""

import numpy as np

from . import _shapes as s
from . import _textures as t

LEFT, RIGHT, FRONT, BACK, HEIGHT = -0.7, 6.5, -3.0, 4.2, 4.3
STEPS, RISE, GOING = 15, 0.178, 0.26
FOOT, SIDE = 1.75, 3.1  # where the first riser stands (x), and the open side of the flight (y)
DOOR = (-0.25, 0.85, 2.15)  # x from, x to, height; above it a fanlight up to 2.75


def build(width: int, height: int) -> dict:
    """The scene as `mi.load_dict` takes it, filmed at width x height pixels."""
    model = s.Model(
        floor=s.varnish(s.texture(t.checker("2f3133", "ded8cb", 3), (0.9, 0.9)), 0.07),
        paper=s.matte(s.texture(t.wallpaper("d9cfae", "6f8f74", "b9a878"), (0.42, 0.42))),
        wall=s.matte(t.rgb("e2dccb")),
        ceiling=s.matte(t.rgb("efece4")),
        trim=s.varnish(t.rgb("e9e5da"), 0.15),
        oak=s.varnish(s.texture(t.wood("6a3f20", "b27b48", 5), (1.5, 0.35)), 0.12),
        dark=s.varnish(s.texture(t.wood("2e1a10", "6a4427", 9), (1.5, 0.35)), 0.1),
        carpet=s.matte(s.texture(t.weave("7e2a26", 0.35, 4), (0.1, 0.1))),
        edge=s.matte(s.texture(t.weave("c2a15c", 0.3, 6), (0.1, 0.1))),
        rug=s.matte(s.texture(t.rug("27384a", "a5392f", "d8b873"))),
        hills=s.matte(s.texture(t.hills(7))),
        discs=s.matte(s.texture(t.discs(12))),
        letter=s.matte(s.texture(t.script("3a2c22", "eee3c6", 12, 8))),
        print=s.matte(s.texture(t.discs(8))),
        mount=s.matte(t.rgb("efe9da")),
        books=s.varnish(s.texture(t.palette("6d2b26", "2c4a63", "c39a3c", "48634b", "e3dac4"), (64, 64)), 0.3),
        leaf=s.varnish(t.rgb("4d7a3c"), 0.25),
        petal=s.matte(t.rgb("e9d7d0")),
        clay=s.varnish(t.rgb("35566b"), 0.06),
        soil=s.matte(t.rgb("2b211b")),
        coat=s.matte(s.texture(t.weave("3d4a58", 0.3, 3), (0.12, 0.12))),
        brass=s.metal("Au", 0.18),
        mirror={"type": "conductor", "material": "Ag"},
        glass=s.glass(),
    )
    _shell(model)
    _door(model)
    _stairs(model)
    _balustrade(model)
    _pictures(model)
    with model.at(4.72, SIDE - 0.24):
        _console(model)
    with model.at(1.25, BACK - 0.34):
        _palm(model)
    with model.at(LEFT + 0.24, BACK - 0.3):
        _umbrellas(model)
    with model.at(3.15, 0.75, 0.012, turn=-2):
        model.picture("rug", (0, 0, 0), (2.5, 0, 0), (0, 1.5, 0))
    for x, y, z in ((2.3, 1.0, 2.42), (2.72, 1.2, 2.2), (2.52, 1.5, 2.62)):
        model.rod("soil", (x, y, z + 0.06), (x, y, HEIGHT), 0.004)
        model.lathe("brass", [(0, 0.12), (0.02, 0.12), (0.02, 0.12), (0.024, 0.045)], (x, y, z), sides=16)
        model.sphere(s.matte((0, 0, 0)), (x, y, z), 0.06, (26, 17.5, 9.5))
    model.sun((0.36, -1.0, -0.9), (10, 8.7, 6.5))
    return model.finish((3.75, -2.55, 1.5), (2.5, 3.6, 1.42), 62, (width, height))


def _shell(model: s.Model) -> None:
    wide, deep = RIGHT - LEFT, BACK - FRONT
    x0, x1, _ = DOOR
    model.sheet("floor", (LEFT, FRONT, 0), (wide, 0, 0), (0, deep, 0))
    model.sheet("ceiling", (LEFT, BACK, HEIGHT), (wide, 0, 0), (0, -deep, 0))
    model.sheet("wall", (RIGHT, FRONT, 0), (-wide, 0, 0), (0, 0, HEIGHT))
    model.sheet("wall", (RIGHT, BACK, 0), (0, -deep, 0), (0, 0, HEIGHT))
    model.sheet("paper", (LEFT, FRONT, 0), (0, deep, 0), (0, 0, HEIGHT))
    for low, high, bottom in ((LEFT, x0, 0), (x0, x1, 2.75), (x1, RIGHT, 0)):
        model.sheet("paper", (low, BACK, bottom), (high - low, 0, 0), (0, 0, HEIGHT - bottom))
    for low, high in ((LEFT, x0 - 0.1), (x1 + 0.1, FOOT)):
        _wainscot(model, low, high)
    model.box("trim", (LEFT, FRONT, 0), (LEFT + 0.02, BACK, 0.16))
    # Two windows out of sight: one over the upper landing, one behind the camera.
    model.panel((RIGHT - 0.01, BACK, 2.95), (0, SIDE - BACK, 0), (0, 0, 1.25), (9, 10, 11.5))
    model.panel((5.7, FRONT + 0.01, 1.0), (-2.4, 0, 0), (0, 0, 1.7), (2.2, 2.3, 2.5))


def _wainscot(model: s.Model, low: float, high: float) -> None:
    y = BACK - 0.02
    model.box("trim", (low, y, 0), (high, BACK, 0.92))
    model.box("trim", (low, y - 0.03, 0.92), (high, BACK, 0.97))
    model.box("trim", (low, y - 0.015, 0), (high, y, 0.16))
    count = max(1, round((high - low) / 0.45))
    for x in np.linspace(low, high, count + 1):
        model.box("trim", (x - 0.04, y - 0.012, 0.16), (x + 0.04, y, 0.92))
    model.box("trim", (low, y - 0.012, 0.84), (high, y, 0.92))


def _door(model: s.Model) -> None:
    """A glazed double door with a fanlight; beyond it the garden."""
    x0, x1, top = DOOR
    middle = (x0 + x1) / 2
    for x in (x0 - 0.1, x1):
        model.box("trim", (x, BACK - 0.05, 0), (x + 0.1, BACK + 0.22, 2.85))
    model.box("trim", (x0 - 0.1, BACK - 0.05, 2.75), (x1 + 0.1, BACK + 0.22, 2.88))
    model.box("trim", (x0 - 0.14, BACK - 0.08, 2.88), (x1 + 0.14, BACK, 2.93))
    model.box("oak", (x0, BACK + 0.08, top), (x1, BACK + 0.14, top + 0.07))
    model.box("oak", (x0, BACK - 0.02, 0), (x1, BACK + 0.2, 0.02))
    for low, high in ((x0, middle), (middle, x1)):
        for left, right in ((low, low + 0.07), (high - 0.07, high)):
            model.box("oak", (left, BACK + 0.09, 0), (right, BACK + 0.13, top))
        for bottom, upper in ((0.02, 0.6), (top - 0.09, top)):
            model.box("oak", (low + 0.07, BACK + 0.09, bottom), (high - 0.07, BACK + 0.13, upper))
        model.box("oak", ((low + high) / 2 - 0.012, BACK + 0.1, 0.6), ((low + high) / 2 + 0.012, BACK + 0.12, top))
        for z in np.linspace(0.6, top - 0.09, 5)[1:-1]:
            model.box("oak", (low + 0.07, BACK + 0.1, z - 0.012), (high - 0.07, BACK + 0.12, z + 0.012))
    model.rod("brass", (middle + 0.05, BACK + 0.04, 1.0), (middle + 0.05, BACK + 0.04, 1.24), 0.011)
    hub = (middle, BACK + 0.11, top + 0.07)
    for angle in np.radians(np.arange(0, 181, 30)):
        model.rod("oak", hub, (hub[0] + 0.55 * np.cos(angle), hub[1], hub[2] + 0.53 * np.sin(angle)), 0.011)
    model.box("soil", (x0 - 1.5, BACK + 0.22, -0.06), (x1 + 1.5, BACK + 1.4, -0.02))
    model.panel((-4, BACK + 1.9, -0.8), (8.6, 0, 0), (0, 0, 3.9), s.texture(t.garden(6.5, 0.7, 0.42, 6)), 1)


def _stairs(model: s.Model) -> None:
    for i in range(STEPS):
        x, z = FOOT + i * GOING, i * RISE
        model.box("trim", (x, SIDE + 0.03, z), (x + 0.015, BACK, z + RISE - 0.03))
        model.box("oak", (x - 0.03, SIDE - 0.03, z + RISE - 0.03), (x + GOING + 0.015, BACK, z + RISE))
        # The runner: carpet down the riser and over the nosing, with a border on either side.
        for name, low, high in (
            ("edge", SIDE + 0.2, SIDE + 0.25),
            ("carpet", SIDE + 0.25, BACK - 0.17),
            ("edge", BACK - 0.17, BACK - 0.12),
        ):
            model.box(name, (x - 0.036, low, z + RISE - 0.03), (x + GOING, high, z + RISE + 0.006))
            model.box(name, (x - 0.006, low, z), (x, high, z + RISE - 0.03))
        model.box("trim", (x + 0.004, SIDE, 0), (x + GOING / 2 - 0.004, SIDE + 0.02, z + RISE - 0.06))
        model.box("trim", (x + GOING / 2 + 0.004, SIDE, 0), (x + GOING - 0.004, SIDE + 0.02, z + RISE - 0.06))
        model.box("trim", (x, SIDE - 0.012, z), (x + 0.02, SIDE + 0.02, z + RISE - 0.03))
    end, top = FOOT + STEPS * GOING, STEPS * RISE
    model.box("oak", (end, FRONT + 4.9, top - 0.22), (RIGHT, BACK, top))
    model.box("trim", (FOOT, SIDE - 0.01, 0), (end, SIDE + 0.01, 0.1))
    slope = np.degrees(np.arctan2(RISE, GOING))
    with model.at(FOOT, 0, -0.16, tilt=-slope):
        model.box("dark", (0.2, SIDE - 0.02, -0.02), (STEPS * np.hypot(RISE, GOING), SIDE + 0.01, 0.05))


def _balustrade(model: s.Model) -> None:
    turned = [
        *((0.017, 0), (0.017, 0.1), (0.017, 0.1), (0.021, 0.105), (0.021, 0.125), (0.012, 0.14), (0.019, 0.24)),
        *((0.021, 0.3), (0.016, 0.44), (0.011, 0.58), (0.018, 0.6), (0.018, 0.62), (0.011, 0.64), (0.013, 0.92)),
    ]
    rail = 0.86
    for i in range(STEPS):
        for part in (0.22, 0.72):
            x, z = FOOT + (i + part) * GOING, (i + 1) * RISE
            # The rail climbs while the tread is level: the second baluster of a tread is longer.
            reach = rail + (part - 0.22) * RISE - 0.02
            profile = [(r, h * reach / 0.92) for r, h in turned]
            model.lathe("trim", profile, (x, SIDE + 0.03, z), sides=14)
    slope = np.degrees(np.arctan2(RISE, GOING))
    length = STEPS * np.hypot(RISE, GOING)
    with model.at(FOOT, SIDE + 0.03, RISE * 0.8 + rail, tilt=-slope):
        model.box("dark", (-0.02, -0.022, -0.012), (length, 0.022, 0.0))
        model.rod("dark", (-0.02, 0, 0.018), (length, 0, 0.018), 0.033)
    for x, z in ((FOOT - 0.05, 0.0), (FOOT + STEPS * GOING + 0.02, STEPS * RISE)):
        with model.at(x, SIDE + 0.03, z):
            model.box("dark", (-0.055, -0.055, 0), (0.055, 0.055, 0.42))
            post = [(0.05, 0.42), (0.055, 0.45), (0.03, 0.48), (0.045, 0.62), (0.05, 0.7), (0.03, 0.86), (0.05, 0.9)]
            model.lathe("dark", post)
            model.box("dark", (-0.05, -0.05, 0.9), (0.05, 0.05, 1.14))
            model.lathe("dark", [(0.065, 1.14), (0.065, 1.16), (0.065, 1.16), (0.03, 1.175), (0.028, 1.19)])
            model.cushion("dark", (0, 0, 1.24), (0.12, 0.12, 0.12), 0)


def _pictures(model: s.Model) -> None:
    frames = (
        ("hills", 2.15, 0.62, 0.5),
        ("letter", 3.1, 0.42, 0.55),
        ("discs", 3.9, 0.5, 0.5),
        ("print", 4.75, 0.44, 0.58),
    )
    for name, x, wide, tall in frames:
        z = (x - FOOT) / GOING * RISE + 1.45
        model.box("dark", (x - 0.04, BACK - 0.035, z - 0.04), (x + wide + 0.04, BACK, z + tall + 0.04))
        model.box("brass", (x - 0.012, BACK - 0.038, z - 0.012), (x + wide + 0.012, BACK, z + tall + 0.012))
        model.sheet("mount", (x, BACK - 0.039, z), (wide, 0, 0), (0, 0, tall))
        model.picture(name, (x + 0.06, BACK - 0.04, z + 0.06), (wide - 0.12, 0, 0), (0, 0, tall - 0.12))


def _console(model: s.Model) -> None:
    """A narrow table under the flight with a mirror over it; the frame's +y is the panelling behind."""
    model.box("dark", (-0.55, -0.17, 0.76), (0.55, 0.2, 0.79))
    model.box("dark", (-0.5, -0.14, 0.64), (0.5, 0.19, 0.76))
    for x in (-0.48, 0.48):
        for y in (-0.13, 0.17):
            model.rod("dark", (x, y, 0), (x, y, 0.66), 0.014, 0.026)
    for x in (-0.25, 0.25):
        model.cushion("brass", (x, -0.155, 0.7), (0.03, 0.03, 0.03), 0)
    with model.at(0.02, 0.215, 1.36, turn=90, tilt=-90):
        model.lathe("brass", [(0.3, 0.0), (0.33, 0.0), (0.35, 0.015), (0.33, 0.03), (0.3, 0.03)], sides=64)
        model.lathe("mirror", [(0.305, 0.02), (0, 0.02)], sides=64)
    with model.at(-0.3, 0, 0.79):
        _vase(model)
    for i in range(4):
        with model.at(0.3, 0.0, 0.79 + 0.028 * i, turn=9 * (i % 2) - 4 * i):
            model.box("books", (-0.12, -0.09, 0), (0.12, 0.09, 0.0265))
    model.lathe(
        "clay",
        [(0, 0), (0.03, 0), (0.075, 0.035), (0.08, 0.05), (0.072, 0.05), (0.03, 0.012), (0, 0.01)],
        (0.3, 0, 0.903),
    )


def _vase(model: s.Model) -> None:
    outside = [(0, 0), (0.05, 0), (0.075, 0.06), (0.07, 0.13), (0.042, 0.2), (0.055, 0.26), (0.055, 0.26)]
    inside = [(0.05, 0.26), (0.05, 0.26), (0.037, 0.2), (0.063, 0.13), (0.067, 0.06), (0.044, 0.014), (0, 0.014)]
    model.lathe("glass", [*outside, *inside], sides=48)
    random = np.random.default_rng(5)
    for i in range(7):
        lean = np.array([*random.uniform(-0.16, 0.16, 2), random.uniform(0.42, 0.58)])
        foot = np.array([-0.1, -0.1, 0]) * lean + np.array([0, 0, 0.03])
        model.rod("leaf", foot, lean, 0.003)
        for j in range(8):
            with model.at(*lean, turn=45 * j + 11 * i, tilt=-28):
                model.cushion("petal", (0.032, 0, 0), (0.06, 0.03, 0.006), 0, detail=6)
        model.cushion("edge", lean + np.array([0, 0, 0.006]), (0.026, 0.026, 0.016), 0)


def _umbrellas(model: s.Model) -> None:
    """A brass stand with two umbrellas and a stick."""
    model.lathe(
        "brass", [(0, 0), (0.1, 0), (0.1, 0), (0.12, 0.46), (0.12, 0.46), (0.113, 0.46), (0.113, 0.46), (0.094, 0.02)]
    )
    for cloth, turn in (("coat", 20), ("carpet", 170)):
        with model.at(turn=turn, tilt=7):
            model.lathe(cloth, [(0.01, 0.02), (0.05, 0.5), (0.045, 0.68), (0.008, 0.74)], sides=12)
            model.rod("dark", (0, 0, 0.7), (0, 0, 0.9), 0.01)
    model.rod("dark", (0.02, -0.03, 0.02), (-0.09, -0.07, 0.92), 0.009)


def _palm(model: s.Model) -> None:
    model.lathe("clay", [(0, 0), (0.13, 0), (0.17, 0.16), (0.16, 0.3), (0.18, 0.34), (0.18, 0.34), (0.15, 0.34)])
    model.lathe("soil", [(0, 0.31), (0.165, 0.31)])
    random = np.random.default_rng(9)
    for i in range(15):
        heading, rise = 137.5 * i, random.uniform(0.55, 1.15)
        arc = np.linspace(0, 1, 9)
        reach, high = 0.55 * arc**1.4, 0.32 + rise * (arc - 0.32 * arc**2.6)
        with model.at(turn=heading):
            for k in range(8):
                start, end = (reach[k], 0, high[k]), (reach[k + 1], 0, high[k + 1])
                model.rod("leaf", start, end, 0.005)
                for side in (-1, 1):
                    if k < 2:
                        continue
                    with model.at(*start, turn=62 * side, tilt=18):
                        model.cushion("leaf", (0.1, 0, 0), (0.2 - 0.012 * k, 0.026, 0.004), 0, detail=6)
