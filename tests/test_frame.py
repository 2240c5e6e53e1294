import dataclasses
import types

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest

from mcdenoise_cl.device import context_for
from mcdenoise_cl.errors import FrameError, McdenoiseError
from mcdenoise_cl.frame import _BESIDE, DTYPES, PLANES, SCALAR_PLANES, VECTOR_PLANES, Frame

H, W = 4, 6


@pytest.fixture(scope="module")
def queue(device):
    return cl.CommandQueue(context_for(device), device)


def plane(name, dtype=np.float32):
    return np.ones((H, W) if name in SCALAR_PLANES else (H, W, 3), dtype)


def all_planes(dtype=np.float32):
    return {name: plane(name, dtype) for name in PLANES}


def refused(**planes):
    with pytest.raises(FrameError) as error:
        Frame(**{"color": plane("color"), **planes})
    return str(error.value)


def test_color_alone_is_enough():
    color = plane("color")
    frame = Frame(color)
    assert frame.shape == (H, W)
    assert not frame.on_device
    assert frame.metadata == {}
    assert frame.planes() == {"color": color}
    assert frame.color is color, "nothing is copied"


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_every_plane_in_every_dtype(dtype):
    given = all_planes(dtype)
    frame = Frame(**given)
    assert all(frame.planes()[name] is given[name] for name in PLANES)


def test_dtypes_may_be_mixed():
    Frame(plane("color", np.float32), depth=plane("depth", np.float64), normal=plane("normal", np.float16))


def test_planes_come_in_a_fixed_order():
    given = all_planes()
    names = list(Frame(**dict(reversed(given.items()))).planes())
    assert names[:4] == ["color", "albedo", "normal", "depth"]
    assert names == [field.name for field in dataclasses.fields(Frame) if field.name not in _BESIDE]
    assert sorted(names) == sorted(PLANES)
    assert list(Frame(given["color"], depth=given["depth"], albedo=given["albedo"]).planes()) == [
        "color",
        "albedo",
        "depth",
    ]


def test_views_are_taken_as_they_are():
    layers = np.ones((H, 2 * W, 7), np.float16)
    frame = Frame(layers[:, ::2, 2::-1], depth=layers[:, ::2, 6])
    assert np.shares_memory(frame.color, layers)


def test_one_pixel_is_a_frame():
    assert Frame(np.ones((1, 1, 3))).shape == (1, 1)


def test_frames_are_frozen_and_equal_only_to_themselves():
    frame = Frame(plane("color"), metadata={"samples_per_pixel": 4})
    with pytest.raises(dataclasses.FrozenInstanceError):
        frame.color = plane("color")
    other = dataclasses.replace(frame, depth=plane("depth"))
    assert other.color is frame.color and other.metadata == frame.metadata
    assert frame == frame and frame != other
    assert {frame: 1}[frame] == 1


def test_replace_checks_again():
    with pytest.raises(FrameError, match="depth is"):
        dataclasses.replace(Frame(plane("color")), depth=np.ones((H, W + 1)))


def test_frame_errors_are_value_errors_of_this_package():
    assert issubclass(FrameError, McdenoiseError) and issubclass(FrameError, ValueError)


def test_color_is_needed():
    assert refused(color=None) == "color is missing: every frame needs a colour plane of shape (H, W, 3)"


@pytest.mark.parametrize("other", [[[[1.0, 1.0, 1.0]]], "color.exr", types.SimpleNamespace(shape=(H, W, 3))])
@pytest.mark.parametrize("name", ["color", "albedo"])
def test_other_types_are_refused(name, other):
    message = refused(**{name: other})
    assert message.startswith(f"{name} is a {type(other).__name__}: pass a NumPy array or a pyopencl.array.Array")


