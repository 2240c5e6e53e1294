"""Short sequences of the room of `inputs.features`: frames that show parts of a larger picture, each with noise of its
own, and the truth."""

from __future__ import annotations

import inputs
import numpy as np

from mcdenoise_cl import Frame

NOISE = {"albedo": 0.02, "normal": 0.05, "depth": 0.02}
MARGIN = 8


def planes_at(
    height: int,
    width: int,
    move: tuple[int, int] = (0, 0),
    seed: int = 0,
    spp: int = 8,
    light: float = 1.0,
    margin: int = MARGIN,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Every plane of a frame that sees the room `move` = (right, down) pixels further on, and the truth (H, W, 3).

    `light` times as bright; `margin` pixels of the room lie around. Samples are gamma variates, so halves and variances
    are those of the frame's own noise.
    """
    rng = np.random.default_rng([seed, height, width])
    room = inputs.features(height + 2 * margin, width + 2 * margin, seed=4, noise=0.0)
    top, left = margin + move[1], margin + move[0]
    scene = {name: plane[top : top + height, left : left + width] for name, plane in room.items()}
    scene["color"] = light * scene["color"]
    samples = {"color": scene["color"] * rng.gamma(2.0, 0.5, (spp, height, width, 1))}
    for name, noise in NOISE.items():
        samples[name] = scene[name] + noise * rng.standard_normal((spp, *scene[name].shape))
    planes = {}
    for name, values in samples.items():
        planes[name], planes[f"{name}_variance"] = values.mean(0), values.var(0, ddof=1) / spp
    planes["color_a"], planes["color_b"] = samples["color"][::2].mean(0), samples["color"][1::2].mean(0)
    return {name: plane.astype(np.float32) for name, plane in planes.items()}, scene["color"]


def frame_at(*arguments, names: tuple[str, ...] | None = None, **options) -> Frame:
    """The same as a `Frame`, of all planes or of `color` and those named."""
    planes, _ = planes_at(*arguments, **options)
    return Frame(**{name: plane for name, plane in planes.items() if names is None or name in ("color", *names)})
