"""Further layers of a frame: filtered as its colour is, so that what sums to it still does."""

from __future__ import annotations

import inputs
import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from test_bands import METHODS
from test_regression import full_scene
from transfer import scalars, to_planes

from mcdenoise_cl import Denoiser, Frame, FrameError, ParameterError, denoise
from mcdenoise_cl.bands import MOST_PIXELS, most_rows
from mcdenoise_cl.device import SCHEDULE_VARIABLE, SCHEDULES, context_for
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.render import render
from mcdenoise_cl.stages.also import count_sums

SIZES = [(1, 1), (1, 9), (7, 1), (13, 17), (37, 101)]
FEATURES = ("albedo", "normal", "depth")


def split(color, parts=3, seed=1):
    """Layers that sum to a colour: a part that grows to the right, a random one, and the rest."""
    rng = np.random.default_rng(seed)
    right = np.linspace(0, 1, color.shape[1])[:, None]
    random = rng.random(color.shape)
    layers = {"right": color * right * random, "random": color * right * (1 - random), "rest": color * (1 - right)}
    return {name: layer.astype(np.float32) for name, layer in layers.items()}


def scene_of(kind, height, width):
    """Structured input with everything that a frame can have, or random with features only, or nothing but colour."""
    if kind == "structured":
        return full_scene(height, width)
    scene = {name: plane for name, plane in full_scene(height, width).items() if name in FEATURES}
    scene["color"] = inputs.planes("hdr" if kind == "random" else "textured", height, width, 3)
    return scene


def total(layers):
    return sum(layer.astype(np.float64) for layer in layers.values())


def around(image):
    """The largest value within ten pixels, by which rounding in a window is to be measured."""
    padded = np.pad(np.abs(image).max(-1), 10, mode="edge")
    return np.lib.stride_tricks.sliding_window_view(padded, (21, 21)).max((2, 3))[..., None]


@pytest.mark.parametrize(("height", "width"), SIZES)
@pytest.mark.parametrize("kind", ["structured", "random", "features"])
@pytest.mark.parametrize("method", METHODS)
def test_layers_sum_to_the_clean_colour_which_stays_the_same(method, kind, height, width):
    scene = scene_of(kind, height, width)
    plain = denoise(Frame(**scene), method=method)
    found = denoise(Frame(**scene), method=method, also=split(scene["color"]), details=True)
    np.testing.assert_array_equal(found.image, plain)
    assert list(found.also) == ["right", "random", "rest"]
    assert all(layer.shape == plain.shape and layer.dtype == np.float32 for layer in found.also.values())
    off = np.abs(total(found.also) - plain)
    assert (off <= 1e-5 * np.abs(plain)).mean() > 0.999
    assert (off <= 1e-6 * around(scene["color"])).all()


@pytest.mark.parametrize("kind", ["structured", "random"])
@pytest.mark.parametrize("method", METHODS)
def test_a_part_of_the_colour_comes_out_as_that_part_of_the_clean_one(method, kind):
    """To the last bit where it is a power of two; what else there is has no say."""
    scene = scene_of(kind, 37, 101)
    color = scene["color"]
    also = {"same": color, "quarter": color / 4, "minus": -color / 2, "none": 0 * color}
    found = denoise(Frame(**scene), method=method, also=also, details=True)
    for name, part in (("same", 1), ("quarter", 0.25), ("minus", -0.5), ("none", 0)):
        np.testing.assert_array_equal(found.also[name], part * found.image, err_msg=name)


def test_what_is_drawn_back_to_its_input():
    """Where noise explains little of what a fit changes, layers go back as far as the colour does."""
    scene = {name: plane for name, plane in scene_of("structured", 37, 101).items() if not name.startswith("color_")}
    scene["color_variance"] = 1e-4 * scene["color"] ** 2
    color = scene["color"]
    found = denoise(Frame(**scene), method="auto", also={"quarter": color / 4, "half": color / 2}, details=True)
    assert found.report.shares["input"] > 0.3
    np.testing.assert_array_equal(found.also["quarter"], found.image / 4)
    np.testing.assert_array_equal(found.also["half"], found.image / 2)


@pytest.mark.parametrize("parameters", [{}, {"outliers": False}], ids=["outliers", "all"])
@pytest.mark.parametrize("method", METHODS)
def test_each_layer_alone_is_what_it_is_among_others(method, parameters):
    """Nothing is known of a group then, and nothing can be settled: filters are linear by themselves."""
    if method.endswith("nlm"):
        parameters = {"average": "linear"} if parameters else {}
    scene = scene_of("structured", 37, 101)
    layers = split(scene["color"])
    denoiser = Denoiser(37, 101, method=method, **parameters)
    alone = {}
    for name, layer in layers.items():
        clean = denoiser(Frame(**scene), also={name: layer})
        alone |= denoiser.also
        assert np.abs(alone[name] - clean).max() > 0.1
    assert (np.abs(total(alone) - clean) <= 1e-4 * around(clean)).all()
    denoiser(Frame(**scene), also=layers)
    for name, layer in denoiser.also.items():
        assert (np.abs(layer - alone[name]) <= 1e-4 * around(clean)).all(), name


