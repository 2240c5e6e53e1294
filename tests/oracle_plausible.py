"""How far a filtered frame may lie from its input, in float64 NumPy, written from the equations.

Images are (H, W, C), colours the first three channels; exposed, so that they are of order 1.
"""

from __future__ import annotations

import numpy as np
from oracle import luminance, neighbours

#: Noise is looked for in blocks of so many pixels squared.
BLOCK = 8


def relative_to(image: np.ndarray) -> np.ndarray:
    """c² + (0.03 Y)² + 1e-6 for each colour, Y the luminance: the square that noise and changes are relative to."""
    color = np.asarray(image, dtype=np.float64)[..., :3]
    return color**2 + (0.03 * luminance(color)[..., None]) ** 2 + 1e-6


def noise_around(color: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The largest of variance / `relative_to`, at least 0, in the block of each pixel and the eight around it."""
    relative = np.maximum(np.asarray(variance, dtype=np.float64) / relative_to(color), 0.0)
    out = np.empty(relative.shape)
    for y, x in np.ndindex(relative.shape[:2]):
        top, left = (y // BLOCK - 1) * BLOCK, (x // BLOCK - 1) * BLOCK
        region = relative[max(top, 0) : top + 3 * BLOCK, max(left, 0) : left + 3 * BLOCK]
        out[y, x] = region.max(axis=(0, 1))
    return out


def distances(filtered: np.ndarray, frame: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The largest (filtered - frame)² / (noise · scale + 1e-30) of the colours, (H, W).

    The scale is the larger `relative_to` of both frames, the noise that around.
    """
    change = np.float64(filtered)[..., :3] - np.float64(frame)[..., :3]
    scale = np.maximum(relative_to(filtered), relative_to(frame))
    return (change**2 / (noise_around(frame, variance) * scale + 1e-30)).max(axis=-1)


def keep_plausible(
    filtered: np.ndarray, frame: np.ndarray, variance: np.ndarray, share: np.ndarray, likely: float
) -> tuple[np.ndarray, np.ndarray]:
    """The filtered frame where it is near its input, and the input's share in it: (image, share).

    T = max(mean d, max d / 5) / likely over 5x5 pixels of `distances`, mirrored at the frame's edge; of the filtered
    frame stays k = 3 - 2 T, between 0 and 1. What was the input before (the share s) stays so: the share becomes
    1 - k (1 - s).
    """
    filtered, frame = np.float64(filtered), np.float64(frame)
    moved = neighbours(distances(filtered, frame, variance), 2)
    worst = np.maximum(moved.mean(axis=0), moved.max(axis=0) / 5.0) / likely
    kept = np.clip(3.0 - 2.0 * worst, 0.0, 1.0)
    return frame + kept[..., None] * (filtered - frame), 1.0 - kept * (1.0 - np.float64(share))
