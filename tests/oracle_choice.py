"""How much of a candidate image to mix into the current one, in float64 NumPy, from two halves of the samples.

An image here is (H, W, 2): its luminance l and its half difference d, so that the halves are l + d and l - d. A half
of the target holds noise that the other half of an image has not seen, and so tells which image is nearer to the
truth. Everything is relative to `scale`. Sharing nothing with the kernels.
"""

from __future__ import annotations

import numpy as np
from oracle_regression import wide_box_mean

#: Added to the squared difference of two images, so that equal ones can be divided by it.
LEAST_DIFFERENCE = 1e-11

#: Images as near as this, squared and relative, are taken for equal: the share goes to the prior.
DOUBTFUL_DIFFERENCE = 1e-10


def compare(
    current: np.ndarray,
    candidate: np.ndarray,
    target: np.ndarray,
    noise: np.ndarray,
    scale: np.ndarray,
    *,
    tracking: float,
    limit: float,
) -> tuple[np.ndarray, np.ndarray]:
    """(g, q) per pixel: half the squared error that the candidate saves, and the square of what it changes, (H, W).

    For the halves s = +1, -1: D_s = (l_w - l) + s (d_w - d) is the change of one half and
    r_s = (l_t - s d_t) - ((l + l_w) + s (d + d_w)) / 2 how far the other half of the target lies beyond the middle of
    the two. D_s r_s is half the error saved, (E - E_w) / 2, plus noise of mean 0; a half has d² more error than the
    whole image, so

        g = (tracking · noise + 1/2 Σ_s D_s clip(r_s, -b_s, b_s) + (d_w - d) d + (d_w - d)² / 2) / scale
        q = (l_w - l)² / scale

    with b_s = limit · sqrt(2 noise) + |D_s| / 2, `noise` the variance of the target and 2 noise that of its halves:
    r is ±D / 2 where one of the two is the truth.
    """
    (lum, d), (lum_w, d_w), (lum_t, d_t) = (
        np.moveaxis(np.asarray(image, dtype=np.float64), -1, 0) for image in (current, candidate, target)
    )
    noise, scale = np.asarray(noise, dtype=np.float64), np.asarray(scale, dtype=np.float64)
    bound = limit * np.sqrt(2.0 * noise)
    saved = np.zeros(lum.shape)
    for s in (1.0, -1.0):
        change = (lum_w - lum) + s * (d_w - d)
        beyond = (lum_t - s * d_t) - ((lum + lum_w) + s * (d + d_w)) / 2.0
        saved += change * np.clip(beyond, -bound - np.abs(change) / 2.0, bound + np.abs(change) / 2.0) / 2.0
    g = (tracking * noise + saved + (d_w - d) * d + (d_w - d) ** 2 / 2.0) / scale
    return g, (lum_w - lum) ** 2 / scale


def twice_box_mean(image: np.ndarray, radius: int) -> np.ndarray:
    """G: the mean over (2r+1)² pixels of the means over (2r+1)² pixels."""
    return wide_box_mean(wide_box_mean(image, radius), radius)


def share(
    g: np.ndarray,
    q: np.ndarray,
    *,
    radius: int,
    prior: float,
    doubt: float,
    margin: float,
    square: np.ndarray | None = None,
) -> np.ndarray:
    """The weight of the candidate in the mix, (H, W), in [0, 1].

    (1 - a) current + a candidate has the error E - 2 a (g + q / 2) + a² q, least at a = 1/2 + g / q. With
    gs = G(g), qs = G(q), sd = sqrt(max(G(g²) - gs², 0)), or `square`, if given, for g²:

        trust = 1 / (1 + ((doubt · sd + 1e-10) / (qs + 1e-11))²)
        a = clip(trust · (1/2 + (gs - margin · sd) / (qs + 1e-11)) + (1 - trust) · prior, 0, 1)
    """
    gs, qs = twice_box_mean(g, radius), twice_box_mean(q, radius) + LEAST_DIFFERENCE
    square = np.asarray(g, dtype=np.float64) ** 2 if square is None else square
    sd = np.sqrt(np.maximum(twice_box_mean(square, radius) - gs**2, 0.0))
    trust = 1.0 / (1.0 + ((doubt * sd + DOUBTFUL_DIFFERENCE) / qs) ** 2)
    return np.clip(trust * (0.5 + (gs - margin * sd) / qs) + (1.0 - trust) * prior, 0.0, 1.0)


def believed(current: np.ndarray, candidate: np.ndarray, apart: float) -> np.ndarray:
    """By what a share is multiplied where the two lie far apart, (H, W).

    clip(2 - |y - x| / (apart (max(min(x, y), 0) + 0.01)), 0, 1), x and y the luminances of current and candidate.
    """
    x, y = current[..., 0], candidate[..., 0]
    return np.clip(2.0 - np.abs(y - x) / (apart * (np.maximum(np.minimum(x, y), 0.0) + 0.01)), 0.0, 1.0)


def estimated_error(
    current: np.ndarray, target: np.ndarray, share: np.ndarray, scale: np.ndarray, *, radius: int
) -> np.ndarray:
    """The squared error over `scale` of (1 - h) current + h target, the target being the noisy input, (H, W).

    The input's noise is N = G(d_t² / scale). With g and q of `compare` without a limit, the input as the candidate,
    current has E = N + 2 G(g), but at least the variance it has left, G(d² / scale); and the mix, h the share,
    (1 - h) E + h N - h (1 - h) G(q), at least 0.
    """
    g, q = compare(current, target, target, np.ones(scale.shape), scale, tracking=0.0, limit=np.inf)
    noise, left = (twice_box_mean(image[..., 1] ** 2 / scale, radius) for image in (target, current))
    error = np.maximum(noise + 2.0 * twice_box_mean(g, radius), left)
    h = share
    return np.maximum((1.0 - h) * error + h * noise - h * (1.0 - h) * twice_box_mean(q, radius), 0.0)