@pytest.mark.parametrize("method", METHODS)
def test_a_constant_layer_stays(method):
    """Where no outlier's light moves; weights add up to 1 for whatever is averaged."""
    scene = scene_of("structured", 37, 101)
    parameters = {} if method.endswith("nlm") else {"outliers": False}
    also = {"constant": np.full_like(scene["color"], 0.7)}
    found = denoise(Frame(**scene), method=method, also=also, details=True, **parameters)
    kept = found.image > 0  # what a fit takes below 0 becomes 0, in the layers too
    assert kept.mean() > 0.95
    np.testing.assert_allclose(found.also["constant"][kept], 0.7, rtol=2e-4)


@pytest.mark.parametrize("method", METHODS)
def test_where_the_colour_ends_at_0_its_layers_do(method):
    """Fits overshoot beside a bright edge; a negative pixel may stay, and is what its layers sum to."""
    scene = scene_of("structured", 37, 101)
    scene["color"][:, ::3] *= 1e-3
    scene["color"][5:9, 20:40] *= -1
    parameters = {} if method.endswith("nlm") else {"outliers": False}
    found = denoise(Frame(**scene), method=method, also=split(scene["color"]), details=True, **parameters)
    off = np.abs(total(found.also) - found.image)
    assert (off <= 1e-6 * around(scene["color"])).all()
    if not method.endswith("nlm"):
        ended = found.image == 0
        assert ended.any()
        assert all((layer[ended] == 0).all() for layer in found.also.values())


@pytest.mark.parametrize("average", ["linear", "compressed", "tonemapped"])
def test_whatever_nlm_averages(average):
    scene = scene_of("random", 37, 101)
    found = denoise(scene["color"], method="nlm", average=average, also=split(scene["color"]), details=True)
    np.testing.assert_array_equal(found.image, denoise(scene["color"], method="nlm", average=average))
    assert (np.abs(total(found.also) - found.image) <= 1e-5 * found.image).mean() > 0.999


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("method", METHODS)
def test_both_schedules(method, schedule, can_be_right, monkeypatch):
    can_be_right(schedule)
    monkeypatch.setenv(SCHEDULE_VARIABLE, schedule)
    scene = scene_of("structured", 13, 17)
    color = scene["color"]
    found = denoise(Frame(**scene), method=method, also=split(color) | {"half": color / 2}, details=True)
    np.testing.assert_array_equal(found.also["half"], found.image / 2)
    del found.also["half"]
    assert (np.abs(total(found.also) - found.image) <= 1e-4 * around(color)).all()


@pytest.mark.parametrize("method", METHODS)
def test_bands_change_no_bit_of_a_layer(method):
    height, width = 470, 41
    scene = full_scene(height, width)
    scene["color"][[127, 128, 300], [3, 4, 5]] *= 500
    also = split(scene["color"])
    also["rest"][200, 7] = np.nan
    also["half"] = np.clip(also["right"], 0, 6e4).astype("f2")
    whole, bands = (Denoiser(height, width, method=method) for _ in range(2))
    bands._rows = bands._least_rows
    assert bands._rows < height
    np.testing.assert_array_equal(bands(Frame(**scene), also=also), whole(Frame(**scene), also=also))
    for name, layer in whole.also.items():
        np.testing.assert_array_equal(bands.also[name], layer, err_msg=name)
        assert layer.dtype == also[name].dtype
    assert bands.report.replaced == whole.report.replaced == {"also.rest": 1}


@pytest.mark.parametrize("method", ["nlm", "auto"])
def test_device_arrays(method, device):
    scene = scene_of("structured", 37, 101)
    also = split(scene["color"]) | {"double": scene["color"].astype("f2")}
    expected = denoise(Frame(**scene), method=method, also=also, details=True)
    context = cl.Context([device])  # kept: upstream/intel_context.py
    queue = cl.CommandQueue(context, device)
    frame = Frame(**{name: cl_array.to_device(queue, plane) for name, plane in scene.items()})
    wide = {name: cl_array.to_device(queue, np.repeat(layer, 2, axis=1))[:, ::2] for name, layer in also.items()}
    found = denoise(frame, method=method, also=wide, details=True)
    np.testing.assert_array_equal(found.image.get(), expected.image)
    for name, layer in expected.also.items():
        assert found.also[name].dtype == layer.dtype
        np.testing.assert_array_equal(found.also[name].get(), layer)


