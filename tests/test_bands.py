"""Frames filtered in bands of rows: to the same bits as whole, within the memory that is allowed."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest
from inputs import planes
from test_auto import full_scene, with_little_noise

from mcdenoise_cl import Denoiser, Frame, denoise
from mcdenoise_cl.bands import BYTES, fewer_rows, first_guess
from mcdenoise_cl.engine import Engine
from mcdenoise_cl.errors import DeviceError, NoRoomError, ParameterError
from mcdenoise_cl.frame import PLANES
from mcdenoise_cl.methods import get_method
from mcdenoise_cl.stages.rows import cut

METHODS = ("nlm", "ssim-nlm", "guided", "regression", "auto")
HEIGHT, WIDTH = 470, 41


@pytest.fixture(scope="module")
def scene():
    """Everything a frame can have, with fireflies, and pixels that are not finite."""
    scene = full_scene(HEIGHT, WIDTH)
    rng = np.random.default_rng(0)
    scene["color"][rng.random((HEIGHT, WIDTH)) < 0.002] *= 500
    scene["color"][[127, 128, 300], [3, 4, 5]] = np.nan
    scene["depth"][[191, 192, 383], [3, 4, 5]] = np.inf
    return scene


def without(scene, *names):
    return {name: plane for name, plane in scene.items() if name not in names}


def in_bands(method, rows=None, **parameters):
    """A Denoiser of the scene's size that takes so many rows at a time, or as few as it can."""
    denoiser = Denoiser(HEIGHT, WIDTH, method=method, **parameters)
    denoiser._rows = max(rows or 0, denoiser._least_rows)
    assert denoiser._rows < HEIGHT
    return denoiser


@pytest.mark.parametrize("height", [1, 63, 64, 200, 1000, 2161])
@pytest.mark.parametrize(("reach", "align"), [(0, 1), (1, 1), (5, 16), (103, 64), (36, 128), (0, 4)])
@pytest.mark.parametrize("more", [0, 1, 17, 500])
def test_each_row_is_wanted_once_and_has_its_surroundings(height, reach, align, more):
    most = 2 * align + 2 * reach + more
    bands = cut(height, most, reach, align)
    assert [row for band in bands for row in range(band.first, band.last)] == list(range(height))
    for band in bands:
        assert band.start % align == 0 and band.stop - band.start <= most
        assert band.first < band.last and band.first % align == 0
        assert band.start <= max(band.first - reach, 0) and band.stop >= min(band.last + reach, height)


@pytest.mark.parametrize("rows", [None, 400])
@pytest.mark.parametrize("method", METHODS)
def test_bands_change_no_bit(scene, method, rows):
    whole, bands = Denoiser(HEIGHT, WIDTH, method=method), in_bands(method, rows)
    np.testing.assert_array_equal(bands(Frame(**scene)), whole(Frame(**scene)))
    one, many = whole.report, bands.report
    assert (many.exposure, many.noise_level, many.replaced) == (one.exposure, one.noise_level, one.replaced)
    assert one.replaced["color"] == 3
    assert many.energy_removed == pytest.approx(one.energy_removed, rel=1e-4)
    assert many.features_used == pytest.approx(one.features_used)
    assert many.shares == pytest.approx(one.shares, rel=1e-4)
    if method == "auto":
        assert many.estimated_error == pytest.approx(one.estimated_error, rel=1e-4)
        np.testing.assert_array_equal(bands.model_map, whole.model_map)
        np.testing.assert_array_equal(bands.error_map, whole.error_map)
    else:
        assert many.estimated_error is bands.model_map is bands.error_map is None


@pytest.mark.parametrize("noise", [("color_variance",), ("color_a", "color_b")], ids="+".join)
def test_bands_of_a_frame_with_little_noise_change_no_bit(scene, noise):
    """Which is filtered twice, or not at all, as the whole frame is."""
    quiet = with_little_noise(scene)
    frame = Frame(**{name: quiet[name] for name in ("color", "albedo", *noise)})
    whole, bands = Denoiser(HEIGHT, WIDTH), in_bands("auto")
    np.testing.assert_array_equal(bands(frame), whole(frame))


