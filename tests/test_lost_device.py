"""A device that fails or is gone between two calls, simulated by OpenCL calls that raise what drivers then say."""

import inputs
import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array
import pytest

from mcdenoise_cl import Denoiser, DeviceError, FrameError, batch, denoise, denoisers, engine, read_exr, write_exr
from mcdenoise_cl import denoiser as made_by
from mcdenoise_cl import device as devices
from mcdenoise_cl.cli import main
from mcdenoise_cl.device import context_for, list_devices

CODES = ["OUT_OF_RESOURCES", "DEVICE_NOT_AVAILABLE", "INVALID_COMMAND_QUEUE"]
SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
COLOR = inputs.planes("uniform", 9, 12, 3)


def cl_error(code, routine="clEnqueueNDRangeKernel"):
    """As PyOpenCL raises it: OUT_OF_RESOURCES and the like are RuntimeErrors, invalid handles LogicErrors."""
    kind = cl.LogicError if code.startswith("INVALID") else cl.RuntimeError
    return kind(cl._cl._ErrorRecord(msg="", code=getattr(cl.status_code, code), routine=routine))


def gone(code):
    def fail(*_, **__):
        raise cl_error(code)

    return fail


def places(denoiser):
    """What a frame does with the device, first to last: memory, upload, kernels, download."""
    return {
        "memory": (cl, "enqueue_fill_buffer"),
        "upload": (made_by, "upload"),
        "kernel": (denoiser._engine, "launch"),
        "download": (cl, "enqueue_copy"),
    }


@pytest.mark.parametrize("place", ["memory", "upload", "kernel", "download"])
@pytest.mark.parametrize("code", CODES)
def test_a_call_to_a_lost_device_names_it_and_what_to_do(device, monkeypatch, place, code):
    denoiser = Denoiser(9, 12, device=device, **SMALL)
    expected = denoiser(COLOR)
    out = np.full_like(COLOR, 7)
    monkeypatch.setattr(*places(denoiser)[place], gone(code))
    with pytest.raises(DeviceError) as error:
        denoiser(COLOR, out=out)
    message = str(error.value)
    assert device.name.strip() in message and f"failed: {code}" in message and "mcdenoise devices" in message
    assert "\n" not in message and isinstance(error.value.__cause__, cl.Error)
    assert (out == 7).all()
    monkeypatch.undo()
    # Nothing is left locked, and a new Denoiser is a new beginning.
    np.testing.assert_array_equal(denoiser(COLOR), expected)
    np.testing.assert_array_equal(Denoiser(9, 12, device=device, **SMALL)(COLOR), expected)


def test_not_even_waiting_for_the_queue_hides_the_reason(device, monkeypatch):
    denoiser = Denoiser(9, 12, device=device, **SMALL)
    monkeypatch.setattr(denoiser._engine, "launch", gone("DEVICE_NOT_AVAILABLE"))

    class Dead:
        def finish(self):
            raise cl_error("INVALID_COMMAND_QUEUE", "clFinish")

    monkeypatch.setattr(denoiser._engine, "queue", Dead())
    monkeypatch.setattr(cl, "enqueue_fill_buffer", lambda *_: None)
    with pytest.raises(DeviceError, match="DEVICE_NOT_AVAILABLE"):
        denoiser(COLOR)


def test_lost_between_the_frame_and_its_report(device, monkeypatch):
    denoiser = Denoiser(9, 12, device=device)
    denoiser(COLOR)
    monkeypatch.setattr(cl, "enqueue_copy", gone("DEVICE_NOT_AVAILABLE"))
    for name in ("report", "model_map", "error_map"):
        with pytest.raises(DeviceError, match="DEVICE_NOT_AVAILABLE"):
            getattr(denoiser, name)


def test_lost_under_device_arrays(device, monkeypatch):
    queue = cl.CommandQueue(context_for(device), device)
    color = cl_array.to_device(queue, COLOR)
    denoiser = Denoiser(9, 12, queue=queue, **SMALL)
    monkeypatch.setattr(denoiser._engine, "launch", gone("OUT_OF_RESOURCES"))
    with pytest.raises(DeviceError, match=r"OUT_OF_RESOURCES.*denoise a smaller frame"):
        denoiser(color)


