"""A frame whose samples are known one by one, so that its halves and variances are those of its own noise."""

from __future__ import annotations

import inputs
import numpy as np

SPP = 16
#: A sample's light is the truth times a gamma variate of mean 1 with this shape: most are dark, a few bright.
SHAPE = 1.0
#: Standard deviation of a sample of each feature.
FEATURE_NOISE = {"albedo": 0.04, "normal": 0.1, "depth": 0.05}
FEATURES = tuple(FEATURE_NOISE)


def sampled(height: int, width: int, seed: int = 0) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Every plane of a `Frame` by name, and the truth (H, W, 3): the room of `inputs.features`, without fireflies."""
    rng = np.random.default_rng([seed, height, width])
    scene = inputs.features(height, width, noise=0.0)
    samples = {"color": scene["color"] * rng.gamma(SHAPE, 1 / SHAPE, (SPP, height, width, 1))}
    for name, noise in FEATURE_NOISE.items():
        samples[name] = scene[name] + noise * rng.standard_normal((SPP, *scene[name].shape))
    planes = {}
    for name, values in samples.items():
        planes[name], planes[f"{name}_variance"] = values.mean(0), values.var(0, ddof=1) / SPP
    planes["color_a"], planes["color_b"] = samples["color"][::2].mean(0), samples["color"][1::2].mean(0)
    return {name: plane.astype(np.float32) for name, plane in planes.items()}, scene["color"]


def relative_error(image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
    """relMSE, over some of the pixels if `where` (H, W) is given."""
    errors = ((image.astype(np.float64) - truth) ** 2 / (truth.astype(np.float64) ** 2 + 0.01)).mean(-1)
    return float(errors.mean() if where is None else errors[where].mean())
