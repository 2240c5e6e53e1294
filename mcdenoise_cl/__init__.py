"""Denoise Monte Carlo renderings on any OpenCL device."""

__version__ = "0.1.0"

from .api import Denoiser, denoise
from .batch import denoise_files
from .details import Denoised, Report
from .errors import DeviceError, ExrError, FarmError, FrameError, McdenoiseError, ParameterError, RenderError
from .exr import read_exr, write_exr
from .exr_also import read_also
from .frame import Frame
from .methods import methods
from .motion import with_motion

__all__ = [
    "Denoised",
    "Denoiser",
    "DeviceError",
    "ExrError",
    "FarmError",
    "Frame",
    "FrameError",
    "McdenoiseError",
    "ParameterError",
    "RenderError",
    "Report",
    "denoise",
    "denoise_files",
    "methods",
    "read_also",
    "read_exr",
    "with_motion",
    "write_exr",
]