@pytest.mark.parametrize("name", PLANES)
@pytest.mark.parametrize("dtype", ["uint8", "int32", "bool", "complex64", "longdouble", ">f4", "object"])
def test_other_dtypes_are_refused(name, dtype):
    if dtype == "longdouble" and np.dtype(dtype) in DTYPES:
        pytest.skip("long double is double here")
    bad = plane(name).astype(dtype)
    message = refused(**{name: bad})
    assert message.startswith(f"{name} has dtype {bad.dtype} but float16, float32 or float64 is needed: ")
    kind = np.dtype(dtype).kind
    assert ("carry no scale" in message and "/ 255" in message) == (kind in "iu")
    assert ("real part" in message) == (kind == "c")
    assert ".astype('float32')" in message


@pytest.mark.parametrize("name", VECTOR_PLANES)
def test_vector_planes_need_three_channels(name):
    for shape in ((H, W), (H, W, 1), (H, W, 2), (H, W, 3, 1), (W,), ()):
        message = refused(**{name: np.ones(shape)})
        assert message.startswith(f"{name} is {shape} but (H, W, 3) is needed: ")
    assert "[..., :3]" in refused(**{name: np.ones((H, W, 4))})


@pytest.mark.parametrize("name", SCALAR_PLANES)
def test_scalar_planes_need_one_channel(name):
    message = refused(**{name: np.ones((H, W, 3))})
    assert message.startswith(f"{name} is {(H, W, 3)} but (H, W) is needed: ")
    assert f"{name}[..., 0]" in message
    assert f"{name} is (6,) but (H, W) is needed" in refused(**{name: np.ones(W)})


@pytest.mark.parametrize("shape", [(0, W, 3), (H, 0, 3), (0, 0, 3)])
def test_empty_images_are_refused(shape):
    message = refused(color=np.ones(shape))
    assert message == f"color is {shape}, which has no pixels: a frame needs at least one"


@pytest.mark.parametrize("name", [name for name in PLANES if name != "color"])
def test_all_planes_share_one_size(name):
    bad = plane(name)[:-1]
    message = refused(**{name: bad})
    expected = f"{name} is {bad.shape} but color is {(H, W, 3)}: all planes of a frame share height and width"
    assert message == expected


@pytest.mark.parametrize(("have", "lack"), [("color_a", "color_b"), ("color_b", "color_a")])
def test_halves_come_in_pairs(have, lack):
    message = refused(**{have: plane(have)})
    assert message == f"{have} is given but {lack} is not: pass both half buffers, or neither"


@pytest.mark.parametrize("feature", ["albedo", "normal", "depth"])
def test_a_variance_needs_its_feature(feature):
    name = f"{feature}_variance"
    message = refused(**{name: plane(name)})
    assert message == f"{name} is given but {feature} is not: pass {feature} too, or leave {name} out"
    Frame(plane("color"), **{feature: plane(feature), name: plane(name)})
    Frame(plane("color"), color_variance=plane("color_variance"))


@pytest.mark.parametrize("dtype", DTYPES, ids=str)
def test_device_arrays(queue, dtype):
    given = {name: cl_array.to_device(queue, array) for name, array in all_planes(dtype).items()}
    frame = Frame(**given)
    assert frame.on_device
    assert frame.shape == (H, W)
    assert all(frame.planes()[name] is given[name] for name in PLANES)


def test_device_arrays_meet_the_same_checks(queue):
    def on_device(array):
        return cl_array.to_device(queue, array)

    color = on_device(plane("color"))
    assert "albedo is (4, 5, 3) but color is (4, 6, 3)" in refused(color=color, albedo=on_device(np.ones((H, 5, 3))))
    assert "color has dtype uint8 but" in refused(color=on_device(np.ones((H, W, 3), np.uint8)))
    assert "color is (4, 6) but (H, W, 3) is needed" in refused(color=on_device(np.ones((H, W))))


def test_host_and_device_do_not_mix(queue):
    device = cl_array.to_device(queue, plane("albedo"))
    message = refused(albedo=device)
    assert message == "color is a NumPy array but albedo is a device array: pass every plane on the same side"
    message = refused(color=device, depth=plane("depth"), normal=device)
    assert message == "depth is a NumPy array but color is a device array: pass every plane on the same side"