@pytest.mark.parametrize(
    "lost",
    [
        ("color_a", "color_b"),
        ("color_variance",),
        ("color_variance", "color_a", "color_b"),
        ("albedo_variance", "normal_variance", "depth_variance"),
        ("albedo", "normal", "depth", "albedo_variance", "normal_variance", "depth_variance"),
    ],
    ids=["variance", "halves", "image", "exact features", "no features"],
)
@pytest.mark.parametrize("method", ["guided", "auto"])
def test_bands_change_no_bit_whatever_the_frame_has(scene, method, lost):
    frame = Frame(**without(scene, *lost))
    np.testing.assert_array_equal(in_bands(method)(frame), denoise(frame, method=method))


@pytest.mark.parametrize(
    ("method", "parameters"),
    [
        ("nlm", {"average": "linear", "search_radius": 5}),
        ("nlm", {"average": "tonemapped", "exposure": 0.3}),
        ("ssim-nlm", {"stabilised": False, "guided_radius": 9}),
        ("guided", {"radius": 1, "block": 3, "residual_radius": 2, "prefilter": True}),
        ("guided", {"spread_radius": 5, "exposure": 2.0}),
        ("regression", {"spread_radius": 3, "search_radius": 3}),
        ("regression", {"outliers": False}),
        ("auto", {"search_radius": 4, "wide_stride": 2}),
    ],
)
def test_bands_change_no_bit_whatever_the_parameters(scene, method, parameters):
    frame = Frame(**scene)
    np.testing.assert_array_equal(in_bands(method, **parameters)(frame), denoise(frame, method=method, **parameters))


@pytest.mark.parametrize("dtype", ["f2", "f4", "f8"])
@pytest.mark.parametrize("method", ["nlm", "regression"])
def test_bands_of_any_type_and_layout(scene, method, dtype):
    frame = Frame(**{name: np.clip(plane, -6e4, 6e4).astype(dtype) for name, plane in scene.items()})
    expected = denoise(frame, method=method)
    denoiser, out = in_bands(method), np.zeros((HEIGHT, WIDTH, 6), dtype)[..., ::2]
    np.testing.assert_array_equal(denoiser(frame, out=out), expected)
    queue = denoiser.queue
    arrays = {name: cl_array.to_device(queue, np.ascontiguousarray(p)) for name, p in frame.planes().items()}
    on_device = Denoiser(HEIGHT, WIDTH, method=method, queue=queue)
    on_device._rows = denoiser._rows
    if dtype != "f8" or "cl_khr_fp64" in queue.device.extensions:
        got = on_device(Frame(**arrays)).get()
        np.testing.assert_allclose(got, expected, rtol=1e-6) if dtype == "f8" else np.testing.assert_array_equal(
            got, expected
        )


#: What each method makes use of; not depth, whose scale is that of the whole frame, nor what edges are linked in.
TAKEN = [
    (method, plane)
    for method in METHODS
    for plane in get_method(method).takes(p for p in PLANES if not p.startswith("depth"))
    if (method, plane) != ("ssim-nlm", "albedo")
]


@pytest.mark.parametrize(("method", "plane"), TAKEN)
def test_what_a_row_depends_on_lies_within_reach(scene, method, plane):
    """A change of one row, with what comes from the whole frame given: as far as any pixel of it changes another."""
    fixed = {"exposure": 1.0} | ({"h": 0.1} if method.endswith("nlm") else {"outliers": False})
    if method == "ssim-nlm":
        fixed |= {"canny_low": 0.5, "canny_high": 1.0}
    denoiser = Denoiser(HEIGHT, WIDTH, method=method, **fixed)
    clean = {name: np.nan_to_num(value, posinf=1.0) for name, value in scene.items()}
    frame = Frame(**clean)
    before = denoiser(frame)
    farthest = 0
    for row in (0, 229, 234, HEIGHT - 1):
        changed = clean[plane].copy()
        changed[row, 1:] = changed[row, 1:] * 3 + 0.5  # normals are counted from the frame's first pixel
        after = denoiser(Frame(**clean | {plane: changed}))
        rows = np.flatnonzero((after != before).any(axis=(1, 2)))
        farthest = max(farthest, abs(rows - row).max(initial=0))
    assert 0 < farthest <= denoiser.method.reach(denoiser.parameters)