def test_rendered_layers():
    """Two renders with seeds of their own are the light of two worlds, whose sum is the picture."""
    frame = render("room", spp=4, width=40, height=24, halves=True, variant="scalar_rgb")
    also = {"first": frame.color_a / 2, "second": frame.color_b / 2}
    for method in METHODS:
        found = denoise(frame, method=method, also=also, details=True)
        np.testing.assert_array_equal(found.image, denoise(frame, method=method))
        off = np.abs(total(found.also) - found.image)
        assert (off <= 1e-5 * np.abs(found.image)).mean() > 0.999
        assert np.abs(also["first"] - found.also["first"]).mean() > 1e-3  # it has been filtered


def test_a_pixel_that_is_not_finite_is_replaced_and_counted():
    color = inputs.planes("textured", 37, 101, 3)
    also = split(color)
    also["random"][5, 6, 1] = np.inf
    found = denoise(color, method="nlm", also=also, details=True)
    assert found.report.replaced == {"also.random": 1}
    assert all(np.isfinite(layer).all() for layer in found.also.values())
    far = np.ones(color.shape[:2], bool)
    far[:15, :15] = False
    assert (np.abs(total(found.also) - found.image)[far] <= 1e-5).all()


def test_layers_of_the_last_frame_alone():
    color = inputs.planes("uniform", 13, 17, 3)
    denoiser = Denoiser(13, 17, method="nlm")
    with pytest.raises(ParameterError, match="denoise a frame first"):
        _ = denoiser.also
    denoiser(color, also={"color": color})
    assert list(denoiser.also) == ["color"]
    denoiser(color)
    assert denoiser.also == {}
    assert denoise(color, method="nlm", details=True).also == {}


@pytest.mark.parametrize(
    ("also", "message"),
    [
        ([1, 2], r"also is a list: pass a dict of arrays by their names"),
        ({3: np.zeros((13, 17, 3))}, r"also has the name 3: give the names of layers as text"),
        ({"a": np.zeros((13, 17))}, r"also\['a'\] is \(13, 17\) but \(H, W, 3\) is needed"),
        ({"a": np.zeros((13, 16, 3))}, r"also\['a'\] is \(13, 16, 3\) but color is \(13, 17, 3\)"),
        ({"a": np.zeros((13, 17, 3), int)}, r"also\['a'\] has dtype int64 but float16, float32 or float64"),
        ({"a": "b"}, r"also\['a'\] is a str: pass a NumPy array"),
        ({"depth": None}, r"also\['depth'\] is a NoneType"),
    ],
)
def test_what_layers_must_be(also, message):
    with pytest.raises(FrameError, match=message):
        denoise(np.zeros((13, 17, 3), np.float32), method="nlm", also=also)


def test_layers_lie_where_the_frame_does(device):
    context = cl.Context([device])  # kept: upstream/intel_context.py
    queue = cl.CommandQueue(context, device)
    color = np.ones((13, 17, 3), np.float32)
    on_device = cl_array.to_device(queue, color)
    with pytest.raises(FrameError, match=r"also\['a'\] is a device array but color is a NumPy array"):
        denoise(color, method="nlm", also={"a": on_device})
    with pytest.raises(FrameError, match=r"also\['a'\] is a NumPy array but color is a device array"):
        denoise(on_device, method="nlm", also={"a": color})
    other_context = cl.Context([device])
    other = cl_array.to_device(cl.CommandQueue(other_context, device), color)
    with pytest.raises(FrameError, match=r"also.a lies in another OpenCL context"):
        denoise(on_device, method="nlm", also={"a": other})


def test_planes_of_many_layers_are_counted_with_32_bits():
    assert most_rows(1920, 0) == most_rows(1920, 3) == MOST_PIXELS // 1920
    for layers in (10, 20, 100):
        assert most_rows(1920, layers) * 1920 * 3 * layers < 2**31


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("width", [1, 255, 257, 4096])
def test_whole_pixels_are_counted_in_rows_of_any_length(schedule, width, device, can_be_right, monkeypatch):
    """4096 pixels with 24 layers are more turns of a loop than upstream/rusticl_loops.py gets."""
    can_be_right(schedule)
    monkeypatch.setenv(SCHEDULE_VARIABLE, schedule)
    engine = Engine(cl.CommandQueue(context_for(device), device))
    rng = np.random.default_rng(0)
    layers = rng.random((2, width, 72), dtype=np.float32)
    color = layers.reshape(2, width, 24, 3).sum(2)
    broken = rng.random((2, width)) < 0.3
    color[broken, 1] *= np.float32(1.01)
    planes = to_planes(engine, layers), to_planes(engine, color)
    assert scalars(engine, count_sums(engine, [planes], 2, width).counted, dtype=np.int32)[0] == (~broken).sum()
