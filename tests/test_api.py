"""`denoise` and `Denoiser`: sides, dtypes, outputs, reports, threads, and what is refused."""

import threading

import inputs
import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from test_stages import close

from mcdenoise_cl import Denoiser, DeviceError, Frame, FrameError, ParameterError, denoise
from mcdenoise_cl.device import context_for

METHODS = ["nlm", "ssim-nlm", "regression", "auto", "guided"]


def scene(height=31, width=64, seed=0):
    return inputs.features(height, width, seed=seed)


@pytest.fixture
def queue(device):
    return cl.CommandQueue(context_for(device), device)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_result_has_the_dtype_of_the_color(method, dtype):
    planes = {name: plane.astype(dtype) for name, plane in scene().items()}
    result = denoise(Frame(**planes), method=method)
    assert result.shape == (31, 64, 3) and result.dtype == dtype
    reference = denoise(Frame(**scene()), method=method)
    close(result, reference, tolerance=1e-2 if dtype == "f2" else 1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_any_memory_layout_gives_the_same_bits(method):
    planes = scene()
    expected = denoise(**rename(planes), method=method)
    for change in (
        np.asfortranarray,
        lambda a: a[::-1][::-1],
        lambda a: np.repeat(a, 2, axis=1)[:, ::2],
        lambda a: np.ascontiguousarray(a[::-1, ::-1])[::-1, ::-1],
    ):
        changed = {name: change(plane) for name, plane in planes.items()}
        np.testing.assert_array_equal(denoise(**rename(changed), method=method), expected)
    for plane in planes.values():
        plane.flags.writeable = False
    np.testing.assert_array_equal(denoise(**rename(planes), method=method), expected)


def rename(planes):
    return {"frame_or_color" if name == "color" else name: plane for name, plane in planes.items()}


@pytest.mark.parametrize("method", METHODS)
def test_input_is_left_alone_and_runs_repeat_to_the_bit(method):
    planes = scene()
    planes["color"][3, 4] = np.nan
    before = {name: plane.copy() for name, plane in planes.items()}
    denoiser = Denoiser(31, 64, method=method)
    first, second = denoiser(Frame(**planes)), denoiser(Frame(**planes))
    np.testing.assert_array_equal(first, second)
    assert first is not second
    for name, plane in planes.items():
        np.testing.assert_array_equal(plane, before[name])


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
def test_out(dtype):
    planes = scene()
    expected = denoise(**rename(planes))
    out = np.full((31, 64, 3), np.nan, dtype)
    assert denoise(**rename(planes), out=out) is out
    np.testing.assert_array_equal(out, expected.astype(dtype))
    wide = np.zeros((31, 128, 3), dtype)
    denoise(**rename(planes), out=wide[:, ::2])
    np.testing.assert_array_equal(wide[:, ::2], expected.astype(dtype))
    assert not wide[:, 1::2].any()


def test_out_is_untouched_by_a_frame_that_cannot_be_denoised():
    out = np.full((4, 5, 3), 7.0, np.float32)
    with pytest.raises(FrameError, match="no finite pixel"):
        denoise(np.full((4, 5, 3), np.nan, np.float32), out=out)
    assert (out == 7.0).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", ["f2", "f4"])
def test_device_arrays_come_back_as_device_arrays(queue, method, dtype):
    planes = {name: plane.astype(dtype) for name, plane in scene().items()}
    expected = denoise(Frame(**planes), method=method)
    on_device = {name: cl_array.to_device(queue, plane) for name, plane in planes.items()}
    result = denoise(Frame(**on_device), method=method)
    assert isinstance(result, cl_array.Array)
    assert result.context == queue.context and result.queue == queue and result.dtype == dtype
    np.testing.assert_array_equal(result.get(), expected)
    out = cl_array.zeros(queue, (31, 64, 3), np.float32)
    assert denoise(Frame(**on_device), method=method, out=out) is out
    close(out.get(), expected, tolerance=1e-3 if dtype == "f2" else 0)


def test_device_arrays_with_offset_and_strides(queue):
    big = cl_array.to_device(queue, np.pad(scene()["color"], ((2, 3), (5, 1), (0, 0))))
    view = big[2:-3, 5:-1]
    np.testing.assert_array_equal(denoise(view).get(), denoise(scene()["color"]))


def test_device_double(queue):
    color = cl_array.to_device(queue, scene()["color"].astype(np.float64))
    if "cl_khr_fp64" in queue.device.extensions:
        close(denoise(color).get(), denoise(scene()["color"]))
    else:
        with pytest.raises(DeviceError, match="double"):
            denoise(color)


@pytest.mark.parametrize("method", METHODS)
def test_no_image_crosses_to_the_host(queue, method, monkeypatch):
    """Device in, device out: every way PyOpenCL has to move bytes between host and device is barred meanwhile."""
    on_device = {name: cl_array.to_device(queue, plane) for name, plane in scene().items()}
    denoiser = Denoiser(31, 64, method=method, queue=queue)
    expected = denoiser(Frame(**on_device)).get()
    moved = []

    def spy(name):
        real = getattr(cl, name)

        def wrapper(*arguments, **keywords):
            host = [a for a in arguments if isinstance(a, np.ndarray)]
            if host or name == "enqueue_map_buffer":
                moved.append((name, max((a.nbytes for a in host), default=0)))
            return real(*arguments, **keywords)

        monkeypatch.setattr(cl, name, wrapper)

    for name in ("enqueue_copy", "enqueue_map_buffer"):
        spy(name)
    monkeypatch.setattr(cl_array.Array, "get", lambda *_, **__: pytest.fail("Array.get was called"))
    monkeypatch.setattr(cl_array.Array, "set", lambda *_, **__: pytest.fail("Array.set was called"))
    result = denoiser(Frame(**on_device))
    assert moved == []
    assert denoiser.report.method == method  # a few scalars, on request only
    assert max(size for _, size in moved) <= 64
    monkeypatch.undo()
    np.testing.assert_array_equal(result.get(), expected)


def test_report():
    planes = scene()
    planes["color"][3, 4], planes["normal"][0, :2] = np.inf, np.nan
    denoiser = Denoiser(31, 64, method="ssim-nlm", search_radius=2)
    with pytest.raises(ParameterError, match="no report yet"):
        _ = denoiser.report
    denoiser(Frame(**planes))
    report = denoiser.report
    assert report.method == "ssim-nlm"
    assert report.parameters["search_radius"] == 2 and report.parameters["patch_radius"] == 2
    assert report.replaced == {"color": 1, "normal": 2}
    assert report.exposure > 0 and report.noise_level > 0
    assert {"door", "canny", "guided", "box", "ssim-nlm", "exit"} <= set(report.stage_ms)
    assert all(time > 0 for time in report.stage_ms.values())
    assert denoiser.queue.device.name.strip() in report.device


def test_threads_may_share_a_denoiser_or_have_their_own():
    frames = [Frame(**scene(seed=seed)) for seed in range(4)]
    expected = [denoise(frame) for frame in frames]
    shared = Denoiser(31, 64)
    failures = []

    def work(index, denoiser):
        for turn in range(6):
            which = (index + turn) % len(frames)
            result = (denoiser or denoise)(frames[which])
            if not np.array_equal(result, expected[which]):
                failures.append((index, turn))

    threads = [threading.Thread(target=work, args=(i, shared if i < 4 else None)) for i in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda s: denoise(s["color"], method="ssim-nlm"), FrameError, "needs albedo"),
        (lambda s: denoise(s["color"], albdo=s["albedo"]), ParameterError, "albdo"),
        (lambda s: denoise(s["color"], method="x"), ParameterError, "one of nlm, ssim-nlm, regression, auto, guided"),
        (lambda s: denoise(Frame(s["color"]), albedo=s["albedo"]), FrameError, "put every plane into the Frame"),
        (lambda s: denoise((255 * s["color"]).astype(np.uint8)), FrameError, "carry no scale"),
        (lambda s: denoise(s["color"].tolist()), FrameError, "list"),
        (lambda s: denoise(np.full((4, 5, 3), np.nan)), FrameError, "no finite pixel"),
        (lambda s: denoise(s["color"], out=np.zeros((31, 63, 3))), FrameError, r"\(31, 63, 3\)"),
        (lambda s: denoise(s["color"], out=np.zeros((31, 64, 3), int)), FrameError, "int64"),
        (lambda s: denoise(s["color"], device="no such device"), DeviceError, "no such device"),
        (lambda s: Denoiser(31, 63, method="nlm")(s["color"]), FrameError, "another for this size"),
        (lambda s: Denoiser(0, 63, method="nlm"), ParameterError, "height is 0"),
        (lambda s: Denoiser(3, 63.5, method="nlm"), ParameterError, "width is 63.5"),
        (lambda s: Denoiser(31, 64, method="nlm")(s["color"], colour_a=s["color"]), FrameError, "colour_a"),
    ],
)
def test_misuse_is_explained(call, error, words):
    with pytest.raises(error, match=words):
        call(scene())


