"""Several devices take frames from one queue: by itself, and with devices that fail."""

import threading

import inputs
import numpy as np
import pyopencl as cl
import pytest

from mcdenoise_cl import DeviceError, denoise_files, denoisers, read_exr, write_exr
from mcdenoise_cl.api import denoise
from mcdenoise_cl.choose import pick_devices
from mcdenoise_cl.cli import main
from mcdenoise_cl.crew import MOST_FAILURES, Crew, Task
from mcdenoise_cl.device import list_devices
from mcdenoise_cl.errors import NoRoomError

SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
COUNT = 8


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "in").mkdir()
    for number in range(COUNT):
        write_exr(tmp_path / "in" / f"{number}.exr", inputs.planes("uniform", 9, 12, 3, number))
    return tmp_path / "in"


def check(folder, out, names):
    """That these are the results of the workers' device: another need not give the same bits."""
    assert sorted(path.name for path in out.iterdir()) == sorted(names)
    for name in names:
        np.testing.assert_array_equal(read_exr(out / name).color, denoise(read_exr(folder / name), device=0, **SMALL))


def workers(monkeypatch, behave):
    """Two workers on one device, whose `denoise` is preceded by `behave(number of the worker, name of the file)`."""
    real, made = denoisers.Denoisers.denoise, []
    lock = threading.Lock()

    def denoise(self, material, recipe):
        with lock:
            if self not in made:
                made.append(self)
        behave(made.index(self), material.frame.metadata["source"].rpartition("/")[2])
        return real(self, material, recipe)

    monkeypatch.setattr(denoisers.Denoisers, "denoise", denoise)
    return [0, 0]


def test_devices_share_the_frames(folder, tmp_path, monkeypatch):
    both, seen = threading.Barrier(2, timeout=60), []

    def behave(number, name):
        if len(seen) < 2:
            seen.append(number)
            both.wait()  # each has one at the same time

    devices = workers(monkeypatch, behave)
    outcomes = denoise_files(folder, tmp_path / "out", device=devices, **SMALL)
    assert [outcome.status for outcome in outcomes] == ["done"] * COUNT and sorted(seen) == [0, 1]
    check(folder, tmp_path / "out", [f"{number}.exr" for number in range(COUNT)])


def test_all_devices_there_are(folder, tmp_path, capsys):
    assert [info.device for info in pick_devices(" All ")] == [info.device for info in list_devices()]
    assert main(["denoise", str(folder), "-o", str(tmp_path / "out"), "--device", "all", "--method", "nlm"]) == 0
    assert f"{COUNT} of {COUNT} files denoised with nlm on " in capsys.readouterr().err
    for path in (tmp_path / "out").iterdir():  # whichever device it was
        wanted = denoise(read_exr(folder / path.name), method="nlm")
        np.testing.assert_allclose(read_exr(path).color, wanted, rtol=1e-4, atol=1e-5)


def test_a_device_that_fails_gives_its_frames_to_the_others(folder, tmp_path, monkeypatch):
    failures, begun, both = [], set(), threading.Barrier(2, timeout=60)

    def behave(number, name):
        if number not in begun:
            begun.add(number)
            both.wait()  # both work before one begins to fail
        if number == 0:
            failures.append(name)
            raise DeviceError("device 0 failed: it was unplugged")

    outcomes = denoise_files(folder, tmp_path / "out", device=workers(monkeypatch, behave), **SMALL)
    assert [outcome.status for outcome in outcomes] == ["done"] * COUNT
    assert 1 <= len(failures) <= MOST_FAILURES, "it is given no more"
    check(folder, tmp_path / "out", [f"{number}.exr" for number in range(COUNT)])


def test_a_frame_that_no_device_can_do(folder, tmp_path, monkeypatch):
    tried = []

    def behave(number, name):
        if name == "3.exr":
            tried.append(number)
            raise NoRoomError(f"device {number} has no room")

    outcomes = denoise_files(folder, tmp_path / "out", device=workers(monkeypatch, behave), **SMALL)
    assert [outcome.status for outcome in outcomes] == ["done"] * 3 + ["failed"] + ["done"] * 4
    assert sorted(tried) == [0, 1] and "has no room" in str(outcomes[3].error)
    check(folder, tmp_path / "out", [f"{number}.exr" for number in range(COUNT) if number != 3])


@pytest.mark.parametrize("count", [1, 2])
def test_when_the_last_device_fails_the_rest_is_reported(folder, tmp_path, monkeypatch, count):
    calls = []

    def behave(number, name):
        if name != "0.exr":
            calls.append(number)
            raise DeviceError("gone: it was unplugged")

    devices = workers(monkeypatch, behave)[:count]
    outcomes = denoise_files(folder, tmp_path / "out", device=devices, **SMALL)
    assert [outcome.status for outcome in outcomes] == ["done"] + ["failed"] * (COUNT - 1)
    assert {str(outcome.error) for outcome in outcomes[1:]} == {"gone: it was unplugged"}
    assert len(calls) <= MOST_FAILURES * count, "a dead device is asked again and again"
    check(folder, tmp_path / "out", ["0.exr"])


def test_a_crew_by_itself():
    crew, tasks = Crew(2, 3), [Task(number) for number in range(3)]
    assert all(crew.put(task) for task in tasks)
    first = crew.take(0)
    assert first.work == 0 and crew.fail(0, first, DeviceError("a")) == []
    assert crew.take(0).work == 1, "not the one it failed at"
    assert crew.take(1) is first
    assert crew.fail(1, first, DeviceError("b")) == [first] and str(first.error) == "b"
    crew.settle(0)
    assert crew.take(1).work == 2
    crew.settle(1)
    assert crew.take(0) is None and crew.take(1) is None


def test_interrupted_while_devices_wait(folder, tmp_path, monkeypatch):
    def interrupt(outcome):
        raise KeyboardInterrupt

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        denoise_files(folder, tmp_path / "out", device=[0, 0], on_progress=interrupt, **SMALL)
    assert threading.active_count() == before, "a thread is left"
    assert all(path.suffix == ".exr" for path in (tmp_path / "out").iterdir())


def test_a_list_of_devices(device):
    assert [info.device for info in pick_devices([0, device])] == [list_devices()[0].device, device]
    with pytest.raises(DeviceError, match="none of the devices here"):
        pick_devices([0, "no such"])
    assert isinstance(pick_devices(None)[0].device, cl.Device) and len(pick_devices(None)) == 1
