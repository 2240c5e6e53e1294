"""Other denoisers to measure beside: Open Image Denoise, OpenCV's and scikit-image's non-local means.

    with peer.opened(frame, exposure) as run:
        image = peer.linear(run(), exposure)

Everything that is done once a frame size, or only because our frames are scene-linear, stays outside `run`, so that
timing `run` times the peer and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from mcdenoise_cl import Frame

#: Windows of both non-local means, in pixels: those of our own methods, so that quality and speed compare.
SEARCH, PATCH = 7, 5
#: h of both non-local means in units of the frame's noise: the lowest relMSE over the frames for scikit-image, and
#: within 4 % of the lowest for OpenCV, as `bench/quality.py --strengths 1 1.2 1.4 1.6 2` shows. The manuals' values
#: (scikit-image: the noise or slightly less; OpenCV: a fixed 3 or 10) suit the weak and even noise of photographs.
STRENGTH = 1.6
#: hColor over h of OpenCV: a and b of CIELAB hold about a quarter of the noise that L holds, since a pixel's samples
#: scatter in brightness more than in hue.
COLOR_STRENGTH = 0.25
#: Light, in units of display white, at which OpenCV's 8 bits end. At 1, as a display has it, lamps and sunlit walls
#: would come out grey, and that error would decide relMSE at high sample counts; without a limit there would be too
#: few steps left between bright values.
OPENCV_WHITE = 16.0
#: Several packages bring cv2; this is the one that the bench extra installs.
OPENCV = "opencv-contrib-python-headless"


@dataclass(frozen=True)
class Peer:
    """Another denoiser with one choice of settings.

    Attributes:
        name: as tables show it.
        module, package: what is imported, and what to install for it.
        needs: planes besides `color`.
        opened: (frame, exposure) -> context manager of a function that denoises the frame, again at every call.
        linear: (what that function returns, exposure) -> (H, W, 3) float32, scene-linear.
    """

    name: str
    module: str
    package: str
    needs: tuple[str, ...]
    opened: Callable[[Frame, float], AbstractContextManager[Callable[[], np.ndarray]]]
    linear: Callable[[np.ndarray, float], np.ndarray]


def all_peers(strengths: tuple[float, ...] = (STRENGTH,)) -> list[Peer]:
    """Every peer, installed or not; the non-local means once for each strength, in units of the noise."""
    peers = [_oidn(quality, ("albedo", "normal")) for quality in ("high", "balanced", "fast")]
    peers.append(_oidn("high", ()))
    for strength in strengths:
        opened = partial(_opencv_opened, strength)
        peers.append(Peer(_named("OpenCV NLM", strength), "cv2", OPENCV, (), opened, _from_bytes))
    for strength in strengths:
        opened = partial(_skimage_opened, strength)
        peers.append(Peer(_named("scikit-image NLM", strength), "skimage", "scikit-image", (), opened, _from_tone))
    return peers


def installed(peers: list[Peer]) -> tuple[list[Peer], list[str]]:
    """Those that can be imported, and one note for each package that cannot."""
    notes = {}
    for peer in peers:
        try:
            import_module(peer.module)
        except ImportError as error:
            left_out = "; ".join(other.name for other in peers if other.module == peer.module)
            notes[peer.module] = f"{left_out}: left out, {peer.package} cannot be imported ({error})"
    return [peer for peer in peers if peer.module not in notes], list(notes.values())


def denoised(peer: Peer, frame: Frame, exposure: float) -> np.ndarray:
    """The frame as the peer denoises it, (H, W, 3) float32, scene-linear."""
    with peer.opened(frame, exposure) as run:
        return peer.linear(run(), exposure)


def _named(name: str, strength: float) -> str:
    return name if strength == STRENGTH else f"{name}, h = {strength:g} noise"


def _oidn(quality: str, features: tuple[str, ...]) -> Peer:
    name = f"OIDN {quality}" if features else f"OIDN {quality}, colour only"
    return Peer(name, "pyoidn", "pyoidn", features, partial(_oidn_opened, quality, features), lambda image, _: image)


@contextmanager
def _oidn_opened(
    quality: str, features: tuple[str, ...], frame: Frame, exposure: float
) -> Iterator[Callable[[], np.ndarray]]:
    """Open Image Denoise's RT filter on the CPU, on all its cores, HDR, with the features as noisy as they come.

    It finds its own exposure and clips albedo to [0, 1] itself. On a CPU, balanced can be the same as high.
    """
    import pyoidn

    level = {
        "high": pyoidn.OIDN_QUALITY_HIGH,
        "balanced": pyoidn.OIDN_QUALITY_BALANCED,
        "fast": pyoidn.OIDN_QUALITY_FAST,
    }[quality]
    images = {name: np.ascontiguousarray(getattr(frame, name), np.float32) for name in ("color", *features)}
    images["output"] = np.empty_like(images["color"])
    # Released by hand, since a pyoidn Filter in a with statement swallows every exception raised inside.
    with ExitStack() as stack:
        device = pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CPU)
        _check(device, "making a device")
        stack.callback(device.release)
        device.commit()
        _check(device, "committing the device")
        rt = pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT)
        _check(device, "making a filter")
        stack.callback(rt.release)
        for name, image in images.items():
            rt.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        rt.set_bool("hdr", True)
        rt.set_quality(level)
        rt.commit()
        _check(device, "committing the filter")
        # A parameter whose name it does not know is no error to the library, so ask what it made of these.
        if rt.get_int("quality") != level or not rt.get_bool("hdr"):
            raise RuntimeError(f"Open Image Denoise ignores quality {quality!r} or hdr: look for a newer pyoidn")

        def run() -> np.ndarray:
            rt.execute()
            _check(device, "denoising")
            return images["output"]

        yield run


def _check(device: Any, doing: str) -> None:
    message = device.get_error()
    if message is not None:
        raise RuntimeError(f"Open Image Denoise failed at {doing}: {message}")


@contextmanager
def _opencv_opened(strength: float, frame: Frame, exposure: float) -> Iterator[Callable[[], np.ndarray]]:
    """cv2.fastNlMeansDenoisingColored, which takes 8-bit BGR and filters L and ab of CIELAB separately."""
    import cv2

    tone = to_tone(frame.color, exposure, OPENCV_WHITE)
    h = strength * noise(tone) * 255
    bgr = np.ascontiguousarray(np.round(tone * 255).astype(np.uint8)[..., ::-1])
    yield lambda: cv2.fastNlMeansDenoisingColored(
        bgr, None, h=h, hColor=COLOR_STRENGTH * h, templateWindowSize=PATCH, searchWindowSize=SEARCH
    )


def _from_bytes(bgr: np.ndarray, exposure: float) -> np.ndarray:
    return from_tone(bgr[..., ::-1].astype(np.float32) / 255, exposure, OPENCV_WHITE)


@contextmanager
def _skimage_opened(strength: float, frame: Frame, exposure: float) -> Iterator[Callable[[], np.ndarray]]:
    """skimage.restoration.denoise_nl_means in its default, fast mode.

    Its `sigma=`, which subtracts the noise from distances, stays at 0: at this strength it raises the error a little.
    """
    from skimage.restoration import denoise_nl_means

    tone = to_tone(frame.color, exposure, np.inf)
    h = strength * noise(tone)
    yield lambda: denoise_nl_means(tone, patch_size=PATCH, patch_distance=SEARCH // 2, h=h, channel_axis=-1)


def _from_tone(tone: np.ndarray, exposure: float) -> np.ndarray:
    return from_tone(tone, exposure, np.inf)


def to_tone(color: np.ndarray, exposure: float, white: float) -> np.ndarray:
    """Scene-linear colour as filters for photographs want it, in [0, 1]: x / (1 + x), gamma 2.2, 1 at `white`.

    The curve is that of our own non-local means, so that the filters and not the curves are compared.
    """
    light = np.clip(exposure * color.astype(np.float32), 0, white)
    return np.minimum(light / (1 + light) * np.float32(1 + 1 / white), 1) ** np.float32(1 / 2.2)


def from_tone(tone: np.ndarray, exposure: float, white: float) -> np.ndarray:
    """The inverse of `to_tone`, float32."""
    compressed = np.clip(tone, 0, 1).astype(np.float32) ** np.float32(2.2) / np.float32(1 + 1 / white)
    return compressed / np.maximum(1 - compressed, np.float32(1e-6)) / np.float32(exposure)


def noise(tone: np.ndarray) -> float:
    """Standard deviation of the noise: median of the magnitudes of Haar's diagonal details, over 0.6745.

    Donoho and Johnstone, "Ideal spatial adaptation by wavelet shrinkage", 1994, as skimage.restoration.estimate_sigma
    has it, details that are exactly 0 left out too; that one needs PyWavelets besides.
    """
    height, width = (size // 2 * 2 for size in tone.shape[:2])
    a, b = tone[0:height:2, 0:width:2], tone[0:height:2, 1:width:2]
    c, d = tone[1:height:2, 0:width:2], tone[1:height:2, 1:width:2]
    details = (a - b - c + d) / 2
    details = np.abs(details[details != 0])
    # Never 0, by which the filters would divide.
    return max(float(np.median(details)) / 0.6745, 1e-4) if details.size else 1e-4
