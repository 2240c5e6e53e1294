"""EXR in and out, with files made here by the OpenEXR package, by Mitsuba, or byte by byte."""

import errno
import os
import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import OpenEXR
import pyopencl.array as cl_array
import pytest

from mcdenoise_cl import exr_file
from mcdenoise_cl.errors import ExrError
from mcdenoise_cl.exr import read_exr, write_exr
from mcdenoise_cl.exr_layers import group_layers
from mcdenoise_cl.frame import PLANES, SCALAR_PLANES, Frame
from mcdenoise_cl.variant import import_mitsuba

H, W = 21, 18
LOSSLESS = ["NO", "RLE", "ZIPS", "ZIP", "PIZ"]
STORAGES = ["scanlineimage", "tiledimage"]


def noise(shape=(H, W), dtype="f4", seed=0):
    """Values of every kind: tiny, huge, negative, and not finite."""
    pixels = np.random.default_rng(seed).lognormal(0, 2, shape).astype(dtype)
    pixels.flat[:6] = np.array([np.nan, np.inf, -np.inf, -0.0, 6e-8, -2], dtype)[: pixels.size]
    return pixels


def part(channels, name="", storage="scanlineimage", compression="ZIP", **header):
    """A part of float32 noise for each channel named, or of the pixels or channels given."""
    if not isinstance(channels, dict):
        channels = {channel: noise(seed=i) for i, channel in enumerate(channels)}
    header |= {"type": getattr(OpenEXR, storage), "compression": getattr(OpenEXR, f"{compression}_COMPRESSION")}
    if "tile" in storage:
        header["tiles"] = OpenEXR.TileDescription()
        header["tiles"].xSize, header["tiles"].ySize = 16, 7
    channels = {
        k: v if isinstance(v, OpenEXR.Channel) else OpenEXR.Channel(k, np.ascontiguousarray(v))
        for k, v in channels.items()
    }
    return OpenEXR.Part(header, channels, name)


def make(path, *parts):
    OpenEXR.File(list(parts)).write(str(path))
    return path


def rgb(*layers, suffix="RGB"):
    return [f"{layer}.{c}" if layer else c for layer in layers for c in suffix]


