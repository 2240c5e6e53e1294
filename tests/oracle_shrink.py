"""How much of a filtered frame the noise of its input explains, in float64 NumPy, written from the equations.

Images are (H, W, C), colours the first three channels, the half difference the fourth; exposed, of order 1.
"""

from __future__ import annotations

import numpy as np
from oracle import luminance

#: Means are taken over blocks of so many pixels squared.
BLOCK = 8


def relative_to(image: np.ndarray) -> np.ndarray:
    """c² + (0.03 Y)² + 1e-6 for each colour, Y the luminance: the square that noise and changes are relative to."""
    color = np.asarray(image, dtype=np.float64)[..., :3]
    return color**2 + (0.03 * luminance(color)[..., None]) ** 2 + 1e-6


def blocks(image: np.ndarray) -> list[list[np.ndarray]]:
    """The pixels of each block, (n, C); those at the right and at the bottom may be smaller."""
    height, width = image.shape[:2]
    return [
        [
            image[y : y + BLOCK, x : x + BLOCK].reshape(-1, image.shape[-1] if image.ndim == 3 else 1)
            for x in range(0, width, BLOCK)
        ]
        for y in range(0, height, BLOCK)
    ]


def block_mean(image: np.ndarray) -> np.ndarray:
    """The mean of each block, (rows of blocks, blocks, C)."""
    return np.array([[block.mean(axis=0) for block in row] for row in blocks(image)])


def around(means: np.ndarray) -> np.ndarray:
    """Means of 3x3 blocks weighted 1 2 1 both ways, the blocks at the edge repeated beyond it."""
    down, across = means.shape[:2]
    out = np.zeros(means.shape)
    for dy, dx in np.ndindex(3, 3):
        rows = np.clip(np.arange(down) + dy - 1, 0, down - 1)
        columns = np.clip(np.arange(across) + dx - 1, 0, across - 1)
        out += (2 - abs(dy - 1)) * (2 - abs(dx - 1)) / 16 * means[rows][:, columns]
    return out


def block_noise(frame: np.ndarray, variance: np.ndarray, quiet: bool = False) -> np.ndarray:
    """Σ V² / Σ V over a block, V the variance over `relative_to`, in [0, 1e12]; the largest of 3x3 blocks.

    The mean of V over the block where the frame is quiet.
    """
    relative = np.clip(np.asarray(variance, dtype=np.float64) / relative_to(frame), 0.0, 1e12)
    of_block = block_mean(relative)
    if not quiet:
        of_block = block_mean(relative**2) / (of_block + 1e-30)
    down, across = of_block.shape[:2]
    out = np.zeros(of_block.shape)
    for y, x in np.ndindex(down, across):
        out[y, x] = of_block[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].max(axis=(0, 1))
    return out


def block_shares(
    filtered: np.ndarray,
    frame: np.ndarray,
    variance: np.ndarray,
    disturbed: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """a = V (1 - t) / E (f - y)², less than 0.1 taken for 0 and the rest stretched to [0, 1], of each block and colour.

    V from `block_noise`; (f - y)² over the larger `relative_to` of the two frames; t = E d_f d_y / E d_y² in [0, 1],
    pixels over the larger Y² + 1e-3 of the two: the part of its input's noise that the filtered frame has; means from
    `around`.
    """
    filtered, frame = np.asarray(filtered, dtype=np.float64), np.asarray(frame, dtype=np.float64)
    change = (filtered - frame)[..., :3] ** 2 / np.maximum(relative_to(filtered), relative_to(frame))
    brighter = np.maximum(luminance(filtered[..., :3]) ** 2, luminance(frame[..., :3]) ** 2)
    d, d_filtered = frame[..., 3:], filtered[..., 3:]
    scale = brighter[..., None] + 1e-3
    if disturbed:
        d, d_filtered = (b - a[..., :3] for a, b in zip((frame, filtered), disturbed, strict=True))
        scale = np.maximum(relative_to(filtered), relative_to(frame))
    kept = around(block_mean(d * d_filtered / scale)) / (around(block_mean(d**2 / scale)) + 1e-30)
    noise = block_noise(frame, variance, quiet=disturbed is not None)
    best = noise * (1 - np.clip(kept, 0, 1)) / (around(block_mean(change)) + 1e-30)
    return np.clip((best - 0.1) / 0.9, 0, 1)


def between(shares: np.ndarray, height: int, width: int) -> np.ndarray:
    """Values at the centres of blocks brought to pixels, linear between them and constant beyond the last."""
    out = np.asarray(shares, dtype=np.float64)
    for axis, size in enumerate((height, width)):
        at = np.clip((np.arange(size) + 0.5) / BLOCK - 0.5, 0, out.shape[axis] - 1)
        low = np.floor(at).astype(int)
        high = np.minimum(low + 1, out.shape[axis] - 1)
        part = np.expand_dims(at - low, tuple(i for i in range(3) if i != axis))
        out = (1 - part) * out.take(low, axis) + part * out.take(high, axis)
    return out


def shrink_to_input(
    filtered: np.ndarray,
    frame: np.ndarray,
    variance: np.ndarray,
    share: np.ndarray,
    disturbed: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The colours y + a (f - y), the half difference as it was, and the input's share 1 - mean a (1 - s)."""
    filtered, frame = np.float64(filtered), np.float64(frame)
    a = between(block_shares(filtered, frame, variance, disturbed), *frame.shape[:2])
    out = filtered.copy()
    out[..., :3] = frame[..., :3] + a * (filtered - frame)[..., :3]
    return out, 1.0 - a.mean(axis=-1) * (1.0 - np.float64(share))
