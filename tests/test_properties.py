"""Property-based tests: whatever is passed, the answer is right or one of our own errors in one sentence."""

import decimal
import fractions
import math
import tempfile
from pathlib import Path

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mcdenoise_cl import Denoiser, Frame, FrameError, ParameterError, denoise, methods, read_exr, write_exr
from mcdenoise_cl.device import context_for
from mcdenoise_cl.errors import DeviceError, McdenoiseError
from mcdenoise_cl.frame import DTYPES, PLANES, SCALAR_PLANES
from mcdenoise_cl.methods.parameters import make, parse

FEW = settings(deadline=None, derandomize=True, max_examples=12, suppress_health_check=list(HealthCheck), database=None)
MANY = settings(FEW, max_examples=150)

#: Kernels are built anew for each size on PoCL, and for each window, so there are few of both.
SIZES = ((1, 9), (13, 17))
SETTINGS = {
    "nlm": {"search_radius": 2, "patch_radius": 0},
    "ssim-nlm": {"search_radius": 2, "patch_radius": 1, "guided_radius": 0},
    "regression": {"search_radius": 2, "patch_radius": 1},
    "guided": {"block": 1},
    "auto": {"search_radius": 3},
}

junk = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.sampled_from([10**400, -(10**400), 2**31, 2**63, -1, 0]),
    st.floats(),
    st.text(max_size=5),
    st.binary(max_size=3),
    st.complex_numbers(),
    st.lists(st.integers(), max_size=2),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=1),
    st.sampled_from([decimal.Decimal("NaN"), decimal.Decimal(3), fractions.Fraction(7, 2), object(), int, ...]),
    st.sampled_from([np.float32("nan"), np.int8(-3), np.float16(2.5), np.bool_(True), np.array(3), np.array([1, 2])]),
    st.sampled_from([np.array("x"), np.array(["a", "b"]), np.datetime64("2020-01-01"), np.ma.masked]),
)


@MANY
@given(st.data())
def test_a_parameter_is_checked_whatever_it_is(data):
    method = data.draw(st.sampled_from(methods()))
    info = data.draw(st.sampled_from(method.parameters))
    value = data.draw(junk)
    try:
        made = getattr(make(method.make, method.name, {info.name: value}), info.name)
    except ParameterError as error:
        assert info.name in str(error) and len(str(error)) < 400 and "\n" not in str(error)
        return
    if made is None:
        assert info.default is None and value is None
        return
    assert type(made) is info.type
    if info.type in (int, float):
        assert math.isfinite(made) and made == info.type(value)
        assert (info.low is None or made >= info.low) and (info.high is None or made <= info.high)


@MANY
@given(st.data(), st.text(max_size=8) | st.floats().map(str) | st.integers().map(str))
def test_a_parameter_is_checked_on_the_command_line(data, text):
    method = data.draw(st.sampled_from(methods()))
    info = data.draw(st.sampled_from(method.parameters))
    try:
        made = parse(info, text)
    except ParameterError as error:
        assert str(error).startswith(f"{info.name} is ")
        return
    assert made is None or type(made) is info.type


@MANY
@given(junk, st.sampled_from(["method", "preset", "height", "width", "device"]))
def test_other_arguments_are_checked_whatever_they_are(value, name):
    arguments = {"height": 3, "width": 4, "method": "nlm"} | {name: value}
    if name == "preset":
        del arguments["method"]
    try:
        denoiser = Denoiser(arguments.pop("height"), arguments.pop("width"), **arguments)
    except McdenoiseError as error:
        assert "\n" not in str(error)
    else:
        assert denoiser.width >= 1 and denoiser.height >= 1


shapes = st.one_of(
    st.sampled_from([(4, 6, 3), (4, 6), (4, 6, 1), (4, 6, 4), (3, 4, 6), (4, 5, 3), (4, 5), (0, 6, 3), (), (6,)]),
    st.lists(st.integers(0, 5), max_size=4).map(tuple),
)
dtypes = st.sampled_from(["f2", "f4", "f8", "g", "u1", "i4", "?", "c8", "O", "U1", "S2", "M8[s]", "V4", ">f4", ">f8"])


