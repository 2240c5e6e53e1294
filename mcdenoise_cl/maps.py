"""Pictures of what `auto` found: which candidate it used where, and how far off the result may be."""

from __future__ import annotations

import numpy as np

from .details import Denoised
from .errors import ParameterError
from .pictures import side_by_side

#: One colour a candidate, brighter from the simplest to the widest, so that they are told apart without colour vision
#: too (four steps of the scale viridis).
PALETTE = np.array([(68, 1, 84), (49, 104, 142), (53, 183, 121), (253, 231, 37)], np.uint8)

#: Relative squared errors shown as black and as white.
LEAST_ERROR, MOST_ERROR = 1e-4, 1.0


def model_picture(model_map: np.ndarray) -> np.ndarray:
    """(H, W) of indices into the candidates to (H, W, 3) uint8.

    Example:
        >>> model_picture(np.array([[0, 3]]))[0, 1].tolist()
        [253, 231, 37]
    """
    return PALETTE[model_map]


def error_picture(error_map: np.ndarray) -> np.ndarray:
    """(H, W) of relative squared errors to (H, W, 3) uint8, logarithmic: 1e-4 and less is black, 1 and more white.

    Example:
        >>> error_picture(np.array([[0.0, 1e-2, 5.0]]))[0, :, 0].tolist()
        [0, 128, 255]
    """
    level = np.log(np.clip(error_map, LEAST_ERROR, MOST_ERROR) / LEAST_ERROR) / np.log(MOST_ERROR / LEAST_ERROR)
    return np.repeat(np.rint(255 * level).astype(np.uint8)[..., None], 3, axis=2)


def map_sheet(result: Denoised) -> np.ndarray:
    """The image's two maps in one labelled picture, (H', W', 3) uint8.

    Raises:
        ParameterError: the method has no maps.
    """
    if result.model_map is None or result.error_map is None:
        raise ParameterError(f"method {result.report.method} has no maps: use auto")
    names = ", ".join(f"{name} {100 * share:.0f} %" for name, share in result.report.shares.items())
    pictures = {"model": model_picture(result.model_map), "error": error_picture(result.error_map)}
    labels = {
        "model": f"used most, from dark to bright:\n{names}",
        "error": f"estimated relMSE, from {LEAST_ERROR:g} to {MOST_ERROR:g}\nmean {result.report.estimated_error:.2g}",
    }
    return side_by_side(pictures, labels=labels)