def test_lost_before_the_queue_is_made_and_before_a_build(device, monkeypatch):
    monkeypatch.setattr(made_by.cl, "CommandQueue", gone("DEVICE_NOT_AVAILABLE"))
    with pytest.raises(DeviceError, match="DEVICE_NOT_AVAILABLE"):
        denoise(COLOR, device=device)
    monkeypatch.undo()
    denoiser = Denoiser(9, 12, device=device, **SMALL)
    monkeypatch.setattr(engine.program, "build", gone("INVALID_COMMAND_QUEUE"))
    with pytest.raises(DeviceError, match="INVALID_COMMAND_QUEUE"):
        denoiser(COLOR)


def test_after_a_failure_the_context_is_a_new_one(device, monkeypatch):
    """A context of a device that was reset stays dead."""
    before, denoiser = context_for(device), Denoiser(9, 12, device=device, **SMALL)
    with pytest.raises(FrameError):  # no failure of the device
        denoiser(np.full_like(COLOR, np.nan))
    assert context_for(device) is before
    monkeypatch.setattr(denoiser._engine, "launch", gone("DEVICE_NOT_AVAILABLE"))
    with pytest.raises(DeviceError):
        denoiser(COLOR)
    assert context_for(device) is not before


def test_a_device_that_answers_no_question_is_not_listed(device, monkeypatch):
    known = [info.device for info in list_devices()]
    real = devices.describe
    monkeypatch.setattr(devices, "describe", lambda i, d: gone("INVALID_DEVICE")() if d == known[0] else real(i, d))
    assert [info.device for info in list_devices()] == known[1:]
    assert [info.index for info in list_devices()] == list(range(len(known) - 1))


@pytest.fixture
def sources(tmp_path):
    (tmp_path / "in").mkdir()
    for seed, name in enumerate(("a.exr", "b.exr", "c.exr")):
        write_exr(tmp_path / "in" / name, inputs.planes("uniform", 9, 12, 3, seed))
    return sorted((tmp_path / "in").iterdir())


def lose_at(monkeypatch, number, then=1):
    """The device fails from launch `number` on, in `then` launches."""
    real, count = engine.Engine.launch, 0

    def launch(self, *arguments, **options):
        nonlocal count
        count += 1
        if number <= count < number + then:
            raise cl_error("DEVICE_NOT_AVAILABLE")
        return real(self, *arguments, **options)

    monkeypatch.setattr(engine.Engine, "launch", launch)
    return lambda: count


def test_a_batch_goes_on_and_leaves_no_part_of_a_file(sources, tmp_path, monkeypatch):
    expected = [denoise(inputs.planes("uniform", 9, 12, 3, seed), **SMALL) for seed in range(3)]
    launches = lose_at(monkeypatch, 10**9)
    batch.denoise_files(sources[:1], tmp_path / "counted", **SMALL)
    lose_at(monkeypatch, launches() + 3)  # within the second frame
    made = []
    monkeypatch.setattr(denoisers, "Denoiser", lambda *args, **options: made.append(1) or Denoiser(*args, **options))
    outcomes = batch.denoise_files(sources, tmp_path / "out", **SMALL)
    assert [type(outcome.error) for outcome in outcomes] == [type(None), DeviceError, type(None)]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.exr", "c.exr"]
    assert len(made) == 2, "the one whose device failed is not used again"
    for name, image in (("a.exr", expected[0]), ("c.exr", expected[2])):
        np.testing.assert_array_equal(read_exr(tmp_path / "out" / name).color, image)


def test_the_command_says_so_of_each_frame(sources, tmp_path, monkeypatch, capsys, device):
    lose_at(monkeypatch, 1, then=10**9)
    out = tmp_path / "out"
    assert main(["denoise", str(sources[0].parent), "-o", str(out), "--method", "nlm"]) == 1
    said = capsys.readouterr().err
    for source in sources:
        [line] = [line for line in said.splitlines() if line.startswith(f"mcdenoise: {source}: ")]
        assert device.name.strip() in line and "DEVICE_NOT_AVAILABLE" in line and "--device" in line
    assert "3 failed" in said and "Traceback" not in said and not list(out.iterdir())
    assert main(["denoise", str(sources[0]), "-o", str(tmp_path / "one.exr")]) == 1
    said = capsys.readouterr().err
    assert said.startswith("mcdenoise: ") and said.count("\n") == 1 and not (tmp_path / "one.exr").exists()