@pytest.mark.parametrize("method", METHODS)
def test_no_more_memory_is_held_than_allowed(scene, method, monkeypatch):
    held = []
    allocate = Engine.memory
    monkeypatch.setattr(Engine, "memory", lambda self, size: [allocate(self, size), held.append(self.held)][0])
    frame = Frame(**{name: np.tile(plane, (2, 4) + (1,) * (plane.ndim - 2)) for name, plane in scene.items()})
    whole = denoise(frame, method=method)
    needed, budget = max(held) / 2**20, int(0.6 * max(held) / 2**20)
    held.clear()
    np.testing.assert_array_equal(denoise(frame, method=method, max_memory_mb=budget), whole)
    assert max(held) / 2**20 <= max(budget, 1) < needed


def test_too_little_memory_is_an_error_that_says_so(scene):
    out = np.full((HEIGHT, WIDTH, 3), 7, np.float32)
    denoiser = Denoiser(HEIGHT, WIDTH, max_memory_mb=1)
    with pytest.raises(NoRoomError, match=r"max_memory_mb is 1, which is no room for \d+ rows of 41 pixels"):
        denoiser(Frame(**scene), out=out)
    assert (out == 7).all()
    with pytest.raises(ParameterError, match="denoise a frame first"):
        _ = denoiser.report


@pytest.mark.parametrize("value", [0, -5, 1.5, "many", True])
def test_memory_is_a_whole_number(value):
    with pytest.raises(ParameterError, match=r"max_memory_mb is .* but a whole number of at least 1"):
        Denoiser(4, 6, max_memory_mb=value)


@pytest.mark.parametrize("where", ["allocation", "launch"])
def test_a_device_without_room_gets_fewer_rows(scene, where, monkeypatch):
    """Some devices say so when memory is asked for, others when a kernel is to work on it."""
    frame, sizes = Frame(**scene), []
    allocate = Engine.memory
    with monkeypatch.context() as patch:
        patch.setattr(Engine, "memory", lambda self, size: [allocate(self, size), sizes.append(size)][0])
        expected = denoise(frame, method="regression")
    denoiser, failed = Denoiser(HEIGHT, WIDTH, method="regression"), []

    def no_room(size):
        if size > 0.7 * max(sizes):
            failed.append(size)
            raise cl.MemoryError("mem_object_allocation_failure")

    if where == "allocation":
        pool = denoiser._engine._pool

        class Small:
            def allocate(self, size):
                no_room(size)
                return pool.allocate(size)

            def __getattr__(self, name):
                return getattr(pool, name)

        denoiser._engine._pool = Small()
    else:
        kernel = Engine.kernel

        def checked(self, file, name, **defines):
            found = kernel(self, file, name, **defines)

            def launch(queue, size, local, *arguments):
                for argument in arguments:
                    if isinstance(argument, cl.MemoryObjectHolder):
                        no_room(argument.size)
                return found(queue, size, local, *arguments)

            return launch

        monkeypatch.setattr(Engine, "kernel", checked)
    np.testing.assert_array_equal(denoiser(frame), expected)
    assert failed and denoiser._rows < HEIGHT
    failed.clear()
    np.testing.assert_array_equal(denoiser(frame), expected)
    assert not failed  # it is remembered


def test_a_device_without_any_room_is_an_error(monkeypatch):
    denoiser = Denoiser(HEIGHT, WIDTH, method="nlm")

    class None_:
        managed_bytes = 0

        def allocate(self, size):
            raise cl.MemoryError("mem_object_allocation_failure")

        def free_held(self):
            pass

    denoiser._engine._pool = None_()
    denoiser._engine.budget = None
    with pytest.raises(DeviceError, match="has no room for another"):
        denoiser(planes("uniform", HEIGHT, WIDTH, 3))


def test_what_is_tried():
    assert first_guess(1080, 1920, None, 100) == 1080
    assert first_guess(1080, 1920, 10**9, 100) == 10**9 // BYTES // 1920
    assert first_guess(1080, 1920, 10**6, 100) == 100
    assert first_guess(50, 1920, 10**6, 50) == 50
    assert first_guess(100_000, 100_000, None, 100) == 2**25 // 100_000
    assert fewer_rows(1000, 100) == 750 and fewer_rows(120, 100) == 100 and fewer_rows(100, 100) is None