@MANY
@given(st.dictionaries(st.sampled_from(PLANES), st.tuples(shapes, dtypes) | junk, max_size=5))
def test_a_frame_is_checked_whatever_it_is_made_of(given_planes):
    planes = {}
    for name, plane in given_planes.items():
        planes[name] = np.zeros(*plane) if isinstance(plane, tuple) else plane
    try:
        frame = Frame(planes.pop("color", None), **planes)
    except FrameError as error:
        assert str(error) and "\n" not in str(error)
        return
    for name, plane in frame.planes().items():
        assert plane.shape == frame.shape + (() if name in SCALAR_PLANES else (3,))
        assert plane.dtype in DTYPES


def laid_out(array, layout):
    """The same numbers, elsewhere in memory."""
    if layout == "fortran":
        return np.asfortranarray(array)
    if layout == "reversed":
        return np.ascontiguousarray(array[::-1, ::-1])[::-1, ::-1]
    if layout == "columns apart":
        return np.repeat(array, 3, axis=1)[:, 1::3]
    if layout == "rows apart":
        return np.repeat(array, 2, axis=0)[::2]
    if layout == "channels reversed":
        return np.ascontiguousarray(array[..., ::-1])[..., ::-1] if array.ndim == 3 else array
    if layout == "channels first":
        return np.moveaxis(np.ascontiguousarray(np.moveaxis(array, -1, 0)), 0, -1)
    if layout == "unaligned":
        raw = np.zeros(array.nbytes + 1, np.uint8)[1:].view(array.dtype).reshape(array.shape)
        raw[...] = array
        return raw
    if layout == "one row" and (array == array[:1]).all():
        return np.broadcast_to(array[:1], array.shape)
    copy = array.copy()
    copy.flags.writeable = False
    return copy


LAYOUTS = ("fortran", "reversed", "columns apart", "rows apart", "channels reversed", "channels first", "unaligned")
LAYOUTS += ("one row", "read-only")
kinds = st.sampled_from(["noise", "constant", "black", "negative", "huge", "tiny", "holes", "rows alike"])


def pixels(kind, shape, seed):
    rng = np.random.default_rng(seed)
    noise = rng.lognormal(-1, 1, shape)
    if kind == "holes":
        noise[rng.random(shape) < 0.2] = rng.choice([np.nan, np.inf, -np.inf])
        noise.flat[0] = 0.5
    elif kind == "rows alike":
        noise = np.repeat(noise[:1], shape[0], axis=0)
    factors = {"constant": 0, "black": 0, "negative": -1, "huge": 1e30, "tiny": 1e-30}
    return noise * factors.get(kind, 1) + (0.25 if kind == "constant" else 0)


#: What comes with the colour; kernels are built for each of these too.
COMPANY = ((), ("albedo", "normal", "depth", "color_variance"), ("albedo", "albedo_variance", "color_a", "color_b"))


@st.composite
def frames(draw):
    size = SIZES[-1]
    names = {"color", *draw(st.sampled_from(COMPANY))}
    planes = {}
    for i, name in enumerate(sorted(names)):
        plane = pixels(draw(kinds), size if name in SCALAR_PLANES else (*size, 3), i)
        plane = np.abs(plane) if name.endswith("variance") else plane
        with np.errstate(over="ignore"):
            planes[name] = plane.astype(draw(st.sampled_from(DTYPES)))
    if not np.isfinite(planes["color"]).all(axis=-1).any():  # 1e30 in half
        planes["color"] = np.ones_like(planes["color"])
    return planes


@pytest.mark.parametrize("method", list(SETTINGS))
@FEW
@given(st.data())
def test_any_frame_in_any_layout_gives_the_same_finite_bits(method, data):
    planes = data.draw(frames())
    if method == "ssim-nlm":
        planes = {"albedo": np.ones_like(planes["color"]), "normal": np.ones_like(planes["color"])} | planes
    parameters = SETTINGS[method]
    expected = denoise(Frame(**planes), method=method, **parameters)
    assert expected.shape == planes["color"].shape and expected.dtype == planes["color"].dtype
    assert np.isfinite(expected).all()
    changed = {name: laid_out(plane, data.draw(st.sampled_from(LAYOUTS))) for name, plane in planes.items()}
    before = {name: plane.tobytes() for name, plane in changed.items()}
    out = laid_out(np.zeros_like(expected), data.draw(st.sampled_from(LAYOUTS[:-2])))
    result = denoise(Frame(**changed), method=method, out=out, **parameters)
    assert result is out and out.tobytes() == expected.tobytes()
    assert {name: plane.tobytes() for name, plane in changed.items()} == before


