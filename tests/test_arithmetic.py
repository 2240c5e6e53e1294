"""What floating point may not do to a result: constants, offsets, 16 bits, repetition, and one runtime or another."""

from dataclasses import asdict

import inputs
import numpy as np
import oracle_auto
import oracle_box_fit
import pyopencl as cl
import pytest
from test_auto import options_of
from test_stages import close

from mcdenoise_cl import Denoiser, Frame, denoise, methods
from mcdenoise_cl.device import SCHEDULE_VARIABLE, list_devices
from mcdenoise_cl.methods import get_method

METHODS = [method.name for method in methods()]
FEATURES = ("albedo", "normal", "depth")


def scene(height, width, noise=1.0, names=FEATURES):
    """A frame with the named features, all its variances, and half buffers."""
    planes = inputs.features(height, width, noise=noise)
    color, rng = planes["color"], np.random.default_rng(1)
    frame = {"color": color, "color_variance": (0.02 * color**2 + 1e-4).astype(np.float32)}
    for name in names:
        frame |= {name: planes[name], f"{name}_variance": np.full_like(planes[name], 4e-4)}
    step = (0.1 * color * rng.standard_normal(color.shape)).astype(np.float32)
    return frame | {"color_a": color + step, "color_b": color - step}


# Constants


@pytest.mark.parametrize("known", ["nothing", "flat features", "features", "variances", "halves"])
@pytest.mark.parametrize("method", METHODS)
def test_a_constant_image_comes_out_to_the_last_bit(method, known):
    for height, width in ((1, 1), (7, 1), (13, 17), (37, 101)):
        frame = scene(height, width)
        flat = {name: np.broadcast_to(frame[name][:1, :1], frame[name].shape) for name in FEATURES}
        features = {name: frame[name] for name in FEATURES}
        if method == "ssim-nlm" and known == "nothing":
            continue
        denoiser = Denoiser(height, width, method=method)
        for value in (0.1, 1 / 3, 1e-3, 700.0, 0.0, -0.25):
            color = np.broadcast_to(np.float32(value) * np.float32([1.0, 0.7, 0.1]), (height, width, 3))
            planes = {
                "nothing": {},
                "flat features": flat,
                "features": features,
                "variances": {name: frame[name] for name in frame if name not in ("color", "color_a", "color_b")}
                | {"color_variance": (0.1 * color) ** 2},
                "halves": features | {"color_a": color, "color_b": color},
            }[known]
            np.testing.assert_array_equal(denoiser(Frame(color, **planes)), color, f"{value} at {height}x{width}")


@pytest.mark.parametrize("method", ["auto", "guided"])
def test_a_constant_image_comes_out_to_the_last_bit_in_groups(method, monkeypatch):
    monkeypatch.setenv(SCHEDULE_VARIABLE, "group")
    frame = scene(5, 33)
    denoiser = Denoiser(5, 33, method=method)
    for value in (0.1, 1 / 3, 700.0):
        frame["color"] = np.full((5, 33, 3), value, np.float32)
        frame["color_variance"] = (0.1 * frame["color"]) ** 2
        planes = {name: plane for name, plane in frame.items() if name not in ("color_a", "color_b")}
        np.testing.assert_array_equal(denoiser(Frame(**planes)), frame["color"])


# Features far from zero

WINDOW = {"search_radius": 4, "patch_radius": 1, "spread_radius": 6}
OPTIONS = {
    "auto": WINDOW | {"wide_radius": 2, "wide_stride": 2},
    "regression": WINDOW,
    "guided": {"spread_radius": 6},
}


def sloped(offset, name):
    """Colours that follow a feature of two units' range, whose values are multiples of 1/16: an offset is exact."""
    y, x = np.mgrid[:24, :40]
    slope = np.round(16 * (x / 20 - 1)) / 16 + 0.25 * (y > 12)
    rng = np.random.default_rng(0)
    light = (1.5 + np.abs(slope)) * (1 + 0.3 * rng.standard_normal(slope.shape))
    color = (light[..., None] * (1.0, 0.7, 0.3)).astype(np.float32)
    if name == "normal":
        slope = np.stack([slope, np.round(16 * np.sin(x / 5)) / 16, y / 16], -1)
    return color, (offset + slope).astype(np.float32)


def theory(method, color, planes):
    options = asdict(get_method(method).make(**OPTIONS[method]))
    del options["outliers"]
    if method == "auto":
        return oracle_auto.denoise_auto(color, planes, **options_of(**OPTIONS[method]))[0]
    if method == "regression":
        return oracle_auto.denoise_regression(color, planes, **options)
    options["prefiltered"] = options.pop("prefilter")
    return oracle_box_fit.denoise_guided(color, planes=planes, **options)


@pytest.mark.parametrize("noisy", [False, True], ids=["exact", "noisy"])
@pytest.mark.parametrize(("name", "offset"), [("normal", 1e3), ("normal", 1e6), ("depth", 1e3), ("depth", 1e6)])
@pytest.mark.parametrize("method", list(OPTIONS))
def test_an_offset_takes_no_digits_from_a_feature(method, name, offset, noisy):
    """Positions in the place of normals, and depths, of 1e6 and a little; within 1e-4 of float64."""
    color, feature = sloped(offset, name)
    planes = {name: feature} | ({f"{name}_variance": np.full_like(feature, 1e-3)} if noisy else {})
    out = denoise(color, **planes, method=method, **OPTIONS[method])
    close(out, theory(method, color, planes), tolerance=1e-4)
    if name == "normal":  # positions count by their differences: 1e6 and none are the same
        planes[name] = sloped(0, name)[1]
        close(out, denoise(color, **planes, method=method, **OPTIONS[method]), tolerance=1e-6)
        assert np.abs(out - denoise(color, method=method, **OPTIONS[method])).max() > 0.1  # so the feature counts


# 16 bits


@pytest.mark.parametrize("method", METHODS)
def test_16_bits_are_filtered_like_the_same_values_in_32(method):
    frame = {name: plane.astype(np.float16) for name, plane in scene(24, 40).items()}
    out = denoise(Frame(**frame), method=method)
    wide = denoise(Frame(**{name: plane.astype(np.float32) for name, plane in frame.items()}), method=method)
    assert out.dtype == np.float16
    np.testing.assert_array_equal(out, wide.astype(np.float16))


# Repetition


@pytest.mark.parametrize("method", METHODS)
def test_the_same_frame_gives_the_same_bits(method):
    """Again, through another Denoiser, and after a frame of another kind, whose leftovers lie in the same memory."""
    frame, other = Frame(**scene(37, 101)), Frame(np.full((37, 101, 3), np.inf, np.float32))
    other.color[5, 5] = 1e30
    used = Denoiser(37, 101, method=method)
    first = used(frame)
    needed = {name: frame.planes()[name] for name in get_method(method).needs}
    for between in (frame, Frame(other.color, **needed)):
        used(between)
        np.testing.assert_array_equal(used(frame), first)
    np.testing.assert_array_equal(denoise(frame, method=method), first)


def test_runtimes_agree():
    """Each CPU runtime that is installed against the first: within 1e-4 of the image's own range."""
    devices = [info.device for info in list_devices() if info.device.type & cl.device_type.CPU]
    if len(devices) < 2:
        pytest.skip("one CPU runtime is installed: nothing to compare")
    frame = Frame(**scene(37, 101))
    for method in METHODS:
        first, *others = (denoise(frame, method=method, device=device) for device in devices)
        for other in others:
            close(other, first, tolerance=1e-4)
