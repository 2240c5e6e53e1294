"""Devices: listing, choosing, and what happens without any."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import pyopencl as cl
import pytest

from mcdenoise_cl import DeviceError, choose, device, measured
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import SCHEDULES, DeviceInfo, context_for, list_devices, shape_for
from mcdenoise_cl.engine import Engine


def fake(index, kind, name="chip", runtime="runtime"):
    return DeviceInfo(index, name, runtime, "OpenCL 3.0", "1.0", kind, 2, 2**30, None)


@pytest.fixture(autouse=True)
def no_choice(monkeypatch):
    monkeypatch.delenv("MCDENOISE_DEVICE", raising=False)


def test_list():
    devices = list_devices()
    assert devices and [info.index for info in devices] == list(range(len(devices)))
    assert all(info.compute_units > 0 and info.memory > 0 and info.name for info in devices)


def test_pick_by_index_name_part_and_device(monkeypatch):
    devices = list_devices()
    last = devices[-1]
    assert pick_device(last.index) == last
    assert pick_device(str(last.index)) == last
    assert pick_device(last.device) == last
    assert pick_device(last.name.upper()[2:]).name == last.name
    monkeypatch.setenv("MCDENOISE_DEVICE", str(last.index))
    assert pick_device() == last
    assert pick_device(0) == devices[0]  # the argument wins
    monkeypatch.setenv("MCDENOISE_DEVICE", "abacus")
    with pytest.raises(DeviceError, match=r"environment variable MCDENOISE_DEVICE is 'abacus'.*choose one of 0: "):
        pick_device()
    with pytest.raises(DeviceError, match="device is '99'"):
        pick_device(99)


def test_gpu_comes_first(monkeypatch):
    monkeypatch.setattr(choose, "list_devices", lambda: [fake(0, "CPU"), fake(1, "GPU"), fake(2, "GPU")])
    assert pick_device().index == 1


def test_fastest_cpu_runtime_is_measured_once(monkeypatch, tmp_path):
    devices = [fake(0, "CPU", runtime="slow"), fake(1, "CPU", runtime="fast"), fake(2, "accelerator")]
    monkeypatch.setattr(choose, "list_devices", lambda: devices)
    monkeypatch.setattr(measured, "folder", lambda: tmp_path / "cache")
    calls = []
    seconds = {"slow": 2.0, "fast": 1.0}
    by_device = iter(devices * 3)

    def time(_device):
        calls.append(next(by_device).runtime)
        return seconds[calls[-1]]

    monkeypatch.setattr(choose, "_time", time)
    assert pick_device().runtime == "fast"
    assert calls == ["slow", "fast"]
    assert pick_device().runtime == "fast"
    assert len(calls) == 2  # from the file
    [file] = (tmp_path / "cache").iterdir()
    assert sorted(json.loads(file.read_text()).values()) == [1.0, 2.0]
    file.write_text("{broken")
    by_device = iter(devices * 3)
    assert pick_device().runtime == "fast"
    assert len(calls) == 4


def test_timing_of_a_real_device(device):
    assert 0 < choose._time(device) < float("inf")


def test_shape_suits_the_device(device, tiles_work):
    shape = shape_for(device)
    for columns, rows in (shape.tile, shape.deep):
        assert columns % shape.width == 0 and columns <= 64 and rows <= 16
    assert (shape.width > 1) == (bool(device.type & cl.device_type.CPU) and tiles_work)


def test_schedule_follows_the_device_or_the_environment(device, tiles_work, monkeypatch):
    monkeypatch.delenv("MCDENOISE_SCHEDULE", raising=False)
    assert shape_for(device).schedule == ("tile" if device.type & cl.device_type.CPU and tiles_work else "group")
    for schedule in SCHEDULES:
        monkeypatch.setenv("MCDENOISE_SCHEDULE", schedule)
        assert shape_for(device).schedule == schedule
    assert shape_for(device).width == 1  # group, the last
    monkeypatch.setenv("MCDENOISE_SCHEDULE", "shortest")
    with pytest.raises(DeviceError, match="MCDENOISE_SCHEDULE is 'shortest': set it to tile or group"):
        shape_for(device)
    with pytest.raises(DeviceError, match="MCDENOISE_SCHEDULE"):
        Engine(cl.CommandQueue(context_for(device), device))


def test_without_a_runtime_the_error_says_what_to_install(tmp_path):
    code = "import mcdenoise_cl, numpy\nmcdenoise_cl.denoise(numpy.ones((4, 4, 3)))"
    environment = {**os.environ, "OCL_ICD_VENDORS": str(tmp_path / "none"), "OCL_ICD_FILENAMES": ""}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "DeviceError: no OpenCL runtime was found: install" in last
    assert "pip install 'mcdenoise-cl[cpu]'" in last


def test_pocl_without_a_linker_is_an_error_and_not_an_abort(tmp_path):
    if not any("PoCL" in info.version for info in list_devices()):
        pytest.skip("no PoCL here")
    code = "import mcdenoise_cl, numpy\nmcdenoise_cl.denoise(numpy.ones((4, 4, 3)), device='PoCL')"
    environment = {**os.environ, "PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "apt-get install gcc libc6-dev" in done.stderr.strip().splitlines()[-1]


@pytest.mark.parametrize(("known", "width"), [(True, 16), (False, 8)])
def test_vectors_of_16_only_where_the_compiler_of_pocl_has_registers_for_them(known, width, monkeypatch):
    monkeypatch.setattr(device, "_compiles_for_avx512", lambda _: known)
    monkeypatch.setenv("MCDENOISE_SCHEDULE", "tile")
    wide = SimpleNamespace(
        type=cl.device_type.CPU,
        platform=SimpleNamespace(name="Portable Computing Language"),
        version="OpenCL 3.0 PoCL",
        native_vector_width_float=16,
        max_work_group_size=4096,
    )
    assert {shape.width for shape in device.shapes(wide)} == {width}


def test_vectors_are_no_wider_than_the_device_says():
    for info in list_devices():
        native = info.device.native_vector_width_float
        assert all(shape.width <= max(4, native) for shape in device.shapes(info.device))
