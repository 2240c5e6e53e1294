"""How far an image is from its reference: PSNR, MSE, relMSE, SSIM and FLIP.

Images are (H, W, 3), scene-linear, of any float dtype; everything is computed in float64. `exposure` scales them to
where 1 is display white. PSNR, MSE, SSIM and FLIP look at the displayed picture, `tonemap(image, exposure)`;
relMSE looks at the linear values. Unless said otherwise, these functions raise

- `FrameError` for a shape or dtype that cannot be used, sizes that differ, or pixels that are not finite: a metric
  that skipped or zeroed them would hide a failure;
- `ParameterError` for an exposure that is not a positive number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from numbers import Real
from typing import Any

import numpy as np
import pyopencl.array as cl_array

from .errors import FrameError, McdenoiseError, ParameterError
from .frame import Frame

#: Added to the squared reference of relMSE, in units of display white squared: dark pixels do not take over the mean.
RELMSE_EPSILON = 0.01
#: Fraction of pixels that `Scores.relmse_trimmed` leaves out.
TRIM = 0.001
#: Width of the Gaussian window of SSIM, in pixels.
SSIM_WINDOW = 11
#: Luminance of linear RGB with Rec. 709 primaries.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Scores:
    """What `compare` returns.

    Attributes:
        psnr: dB, higher is better, inf for equal pictures.
        mse: mean squared error of the tonemapped images, in [0, 1].
        relmse: relative squared error of the linear values, 0 or more; against two halves of a reference it is
            unbiased, so one that is lost in the reference's noise can come out slightly negative.
        relmse_trimmed: the same without the 0.1 % of pixels largest in magnitude.
        ssim: in [-1, 1], higher is better; None without scikit-image or for an image smaller than 11 x 11.
        flip: in [0, 1], lower is better; None without flip-evaluator.
    """

    psnr: float
    mse: float
    relmse: float
    relmse_trimmed: float
    ssim: float | None = None
    flip: float | None = None


def compare(image: Any, reference: Frame, exposure: float | None = None) -> Scores:
    """All scores of an image against a reference frame.

    Args:
        image: (H, W, 3), scene-linear.
        reference: a frame of the same size. Its `color_a` and `color_b`, two independent halves of a reference that
            still holds noise, are used for relMSE when present.
        exposure: as everywhere here; `frame_exposure(reference)` when None.

    Example:
        >>> truth = Frame(np.full((16, 16, 3), 0.18), metadata={"exposure_scale": 1.0})
        >>> scores = compare(truth.color * 1.1, truth)
        >>> round(scores.psnr, 1), round(scores.relmse, 4)
        (33.8, 0.0076)
    """
    image = _pixels("image", image)
    color = _pixels("reference", reference.color, image.shape)
    exposure = frame_exposure(reference) if exposure is None else _positive(exposure)
    errors = relmse_map(image, color, exposure, reference.color_a, reference.color_b)
    # find_spec looks for the package without importing it; a package that is there but broken still raises.
    can_ssim = find_spec("skimage") and min(image.shape[:2]) >= SSIM_WINDOW
    return Scores(
        psnr=psnr(image, color, exposure),
        mse=mse(image, color, exposure),
        relmse=_trimmed_mean(errors, 0.0),
        relmse_trimmed=_trimmed_mean(errors, TRIM),
        ssim=ssim(image, color, exposure) if can_ssim else None,
        flip=flip(image, color, exposure) if find_spec("flip_evaluator") else None,
    )


def frame_exposure(frame: Frame) -> float:
    """`frame.metadata["exposure_scale"]` where the frame has one, otherwise `auto_exposure(frame.color)`."""
    scale = frame.metadata.get("exposure_scale")
    return auto_exposure(frame.color) if scale is None else _positive(scale)


def auto_exposure(image: Any) -> float:
    """The factor that brings an image's geometric mean luminance to middle grey, 0.18.

    Only pixels with a finite luminance above 0 count, and of those none so dark that it stands for black: more than
    24 to 32 octaves below the brightest 1 %, as in `mcdenoise_cl.stages.exposure`. An image without any gives 1. The
    log-average is that of Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002,
    equations 1 and 2.

    Example:
        >>> round(auto_exposure(np.full((4, 4, 3), 0.09)), 6)
        2.0
    """
    luminance = _pixels("image", image, finite=False) @ LUMINANCE
    lit = luminance[np.isfinite(luminance) & (luminance > 0)]
    bins = np.maximum(np.frexp(lit)[1] + 126, 0) // 8  # as in kernels/exposure.cl
    rank = lit.size - 1 - max(lit.size // 100, 15)
    if rank >= 0:
        lit = lit[bins >= np.partition(bins, rank)[rank] - 3]
    return float(0.18 / np.exp(np.mean(np.log(lit)))) if lit.size else 1.0


def tonemap(image: Any, exposure: float = 1.0) -> np.ndarray:
    """clip(exposure * image, 0, 1) ** (1 / 2.2): (H, W, 3) float64 in [0, 1]; pixels that are NaN stay NaN.

    Example:
        >>> tonemap(np.array([[[-1.0, 0.5, 4.0]]]), exposure=2.0).tolist()
        [[[0.0, 1.0, 1.0]]]
    """
    return exposed(image, exposure) ** (1 / 2.2)


def exposed(image: Any, exposure: float = 1.0) -> np.ndarray:
    """clip(exposure * image, 0, 1): (H, W, 3) float64, still linear; pixels that are NaN stay NaN.

    Example:
        >>> exposed(np.array([[[-1.0, 0.25, 4.0]]]), exposure=2.0).tolist()
        [[[0.0, 0.5, 1.0]]]
    """
    return np.clip(_positive(exposure) * _pixels("image", image, finite=False), 0, 1)


def mse(image: Any, reference: Any, exposure: float = 1.0) -> float:
    """Mean squared error of the tonemapped images, in [0, 1].

    Example:
        >>> mse(np.zeros((2, 2, 3)), np.ones((2, 2, 3)))
        1.0
    """
    shown, wanted = _tonemapped(image, reference, exposure)
    return float(np.mean((shown - wanted) ** 2))


def psnr(image: Any, reference: Any, exposure: float = 1.0) -> float:
    """Peak signal-to-noise ratio of the tonemapped images with peak 1, -10 log10(MSE), in dB; inf when they are equal.

    Example:
        >>> round(psnr(np.full((2, 2, 3), 0.1**2.2), np.zeros((2, 2, 3))), 6)
        20.0
    """
    error = mse(image, reference, exposure)
    return -10 * math.log10(error) if error > 0 else math.inf


def relmse(
    image: Any,
    reference: Any,
    exposure: float = 1.0,
    half_a: Any = None,
    half_b: Any = None,
    trim: float = 0.0,
) -> float:
    """Mean relative squared error: the mean of `relmse_map`, optionally without its largest pixels.

    Args:
        image, reference, half_a, half_b: (H, W, 3), scene-linear, as in `relmse_map`.
        exposure: the factor s there.
        trim: fraction of pixels, in [0, 1), left out: those largest in magnitude. A few fireflies can otherwise
            decide the mean; the price is that a trimmed mean is no longer unbiased.

    Raises:
        ParameterError: also for one half without the other and for a `trim` out of range.

    Example:
        >>> reference = np.ones((10, 10, 3))
        >>> image = reference.copy()
        >>> image[0, 0] = 100
        >>> round(relmse(image, reference)), relmse(image, reference, trim=0.01)
        (97, 0.0)
    """
    if not 0 <= trim < 1:
        raise ParameterError(f"trim is {trim} but a fraction in [0, 1) is needed: pass for instance trim=0.001")
    return _trimmed_mean(relmse_map(image, reference, exposure, half_a, half_b), trim)


def relmse_map(image: Any, reference: Any, exposure: float = 1.0, half_a: Any = None, half_b: Any = None) -> np.ndarray:
    """Relative squared error of each pixel, (H, W) float64.

    mean over RGB of (s x - s r)², divided by (mean over RGB of (s r)²) + 0.01, with s the exposure: Rousselle et al.,
    "Adaptive Sampling and Reconstruction using Greedy Error Minimization", SIGGRAPH Asia 2011.

    Two independent halves a and b of the reference make the numerator (s x - s a)(s x - s b): their noise is
    uncorrelated and has mean zero, so the reference's own variance drops out of the expectation, while (s x - s r)²
    counts it as error. A single pixel can then come out negative.

    Example:
        >>> relmse_map(np.full((1, 2, 3), 3.0), np.full((1, 2, 3), 1.0)).round(3).tolist()
        [[3.96, 3.96]]
    """
    if (half_a is None) != (half_b is None):
        have, lack = ("half_a", "half_b") if half_b is None else ("half_b", "half_a")
        raise ParameterError(f"{have} is given but {lack} is not: pass both halves of the reference, or neither")
    image = _pixels("image", image)
    reference = _pixels("reference", reference, image.shape)
    scale = _positive(exposure)
    a = reference if half_a is None else _pixels("half_a", half_a, image.shape)
    b = reference if half_b is None else _pixels("half_b", half_b, image.shape)
    error = np.mean((scale * (image - a)) * (scale * (image - b)), axis=2)
    return error / (np.mean((scale * reference) ** 2, axis=2) + RELMSE_EPSILON)


def ssim(image: Any, reference: Any, exposure: float = 1.0) -> float:
    """Structural similarity of the tonemapped images, mean over pixels and RGB, in [-1, 1]; 1 when they are equal.

    Wang et al., "Image Quality Assessment: From Error Visibility to Structural Similarity", 2004, with that paper's
    11 x 11 Gaussian window of standard deviation 1.5, computed by scikit-image.

    Raises:
        FrameError: also for an image smaller than 11 x 11.
        McdenoiseError: scikit-image is not installed.

    Example:
        >>> ssim(np.ones((11, 11, 3)), np.ones((11, 11, 3)))
        1.0
    """
    shown, wanted = _tonemapped(image, reference, exposure)
    if min(shown.shape[:2]) < SSIM_WINDOW:
        raise FrameError(
            f"image is {shown.shape} but SSIM looks through an {SSIM_WINDOW} x {SSIM_WINDOW} window: "
            "pass a larger image, or use another metric"
        )
    return float(
        _package("skimage.metrics", "scikit-image", "SSIM").structural_similarity(
            wanted,
            shown,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
            data_range=1.0,
            channel_axis=2,
        )
    )


def flip(image: Any, reference: Any, exposure: float = 1.0) -> float:
    """Mean LDR-FLIP error of the tonemapped images, in [0, 1], at the default 67 pixels a degree; 0 when equal.

    Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020, computed by flip-evaluator.

    Raises:
        McdenoiseError: flip-evaluator is not installed.

    Example:
        >>> flip(np.ones((4, 4, 3)), np.ones((4, 4, 3)))
        0.0
    """
    shown, wanted = _tonemapped(image, reference, exposure)
    # A tonemapped image is what is sent to the display, so it is the encoded (sRGB) kind of input.
    _, mean, _ = _package("flip_evaluator", "flip-evaluator", "FLIP").evaluate(
        wanted.astype(np.float32), shown.astype(np.float32), "LDR", inputsRGB=True, applyMagma=False
    )
    return float(mean)


def _tonemapped(image: Any, reference: Any, exposure: float) -> tuple[np.ndarray, np.ndarray]:
    image = _pixels("image", image)
    return tonemap(image, exposure), tonemap(_pixels("reference", reference, image.shape), exposure)


def _trimmed_mean(errors: np.ndarray, trim: float) -> float:
    keep = max(1, errors.size - round(trim * errors.size))
    if keep == errors.size:
        return float(np.mean(errors))
    errors = errors.ravel()
    return float(np.mean(errors[np.argpartition(np.abs(errors), keep - 1)[:keep]]))


def _positive(exposure: Any) -> float:
    if not isinstance(exposure, Real) or not (math.isfinite(exposure) and exposure > 0):
        raise ParameterError(f"exposure is {exposure!r} but a number above 0 is needed: 1.0 leaves the image as it is")
    return float(exposure)


def _pixels(name: str, image: Any, shape: tuple[int, ...] | None = None, finite: bool = True) -> np.ndarray:
    """The checked image on the host, (H, W, 3) float64."""
    image = np.asarray(image.get() if isinstance(image, cl_array.Array) else image)
    if image.dtype.kind != "f":
        raise FrameError(f"{name} has dtype {image.dtype} but floats are needed: pass scene-linear colour")
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise FrameError(f"{name} is {image.shape} but (H, W, 3) is needed: pass one RGB image")
    if shape is not None and image.shape != shape:
        raise FrameError(f"{name} is {image.shape} but image is {shape}: pass images of the same size")
    image = image.astype(np.float64, copy=False)
    bad = np.count_nonzero(~np.isfinite(image).all(axis=2)) if finite else 0
    if bad:
        raise FrameError(
            f"{name} has {bad} of {image[..., 0].size} pixels that are not finite: "
            "repair them first (numpy.nan_to_num), since a score that skipped them would hide them"
        )
    return image


def _package(module: str, package: str, what: str) -> Any:
    # Imported on use: these packages are optional, and slow to import.
    try:
        return import_module(module)
    except ImportError as error:
        raise McdenoiseError(
            f"{what} needs {package}, which cannot be imported: pip install 'mcdenoise-cl[demo]'"
        ) from error