def contents(path):
    """Header and channels of each part, comparable with ==."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return [
            (
                {k: repr(v) for k, v in p.header.items() if k != "channels"},
                {k: (c.pixels.dtype, c.pixels.shape, c.pixels.tobytes(), c.pLinear) for k, c in p.channels.items()},
            )
            for p in file.parts
        ]


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def recognised(path, **arguments):
    return read_exr(path, **arguments).metadata["layers"]


def full_frame(shape=(H, W), dtype="f4"):
    planes = {
        plane: noise(shape if plane in SCALAR_PLANES else (*shape, 3), dtype, i) for i, plane in enumerate(PLANES)
    }
    return Frame(**planes, metadata={"samples_per_pixel": 12, "exposure_scale": 0.25, "scene": "a room"})


# ---------------------------------------------------------------------------------------------- own files, round trip


@pytest.mark.parametrize("compression", [name.lower() if name != "NO" else "none" for name in LOSSLESS])
@pytest.mark.parametrize("dtype", ["f2", "f4"])
def test_own_frame_round_trip(tmp_path, dtype, compression):
    frame = full_frame(dtype=dtype)
    write_exr(tmp_path / "a.exr", frame, compression=compression)
    back = read_exr(tmp_path / "a.exr")
    assert set(back.planes()) == set(PLANES)
    for plane, pixels in frame.planes().items():
        assert back.planes()[plane].dtype == dtype
        assert back.planes()[plane].tobytes() == pixels.tobytes(), plane
    assert {k: back.metadata[k] for k in frame.metadata} == frame.metadata
    assert back.metadata["source"] == str(tmp_path / "a.exr")
    assert back.metadata["layers"]["normal_variance"] == "N_variance"


@pytest.mark.parametrize("shape", [(1, 1), (1, 33), (33, 1), (7, 65)])
def test_odd_sizes(tmp_path, shape):
    frame = full_frame(shape)
    write_exr(tmp_path / "a.exr", frame)
    write_exr(tmp_path / "b.exr", frame.color, template=tmp_path / "a.exr")
    assert contents(tmp_path / "a.exr") == contents(tmp_path / "b.exr")
    assert read_exr(tmp_path / "b.exr").color.tobytes() == frame.color.tobytes()


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("compression", LOSSLESS)
@pytest.mark.parametrize("dtype", ["f2", "f4"])
@pytest.mark.parametrize("many", [False, True])
def test_reads_and_keeps_every_kind_of_file(tmp_path, storage, compression, dtype, many):
    color, normal = noise((H, W, 3), dtype, 1), noise((H, W, 3), dtype, 2)
    image = {c: color[..., i] for i, c in enumerate("RGB")} | {"A": noise(dtype=dtype)}
    image["id"] = np.arange(H * W, dtype=np.uint32).reshape(H, W)
    vector = {f"N.{c}": normal[..., i] for i, c in enumerate("XYZ")}
    kind = {"storage": storage, "compression": compression}
    parts = [part(image, "rgba", **kind), part(vector, "N", **kind)] if many else [part(image | vector, **kind)]
    path = make(tmp_path / "a.exr", *parts)
    frame = read_exr(path)
    assert frame.color.tobytes() == color.tobytes() and frame.normal.tobytes() == normal.tobytes()
    assert frame.color.dtype == frame.normal.dtype == dtype
    write_exr(tmp_path / "b.exr", color, template=path)
    assert contents(tmp_path / "b.exr") == contents(path)


def test_array_is_written_as_plain_rgb(tmp_path):
    image = np.random.default_rng(0).random((H, W, 3))
    write_exr(tmp_path / "a.exr", image[:, ::-1].transpose(1, 0, 2))  # strides that OpenEXR would ignore
    [(header, channels)] = contents(tmp_path / "a.exr")
    assert set(channels) == set("RGB") and "ZIP_COMPRESSION" in header["compression"]
    back = read_exr(tmp_path / "a.exr").color
    np.testing.assert_array_equal(back, image[:, ::-1].transpose(1, 0, 2).astype(np.float32))


def test_half_clamps_and_leaves_variance_alone(tmp_path):
    color = np.full((2, 2, 3), 1e9, np.float32)
    color[0, 0] = [-1e9, np.inf, np.nan]
    frame = Frame(color, color_variance=np.full((2, 2, 3), 1e-9, np.float32))
    write_exr(tmp_path / "a.exr", frame, dtype="half")
    back = read_exr(tmp_path / "a.exr")
    assert back.color.dtype == np.float16 and back.color_variance.dtype == np.float32
    np.testing.assert_array_equal(back.color[0, 0], np.array([-65504, 65504, np.nan], np.float16))
    assert back.color[1, 1, 0] == 65504 and back.color_variance.min() == np.float32(1e-9)


# ------------------------------------------------------------------------------------------------ names of renderers

CYCLES = [
    *rgb("ViewLayer.Combined", suffix="RGBA"),
    *rgb("ViewLayer.Denoising Albedo", "ViewLayer.DiffCol", "ViewLayer.Emit"),
    *rgb("ViewLayer.Denoising Normal", "ViewLayer.Normal", "ViewLayer.Position", suffix="XYZ"),
    *rgb("ViewLayer.Vector", suffix="XYZW"),
    *("ViewLayer.Denoising Depth.Z", "ViewLayer.Depth.Z", "ViewLayer.Mist.Z", "ViewLayer.IndexOB.X"),
    *rgb("ViewLayer.CryptoObject00", suffix="rgba"),
]
CYCLES_FOUND = {
    "color": "ViewLayer.Combined",
    "albedo": "ViewLayer.Denoising Albedo",
    "normal": "ViewLayer.Denoising Normal",
    "depth": "ViewLayer.Denoising Depth",
}
PBRT = [*rgb("", "Albedo", "Variance", "RelativeVariance"), *rgb("P", "N", "Ns", suffix="XYZ"), *"uv", "dzdx", "dzdy"]
EARLY_PBRT = [*rgb("", "Albedo"), *(v + c for v in ("P", "N", "Ns") for c in "xyz"), "dzdx", "dzdy"]
ARNOLD = [
    *rgb("", suffix="RGBA"),
    *rgb("denoise_albedo", "variance", "diffuse", "specular"),
    *rgb("N", "P", "motionvector", suffix="XYZ"),
    "Z",
]


@pytest.mark.parametrize(
    ("channels", "expected"),
    [
        (CYCLES, CYCLES_FOUND),
        ([*CYCLES, *rgb("ViewLayer.Noisy Image")], CYCLES_FOUND | {"color": "ViewLayer.Noisy Image"}),
        ([*CYCLES, *rgb("Composite.Combined", suffix="RGBA")], CYCLES_FOUND),
        ([c for c in CYCLES if "Denoising Depth" not in c], CYCLES_FOUND | {"depth": "ViewLayer.Depth"}),
        (
            [c.replace("ViewLayer", "Front.001") for c in CYCLES],
            {k: v.replace("ViewLayer", "Front.001") for k, v in CYCLES_FOUND.items()},
        ),
        (PBRT, {"color": "RGB", "albedo": "Albedo", "normal": "Ns"}),
        (EARLY_PBRT, {"color": "RGB", "albedo": "Albedo", "normal": "Ns", "depth": "Pz"}),
        (
            ARNOLD,
            {"color": "RGB", "albedo": "denoise_albedo", "normal": "N", "depth": "Z", "color_variance": "variance"},
        ),
        ([f"RGBA.{c}" if c in set("RGBA") else c for c in ARNOLD if "ance" not in c], {"color": "RGBA"} | {
            "albedo": "denoise_albedo", "normal": "N", "depth": "Z"}),
        # Too little to go by, or too much.
        ([*rgb(""), *rgb("P", "Position", "Pref", "motion", "UV", suffix="XYZ")], {"color": "RGB"}),
        ([*rgb(""), *rgb("a", "b", suffix="XYZ")], {"color": "RGB"}),
        ([*rgb(""), *rgb("left.N", "right.N", suffix="XYZ")], {"color": "RGB"}),
        ([*rgb(""), *rgb("something"), "something else.T", "velocity.X", "velocity.Z"], {"color": "RGB"}),
        ([*rgb("", "half_a", "albedo_variance"), "Z_variance"], {"color": "RGB"}),
    ],
)  # fmt: skip
def test_names(tmp_path, channels, expected):
    assert recognised(make(tmp_path / "a.exr", part(channels))) == expected


@pytest.mark.parametrize("style", ["pass in the part", "layer in the part", "everything in the channel"])
def test_cycles_in_parts(tmp_path, style):
    names = {
        "pass in the part": lambda layer, c: (layer, c),
        "layer in the part": lambda layer, c: (layer, f"{layer.split('.')[1]}.{c}"),
        "everything in the channel": lambda layer, c: (layer, f"{layer}.{c}"),
    }[style]
    parts = {}
    for i, channel in enumerate(CYCLES):
        name, stored = names(*channel.rsplit(".", 1))
        parts.setdefault(name, {})[stored] = noise(seed=i)
    path = make(tmp_path / "a.exr", *(part(channels, name) for name, channels in parts.items()))
    frame = read_exr(path)
    assert [v.split(".")[1] for v in frame.metadata["layers"].values()] == [v[10:] for v in CYCLES_FOUND.values()]
    np.testing.assert_array_equal(frame.normal[..., 1], noise(seed=CYCLES.index("ViewLayer.Denoising Normal.Y")))


def test_two_view_layers_need_a_choice_and_the_rest_follows_it(tmp_path):
    channels = [*CYCLES, *(c.replace("ViewLayer", "Other") for c in CYCLES)]
    path = make(tmp_path / "a.exr", part(channels, **{"cycles.ViewLayer.samples": "8", "cycles.Other.samples": "64"}))
    with pytest.raises(ExrError, match=r"Other\.Combined, ViewLayer\.Combined.*--layer color='Other\.Combined'"):
        read_exr(path)
    frame = read_exr(path, layers={"color": "Other.Combined"})
    assert frame.metadata["layers"] == {k: v.replace("ViewLayer", "Other") for k, v in CYCLES_FOUND.items()}
    assert frame.metadata["samples_per_pixel"] == 64


@pytest.mark.parametrize(
    ("attributes", "count"),
    [
        ({"samplesPerPixel": 16}, 16),
        ({"samplesPerPixel": 16.0}, 16),
        ({"cycles.ViewLayer.samples": "128"}, 128),
        ({"samplesPerPixel": 0}, None),
        ({"cycles.ViewLayer.samples": "many"}, None),
        ({}, None),
    ],
)
def test_sample_count(tmp_path, attributes, count):
    path = make(tmp_path / "a.exr", part("RGB", **attributes))
    assert read_exr(path).metadata.get("samples_per_pixel") == count
    assert read_exr(path, samples_per_pixel=5).metadata["samples_per_pixel"] == 5
    with pytest.raises(ExrError, match="whole number"):
        read_exr(path, samples_per_pixel=0)


# -------------------------------------------------------------------------------------------------- Mitsuba, moments


def test_moments_become_the_variance_of_the_mean(tmp_path):
    n = 7
    samples = np.random.default_rng(3).normal([[[[2.0, -1.0, 0.5]]]], 0.3, (n, H, W, 3))
    mean, second = samples.mean(0), np.square(samples).mean(0)
    channels = dict.fromkeys("RGB", noise())
    for i, (c, v) in enumerate(zip("RGB", "XYZ", strict=True)):
        channels |= {f"in.img.{c}": mean[..., i], f"m2_in.img.{c}": second[..., i]}
        channels |= {f"in.nn.{v}": mean[..., i], f"m2_in.nn.{v}": second[..., i]}
    channels |= {"in.img.A": mean[..., 0], "m2_in.img.A": second[..., 0]}
    channels |= {"in.dd.T": mean[..., 0], "m2_in.dd.T": second[..., 0]}
    path = make(tmp_path / "a.exr", part({k: v.astype(np.float32) for k, v in channels.items()}))
    frame = read_exr(path, samples_per_pixel=n)
    expected = samples.var(0, ddof=1) / n
    for plane in ("color_variance", "normal_variance"):
        assert frame.planes()[plane].dtype == np.float32
        np.testing.assert_allclose(frame.planes()[plane], expected, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(frame.depth_variance, expected[..., 0], rtol=1e-3, atol=1e-6)
    assert frame.metadata["layers"]["color_variance"] == "m2_in.img"
    for count in (None, 1):
        assert not any(name.endswith("variance") for name in read_exr(path, samples_per_pixel=count).planes())
    chosen = read_exr(path, samples_per_pixel=n, layers={"color": "in.img", "depth_variance": "m2_in.dd.T"})
    np.testing.assert_array_equal(chosen.color_variance, frame.color_variance)
    np.testing.assert_array_equal(chosen.depth_variance, frame.depth_variance)
    with pytest.raises(ExrError, match="second moments"):
        read_exr(path, layers={"color_variance": "m2_in.img"})


@pytest.mark.parametrize("moment", [False, True])
@pytest.mark.parametrize("names", [("albedo", "nn", "dd.y", "pos"), ("kd", "facing", "far", "where")])
def test_mitsuba(tmp_path, moment, names):
    mi = import_mitsuba()  # which shows Dr.Jit an LLVM that works, for the tests that come later
    mi.set_variant("scalar_rgb")
    scene = mi.cornell_box()
    kinds = ("albedo", "sh_normal", "depth", "position")
    aovs = ",".join(f"{name}:{kind}" for name, kind in zip(names, kinds, strict=True))
    scene["integrator"] = {"type": "aov", "aovs": aovs, "img": {"type": "path", "max_depth": 3}}
    if moment:
        scene["integrator"] = {"type": "moment", "inner": scene["integrator"]}
    scene["sensor"]["film"] |= {"width": 16, "height": 12, "rfilter": {"type": "box"}}
    scene = mi.load_dict(scene)
    mi.render(scene, spp=4)
    scene.sensors()[0].film().bitmap().write(str(tmp_path / "a.exr"))

    frame = read_exr(tmp_path / "a.exr", samples_per_pixel=4)
    prefix = "inner." if moment else ""
    expected = {"color": "RGB"}
    expected |= {plane: prefix + name for plane, name in zip(("albedo", "normal", "depth"), names, strict=False)}
    assert {k: v for k, v in frame.metadata["layers"].items() if "variance" not in k} == expected
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        raw = {name: channel.pixels for name, channel in file.parts[0].channels.items()}
    np.testing.assert_array_equal(frame.depth, raw[f"{prefix}{names[2]}.T"])
    np.testing.assert_array_equal(frame.normal[..., 2], raw[f"{prefix}{names[1]}.Z"])
    if moment:
        m1, m2 = raw["inner.img.G"].astype("f8"), raw["m2_inner.img.G"].astype("f8")
        np.testing.assert_allclose(frame.color_variance[..., 1], np.maximum(m2 - m1**2, 0) / 3, rtol=1e-6)
        assert {"color_variance", "albedo_variance", "normal_variance", "depth_variance"} <= set(frame.planes())


def test_moments_that_rounding_made_negative_give_no_variance(tmp_path):
    channels = dict.fromkeys(["R", "G", "B", "far.T"], np.full((H, W), 2, np.float32))
    channels["m2_far.T"] = np.full((H, W), 3.9, np.float32)
    frame = read_exr(make(tmp_path / "a.exr", part(channels)), samples_per_pixel=4)
    np.testing.assert_array_equal(frame.depth_variance, 0)


def test_colour_in_cie_xyz_is_not_a_normal(tmp_path):
    channels = dict.fromkeys([*"RGB", *rgb("inner", "m2_inner", suffix="XYZ")], np.full((H, W), 0.1, np.float32))
    assert recognised(make(tmp_path / "a.exr", part(channels)), samples_per_pixel=4) == {"color": "RGB"}


@pytest.mark.parametrize(
    ("name", "length", "found"),
    [("foo", 1, True), ("foo", 1.5, False), ("where.P", 1, False), ("Motion", 1, False), ("dp_du", 1, False)],
)
def test_a_vector_of_an_unknown_name(tmp_path, name, length, found):
    channels = dict.fromkeys([*"RGB", *rgb(name, suffix="XYZ")], np.full((H, W), length * 3**-0.5, np.float32))
    expected = {"color": "RGB"} | ({"normal": name} if found else {})
    assert recognised(make(tmp_path / "a.exr", part(channels))) == expected


# --------------------------------------------------------------------------------------------------------- overrides


def test_overrides(tmp_path):
    channels = [*rgb("", "albedo", "paint"), *rgb("N", "P", suffix="XYZ"), "Z", "ch00", "ch01", "ch02"]
    path = make(tmp_path / "a.exr", part(channels))

    def found(**layers):
        return recognised(path, layers=layers)

    everything = {"color": "RGB", "albedo": "albedo", "normal": "N", "depth": "Z"}
    assert found() == everything
    assert found(albedo="paint") == everything | {"albedo": "paint"}
    assert found(albedo="PAINT", depth="P.Z") == everything | {"albedo": "paint", "depth": "P.Z"}
    assert found(color="paint") == everything | {"color": "paint"}
    assert found(color="ch00, ch01,ch02") == everything | {"color": "ch00,ch01,ch02"}
    assert found(albedo="R G B", normal="none", depth="") == {"color": "RGB", "albedo": "RGB"}
    np.testing.assert_array_equal(read_exr(path, layers={"depth": "P.Z"}).depth, noise(seed=channels.index("P.Z")))


@pytest.mark.parametrize(
    ("layers", "message"),
    [
        ({"albdo": "paint"}, "'albdo' is not a plane: .*color, albedo"),
        ({"albedo": 3}, "give its name as text"),
        ({"albedo": "pain"}, "albedo=pain is not in the file: its layers are RGB, Z, paint"),
        ({"depth": "paint"}, "depth needs one channel but the layer paint has paint.R, paint.G, paint.B: name one"),
        ({"albedo": "Z"}, "albedo needs three channels"),
        ({"albedo": "R,G"}, "not in the file"),
        ({"depth": "id"}, "depth=id is a channel of integers"),
        ({"color": "none"}, "color cannot be left out"),
        ({"color_a": "paint"}, "color_a is given but color_b is not"),
    ],
)
def test_override_errors(tmp_path, layers, message):
    channels = {c: noise() for c in [*rgb("", "paint"), "Z"]} | {"id": np.zeros((H, W), np.uint32)}
    with pytest.raises(ExrError, match=message):
        read_exr(make(tmp_path / "a.exr", part(channels)), layers=layers)


# ------------------------------------------------------------------------------------------------- parts and windows


def test_only_parts_over_the_pixels_of_the_colour_are_used(tmp_path):
    display = ((0, 0), (99, 99))
    small = {c: noise((4, 5)) for c in "RGB"}
    path = make(
        tmp_path / "a.exr",
        part(small, "albedo", displayWindow=display),
        part("RGBA", "beauty", displayWindow=display),
        part("Z", "depth", displayWindow=display, dataWindow=((1, 0), (W, H - 1))),
        part({f"N.{c}": noise() for c in "XYZ"}, "N", displayWindow=display),
    )
    assert recognised(path) == {"color": "beauty", "normal": "N"}
    with pytest.raises(ExrError, match=r"albedo for albedo has the data window \(0, 0, 4, 3\) but the colour has"):
        read_exr(path, layers={"albedo": "albedo"})


def test_views_in_parts_go_together(tmp_path):
    views = [part([*rgb("", "albedo"), *rgb("N", suffix="XYZ"), "Z"], view) for view in ("left", "right")]
    path = make(tmp_path / "a.exr", *views)
    assert recognised(path) == {"color": "left", "albedo": "left.albedo", "normal": "left.N", "depth": "left.Z"}
    assert recognised(path, layers={"color": "right"})["normal"] == "right.N"


def test_layers_are_found_by_their_own_part_first():
    layers = group_layers([("a", ["R", "G", "B", "Z"]), ("b", ["b.Y"])])
    assert [(layer.title, layer.part) for layer in layers] == [("a", 0), ("a.Z", 0), ("b", 1)]


# --------------------------------------------------------------------------------------------------- with a template

ATTRIBUTES = {
    "samplesPerPixel": 4,
    "scene": "été",
    "exposureScale": 0.1,
    "list": ["a", "b"],
    "matrix": np.arange(16, dtype=np.float32).reshape(4, 4),
    "chromaticities": (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    "framesPerSecond": Fraction(24000, 1001),
    "pixelAspectRatio": 2.0,
    "lineOrder": OpenEXR.DECREASING_Y,
    "dataWindow": ((5, -7), (5 + W - 1, -7 + H - 1)),
    "displayWindow": ((0, 0), (199, 99)),
}


def deep_part(name):
    pixels = np.empty((H, W), dtype=object)
    for i, where in enumerate(np.ndindex(H, W)):
        pixels[where] = np.arange(i % 3, dtype=np.float32)
    return part({"deepZ": pixels}, name, "deepscanline", "ZIPS", displayWindow=ATTRIBUTES["displayWindow"])


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("in_place", [False, True])
def test_template_keeps_everything_but_the_colour(tmp_path, storage, in_place):
    image = {c: noise(dtype="f2", seed=i) for i, c in enumerate("RGBA")} | {c: noise() for c in rgb("albedo", "other")}
    image["id"] = np.random.default_rng(0).integers(0, 2**32, (H, W), dtype=np.uint32)
    image["perceptual"] = OpenEXR.Channel("perceptual", noise(), 1, 1, True)
    ends = {"displayWindow": ATTRIBUTES["displayWindow"], "pixelAspectRatio": 2.0}
    extra = part({"Z": noise((3, 4))}, "thumbnail", "tiledimage", "PIZ", **ends, comment="small")
    path = make(tmp_path / "a.exr", part(image, "main", storage, **ATTRIBUTES), extra)
    before = contents(path)
    target = path if in_place else tmp_path / "b.exr"
    result = np.random.default_rng(9).random((H, W, 3)).astype(np.float32) * 1e5
    write_exr(target, Frame(result, albedo=result), template=path)
    after = contents(target)
    for (old_header, old), (new_header, new) in zip(before, after, strict=True):
        assert new_header == old_header
        assert {k: v for k, v in new.items() if k not in "RGB"} == {k: v for k, v in old.items() if k not in "RGB"}
    frame = read_exr(target)
    assert frame.color.dtype == np.float16 and frame.color.max() == 65504
    np.testing.assert_array_equal(frame.color, np.minimum(result, 65504).astype(np.float16))
    assert names_in(tmp_path) == (["a.exr"] if in_place else ["a.exr", "b.exr"])


def test_template_keeps_deep_parts(tmp_path):
    path = make(tmp_path / "a.exr", part("RGB", "flat", displayWindow=ATTRIBUTES["displayWindow"]), deep_part("deep"))
    write_exr(tmp_path / "b.exr", noise((H, W, 3)), template=path, compression="piz")
    samples = []
    for name in ("a.exr", "b.exr"):
        with OpenEXR.File(str(tmp_path / name), separate_channels=True) as file:
            pixels = file.parts[1].channels["deepZ"].pixels
            samples.append([list(p) if p is not None else [] for p in pixels.ravel()])
    assert samples[0] == samples[1] and samples[0][2] == [0, 1]


def test_template_options(tmp_path):
    path = make(tmp_path / "a.exr", part(rgb("", "beauty2"), "x", compression="DWAA"))
    result = np.full((H, W, 3), 2.5, np.float32)
    write_exr(tmp_path / "b.exr", result, template=path)
    assert "DWAA" in contents(tmp_path / "b.exr")[0][0]["compression"]
    write_exr(
        tmp_path / "b.exr", result, template=path, layers={"color": "beauty2"}, dtype=np.float16, compression="PIZ"
    )
    [(header, channels)] = contents(tmp_path / "b.exr")
    assert "PIZ" in header["compression"] and channels["beauty2.G"][2] == np.full((H, W), 2.5, np.float16).tobytes()
    assert channels["R"][2] == contents(path)[0][1]["R"][2]
    with pytest.raises(ExrError, match=rf"the image is \(3, 4\) but the colour of .*a.exr is \({H}, {W}\)"):
        write_exr(tmp_path / "c.exr", result[:3, :4], template=path)
    with pytest.raises(ExrError, match=r"nowhere.exr cannot be read \(No such file"):
        write_exr(tmp_path / "c.exr", result, template=tmp_path / "nowhere.exr")
    assert not (tmp_path / "c.exr").exists()


def test_result_of_a_cycles_noisy_image_goes_where_viewers_look(tmp_path):
    path = make(tmp_path / "a.exr", part([*CYCLES, *rgb("ViewLayer.Noisy Image")], "x"))
    result = np.full((H, W, 3), 2.5, np.float32)
    write_exr(tmp_path / "b.exr", result, template=path)
    [(_, before)], [(_, after)] = contents(path), contents(tmp_path / "b.exr")
    assert {name for name in before if before[name] != after[name]} == set(rgb("ViewLayer.Combined"))
    make(path, part(rgb("ViewLayer.Noisy Image"), "x"))
    write_exr(tmp_path / "b.exr", result, template=path)
    assert np.unique(read_exr(tmp_path / "b.exr").color) == [2.5]


# -------------------------------------------------------------------------------------------- complete or not at all


@pytest.fixture
def old(tmp_path):
    """A folder with an existing file; afterwards nothing else may be in it, and the file must be as it was."""
    folder = tmp_path / "out"
    folder.mkdir()
    path = folder / "a.exr"
    path.write_bytes(b"precious")
    yield path
    assert names_in(folder) == ["a.exr"] and path.read_bytes() == b"precious"


@pytest.mark.parametrize("error", [RuntimeError("half way"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file(old, monkeypatch, error):
    def fail(path, parts):
        Path(path).write_bytes(exr_file.MAGIC + b"half a file")
        raise error

    monkeypatch.setattr(exr_file, "_write", fail)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else ExrError):
        write_exr(old, noise((H, W, 3)))


def test_a_full_disk_leaves_the_old_file(old):
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(ExrError, match=r"a.exr cannot be written .*File too large.*free space"):
            write_exr(old, noise((200, 200, 3)), compression="none")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_disk_that_tells_late_that_it_is_full_leaves_the_old_file(old, monkeypatch):
    """As a disk on the network does: the writes went well, and nothing of them is there."""

    def fail(_):
        raise OSError(errno.EDQUOT, os.strerror(errno.EDQUOT))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ExrError, match=r"a.exr cannot be written \(Disk quota exceeded\)"):
        write_exr(old, noise((H, W, 3)))


@pytest.mark.parametrize(
    ("image", "arguments", "message"),
    [
        (np.zeros((4, 4), np.float32), {}, r"\(4, 4\) but \(H, W, 3\)"),
        (np.zeros((4, 4, 3), np.uint8), {}, "uint8"),
        ([[1.0]], {}, "list"),
        (np.zeros((4, 4, 3)), {"dtype": "f8"}, "'f8' but an EXR file stores float16 or float32"),
        (np.zeros((4, 4, 3)), {"dtype": "colour"}, "'colour' but"),
        (np.zeros((4, 4, 3)), {"compression": "jpeg"}, "'jpeg' is not a compression: choose one of none, rle"),
        (cl_array.Array.__new__(cl_array.Array), {}, r"\.get\(\)"),
    ],
)
def test_what_cannot_be_written(old, image, arguments, message):
    with pytest.raises(ExrError, match=message):
        write_exr(old, image, **arguments)


def test_where_nothing_can_be_written(tmp_path, monkeypatch):
    image = noise((H, W, 3))
    with pytest.raises(ExrError, match=r"No such file or directory.*check the folder"):
        write_exr(tmp_path / "missing" / "a.exr", image)
    with pytest.raises(ExrError, match="not a regular file"):
        write_exr(tmp_path, image)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ExrError, match="not a regular file"):
        write_exr(tmp_path / "pipe", image)
    assert (tmp_path / "pipe").is_fifo()

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ExrError, match="Permission denied"):
        write_exr(tmp_path / "a.exr", image)
    assert names_in(tmp_path) == ["pipe"]


def test_permissions_and_links(tmp_path):
    (tmp_path / "plain").touch()
    (tmp_path / "link.exr").symlink_to(tmp_path / "a.exr")
    write_exr(tmp_path / "link.exr", noise((H, W, 3)))
    assert (tmp_path / "link.exr").is_symlink() and not (tmp_path / "a.exr").is_symlink()
    assert (tmp_path / "a.exr").stat().st_mode == (tmp_path / "plain").stat().st_mode


# ------------------------------------------------------------------------------------------------- what is not an EXR


def damaged(name, path):
    data = path.read_bytes()
    {
        "png": lambda: path.write_bytes(b"\x89PNG\r\n\x1a\n" + data),
        "empty": lambda: path.write_bytes(b""),
        "header only": lambda: path.write_bytes(data[:150]),
        "half": lambda: path.write_bytes(data[: len(data) // 2]),
        "last bytes": lambda: path.write_bytes(data[:-9]),
        "second part": lambda: path.write_bytes(data[:-9]),
    }[name]()


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("name", ["png", "empty", "header only", "half", "last bytes", "second part"])
def test_damaged_files(tmp_path, storage, name):
    parts = [part("RGB", "first", storage)]
    if name == "second part":
        parts.append(part("Z", "second", storage))
    path = make(tmp_path / "a.exr", *parts)
    damaged(name, path)
    expected = "is not an EXR file" if name in ("png", "empty") else "damaged"
    with pytest.raises(ExrError, match=f"a.exr .*{expected}"):
        read_exr(path)
    with pytest.raises(ExrError, match=expected):
        write_exr(tmp_path / "b.exr", noise((H, W, 3)), template=path)
    assert names_in(tmp_path) == ["a.exr"]


def test_what_cannot_be_read(tmp_path, monkeypatch):
    with pytest.raises(ExrError, match=r"a.exr cannot be read \(No such file or directory\)"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(ExrError, match="Is a directory"):
        read_exr(tmp_path)
    with pytest.raises(ExrError, match=r"among the layers N, Z, albedo: say which .* --layer color=NAME"):
        read_exr(make(tmp_path / "b.exr", part([*rgb("albedo"), "Z", *rgb("N", suffix="XYZ")])))
    with pytest.raises(ExrError, match="only deep pixels, which are not supported"):
        read_exr(make(tmp_path / "c.exr", deep_part("")))
    with pytest.raises(ExrError, match=r"layers y: .*its deep parts are not supported"):
        read_exr(make(tmp_path / "d.exr", deep_part("x"), part("Z", "y", displayWindow=ATTRIBUTES["displayWindow"])))

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(ExrError, match="Permission denied"):
        read_exr(tmp_path / "b.exr")


def raw_exr(path, channels, size, chunks, tiles=b""):
    """A file that the OpenEXR package cannot write: `channels` is name -> sampling, `chunks` are bytes."""

    def attribute(name, kind, value):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value

    table = b"".join(n.encode() + struct.pack("<Biiii", 0, 2, 0, s, s) for n, s in sorted(channels.items())) + b"\0"
    window = struct.pack("<4i", 0, 0, size[1] - 1, size[0] - 1)
    start = exr_file.MAGIC + struct.pack("<i", 2 | (0x200 if tiles else 0)) + attribute("channels", "chlist", table)
    start += attribute("compression", "compression", b"\0") + attribute("dataWindow", "box2i", window)
    start += attribute("displayWindow", "box2i", window) + attribute("lineOrder", "lineOrder", b"\0")
    start += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    start += attribute("screenWindowCenter", "v2f", bytes(8)) + attribute("screenWindowWidth", "float", bytes(4))
    start += (attribute("tiles", "tiledesc", tiles) if tiles else b"") + b"\0"
    offsets = np.cumsum([len(start) + 8 * len(chunks), *map(len, chunks[:-1])])
    path.write_bytes(start + offsets.astype("<u8").tobytes() + b"".join(chunks))
    return path


def test_subsampled_channels_are_refused(tmp_path):
    lines = [[noise((1, 4))] + ([noise((1, 2))] * 2 if y % 2 == 0 else []) for y in range(4)]
    chunks = [struct.pack("<ii", y, sum(a.nbytes for a in p)) + b"".join(a.tobytes() for a in p[::-1])
              for y, p in enumerate(lines)]  # fmt: skip
    path = raw_exr(tmp_path / "a.exr", {"Y": 1, "RY": 2, "BY": 2}, (4, 4), chunks)
    with pytest.raises(ExrError, match=r"a.exr stores BY, RY at a lower resolution \(subsampled\)"):
        read_exr(path)


def test_of_mipmaps_the_full_resolution_is_kept(tmp_path):
    levels = [noise((3, 4 >> i, 4 >> i), seed=i) for i in range(3)]
    chunks = [struct.pack("<5i", 0, 0, i, i, a.nbytes) + a.transpose(1, 0, 2).tobytes() for i, a in enumerate(levels)]
    path = raw_exr(tmp_path / "a.exr", dict.fromkeys("RGB", 1), (4, 4), chunks, struct.pack("<IIB", 4, 4, 1))
    color = read_exr(path).color
    assert color.tobytes() == np.ascontiguousarray(levels[0][::-1].transpose(1, 2, 0)).tobytes()
    write_exr(tmp_path / "b.exr", color[:, ::-1], template=path)
    assert "tiledimage" in contents(tmp_path / "b.exr")[0][0]["type"]
    assert read_exr(tmp_path / "b.exr").color.tobytes() == color[:, ::-1].tobytes()