@FEW
@given(frames(), st.sampled_from(["nlm", "auto"]))
def test_the_result_may_be_written_over_its_input(planes, method):
    parameters = SETTINGS[method]
    expected = denoise(Frame(**planes), method=method, **parameters)
    denoise(Frame(**planes), method=method, out=planes["color"], **parameters)
    assert planes["color"].tobytes() == expected.tobytes()


@FEW
@given(st.data())
def test_device_arrays_of_any_strides_give_the_bits_of_the_host(device, data):
    queue = cl.CommandQueue(context_for(device), device)
    height, width = data.draw(st.sampled_from(SIZES))
    dtype = data.draw(st.sampled_from(["f2", "f4"]))
    rows, columns, start = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 3)), data.draw(st.integers(0, 2))
    order = data.draw(st.sampled_from("CF"))
    big = pixels("noise", (start + height * rows, start + width * columns, 3), 0).astype(dtype)
    inside = (slice(start, None, rows), slice(start, None, columns))
    whole = cl_array.to_device(queue, np.asarray(big, order=order))
    expected = denoise(big[inside], method="nlm", **SETTINGS["nlm"])
    assert denoise(whole[inside], method="nlm", **SETTINGS["nlm"]).get().tobytes() == expected.tobytes()
    denoise(whole[inside], method="nlm", out=whole[inside], **SETTINGS["nlm"])
    big[inside] = expected
    assert whole.get().tobytes(order) == big.tobytes(order), "and nothing beside it is written"


@settings(FEW, max_examples=40)
@given(
    st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.sampled_from(DTYPES),
    st.sampled_from(["none", "rle", "zips", "zip", "piz"]),
    st.sampled_from(LAYOUTS),
    st.booleans(),
)
def test_a_file_holds_what_was_written(size, dtype, compression, layout, template):
    color = pixels("noise", (*size, 3), 1).astype(dtype)
    frame = Frame(laid_out(color, layout), depth=laid_out(color[..., 0], layout))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.exr"
        write_exr(path, frame, compression=compression)
        if template:
            write_exr(path, laid_out(color, layout), template=path)
        back = read_exr(path)
        assert [p.name for p in path.parent.iterdir()] == ["a.exr"]
    stored = np.float32 if dtype == np.float64 else dtype
    np.testing.assert_array_equal(back.color, color.astype(stored))
    np.testing.assert_array_equal(back.depth, color[..., 0].astype(stored))


@pytest.mark.parametrize("method", list(SETTINGS))
@pytest.mark.parametrize("end", ["low", "high"])
def test_the_ends_of_every_range(method, end, tiles_work):
    """All whole numbers at an end of their ranges at once, then each other parameter by itself."""
    planes = {
        name: pixels("noise", (13, 17, 3), i).astype("f4") for i, name in enumerate(("color", "albedo", "normal"))
    }
    [infos] = [m.parameters for m in methods() if m.name == method]
    for info in infos:
        value = getattr(info, end) if info.type is not int else None
        if value is None and end == "high" and info.type is float:
            value = 3e38
        if value is None:
            continue
        image = denoise(Frame(**planes), method=method, **{info.name: value})
        assert np.isfinite(image).all(), f"{info.name}={value}"
    whole = {info.name: getattr(info, end) for info in infos if info.type is int}
    if end == "high" and "nlm" in method and not tiles_work:
        with pytest.raises(DeviceError, match="ends long loops early"):
            denoise(Frame(**planes), method=method, **whole)
    else:
        assert np.isfinite(denoise(Frame(**planes), method=method, **whole)).all()
