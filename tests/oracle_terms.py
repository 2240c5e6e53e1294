"""The terms of a regression in float64 NumPy: which features, and which of their principal components, serve a block.

A block is 32x8 pixels, cut off at the right and bottom edges; what lies around it is mirrored as in `oracle`. Source:
Moon, Carr, Yoon, "Adaptive Rendering Based on Weighted Local Regression", 2014 (there, for each pixel).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from oracle import reflect_index

#: The columns and rows of the blocks that share their terms.
BLOCK_COLUMNS, BLOCK_ROWS = 32, 8

#: A feature serves a block where its variance is above this ...
LEAST_VARIANCE = 1e-8

#: ... and above this many times the variance of its own noise; a component likewise, ...
LEAST_SIGNAL = 2.0

#: ... above this many times the variance of the noise along it.
LEAST_DIRECTION = 0.5

#: Likewise, with this part of the variance of all components.
LEAST_PART = 1e-5


class Terms(NamedTuple):
    """For each pixel what its block uses: mean (H, W, F), used (H, W, F), variance (H, W, F), direction (H, W, F, F).

    used says it of the features; variance[k] and direction[k] are those of component k, the largest variance first,
    both 0 where the component is left out.
    """

    mean: np.ndarray
    used: np.ndarray
    variance: np.ndarray
    direction: np.ndarray


def components(covariance: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of C (F, F) and the mean noise (F,) of a block: features used (F,), variances (F,), directions (F, F).

    A feature is used where C_qq > 1e-8 and C_qq > 2 n_q; the rows and columns of the others become 0. With that
    C = Σ λ_k v_k v_kᵀ, component k is used where λ_k > 1e-8, λ_k > 1e-5 Σ_j λ_j and λ_k > Σ_q v_kq² n_q / 2.
    """
    own = np.diag(covariance)
    used = (own > LEAST_VARIANCE) & (own > LEAST_SIGNAL * noise)
    variance, vectors = np.linalg.eigh(np.where(used[:, None] & used, covariance, 0.0))
    variance, vectors = variance[::-1], vectors.T[::-1]
    least = max(LEAST_VARIANCE, LEAST_PART * variance.sum())
    carries = (variance > least) & (variance > LEAST_DIRECTION * (vectors**2 @ noise))
    return used, np.where(carries, variance, 0.0), np.where(carries[:, None], vectors, 0.0)


def statistics_of_blocks(
    features: np.ndarray, noise: np.ndarray, reach: int
) -> Iterator[tuple[tuple[slice, slice], np.ndarray, np.ndarray, np.ndarray]]:
    """For each block: where it is, the mean and C of it and `reach` pixels around, the mean noise of its own pixels.

    A block at the right or the bottom edge counts whole, filled up with mirrored pixels, but for the noise.
    """
    height, width, count = features.shape
    for y0 in range(0, height, BLOCK_ROWS):
        for x0 in range(0, width, BLOCK_COLUMNS):
            rows = reflect_index(np.arange(y0 - reach, y0 + BLOCK_ROWS + reach), height)
            columns = reflect_index(np.arange(x0 - reach, x0 + BLOCK_COLUMNS + reach), width)
            region = features[rows][:, columns].reshape(rows.size * columns.size, count)
            mean = region.mean(axis=0)
            block = np.s_[y0 : y0 + BLOCK_ROWS, x0 : x0 + BLOCK_COLUMNS]
            yield block, mean, (region - mean).T @ (region - mean) / len(region), noise[block].mean(axis=(0, 1))


def terms_of_blocks(features: np.ndarray, noise: np.ndarray, reach: int) -> Terms:
    """What carries something in the block of every pixel and `reach` pixels around."""
    features, noise = np.asarray(features, dtype=np.float64), np.asarray(noise, dtype=np.float64)
    shape, count = features.shape, features.shape[-1]
    terms = Terms(np.zeros(shape), np.zeros(shape, dtype=bool), np.zeros(shape), np.zeros((*shape, count)))
    for block, mean, covariance, left in statistics_of_blocks(features, noise, reach):
        for plane, value in zip(terms, (mean, *components(covariance, left)), strict=True):
            plane[block] = value
    return terms