def test_misuse_of_device_arrays_is_explained(queue, device):
    color = cl_array.to_device(queue, scene()["color"])
    host = scene()["color"]
    with pytest.raises(FrameError, match="same side"):
        denoise(color, albedo=host)
    with pytest.raises(ParameterError, match="leave device out"):
        denoise(color, device=0)
    with pytest.raises(DeviceError, match="with_queue"):
        denoise(color.with_queue(None))
    with pytest.raises(FrameError, match="out is host memory"):
        denoise(color, out=np.zeros_like(host))
    other_context = cl.Context([device])  # kept: upstream/intel_context.py
    elsewhere = cl.CommandQueue(other_context, device)
    with pytest.raises(FrameError, match="another OpenCL context"):
        denoise(Frame(color, albedo=cl_array.to_device(elsewhere, host), normal=color))
    disorder = cl.command_queue_properties.OUT_OF_ORDER_EXEC_MODE_ENABLE
    if device.queue_properties & disorder:
        with pytest.raises(DeviceError, match="in-order"):
            denoise(color.with_queue(cl.CommandQueue(queue.context, device, properties=disorder)))
    read_only = np.zeros_like(host)
    read_only.flags.writeable = False
    with pytest.raises(FrameError, match="read-only"):
        denoise(host, out=read_only)


def test_memory_stays_flat_over_many_frames():
    """The pool hands back what the frame before used."""
    denoiser = Denoiser(31, 64, method="ssim-nlm")
    frame = Frame(**scene())
    for _ in range(3):
        denoiser(frame)
    held = denoiser._engine._pool.managed_bytes
    for _ in range(20):
        denoiser(frame)
    assert denoiser._engine._pool.managed_bytes == held
