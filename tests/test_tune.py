"""Shapes tried on a device, what is remembered of them, and that results do not hang on them."""

import inputs
import numpy as np
import pytest

from mcdenoise_cl import Denoiser, DeviceError, Frame, measured, tune
from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import SCHEDULE_VARIABLE, identity, shape_as_text, shape_for, shapes
from mcdenoise_cl.measured import forget, recall, remember


@pytest.fixture(autouse=True)
def empty_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(measured, "folder", lambda: tmp_path / "cache")


@pytest.mark.parametrize("schedule", ["tile", "group"])
@pytest.mark.parametrize("method", ["nlm", "auto"])
def test_no_shape_changes_the_result(monkeypatch, can_be_right, schedule, method):
    can_be_right(schedule)
    monkeypatch.setenv(SCHEDULE_VARIABLE, schedule)
    scene = inputs.features(37, 70, noise=0.3)
    frame = Frame(**{name: scene[name] for name in ("color", "albedo", "normal", "depth")})
    denoiser = Denoiser(37, 70, method=method)
    results = []
    possible = shapes(denoiser.queue.device)
    for shape in (possible[0], possible[len(possible) // 2], possible[-1]):  # each takes kernels of its own
        denoiser.use_shape(shape)
        results.append(denoiser(frame))
    for other in results[1:]:
        np.testing.assert_allclose(other, results[0], rtol=1e-3, atol=1e-3)


def test_the_fastest_shape_is_remembered(monkeypatch):
    info = pick_device()
    possible = shapes(info.device)
    fast = possible[-1]
    monkeypatch.setattr(tune, "_seconds", lambda _, shape, __: 1.0 if shape == fast else 2.0)
    progress = []
    trials = tune.tune(info, lambda *done: progress.append(done), height=8, width=8)
    assert trials[0] == tune.Trial(fast, 2.0) and len(trials) == len(possible)
    assert progress[-1] == (len(possible), len(possible))
    assert shape_for(info.device) == fast


def test_a_shape_that_is_hardly_faster_is_not(monkeypatch):
    info = pick_device()
    possible = shapes(info.device)
    remember(identity(info), shape_as_text(possible[-1]))
    monkeypatch.setattr(tune, "_seconds", lambda _, shape, __: 1.0 if shape == possible[-1] else 1.01)
    tune.tune(info, height=8, width=8)
    assert shape_for(info.device) == possible[0]


def test_shapes_that_fail_are_left_out(monkeypatch):
    info = pick_device()
    possible = shapes(info.device)

    def seconds(_, shape, __):
        if shape != possible[1]:
            raise DeviceError("too large")
        return 1.0

    monkeypatch.setattr(tune, "_seconds", seconds)
    assert [trial.shape for trial in tune.tune(info, height=8, width=8)] == [possible[1]]
    monkeypatch.setattr(tune, "shapes", lambda _: possible[:1])
    with pytest.raises(DeviceError, match=r"no shape of kernels runs on .*: too large"):
        tune.tune(info, height=8, width=8)


def test_tuning_runs(monkeypatch):
    info = pick_device()
    some = shapes(info.device)[::5]
    monkeypatch.setattr(tune, "shapes", lambda _: some)
    trials = tune.tune(info, height=16, width=40)
    assert {trial.shape for trial in trials} == set(some)
    assert all(trial.seconds > 0 for trial in trials)


@pytest.mark.parametrize("nonsense", ["", "[1, 2]", None, 7, '["tile", 3, [1, 1], [1, 1], [1, 1]]'])
def test_nonsense_in_the_cache_is_passed_over(nonsense):
    info = pick_device()
    assert remember(identity(info), nonsense)
    assert shape_for(info.device) == shapes(info.device)[0]


def test_a_broken_cache_is_nothing_remembered(tmp_path):
    assert remember("key", [1]) and recall("key") == [1]
    (file,) = (tmp_path / "cache").iterdir()
    file.write_text("{")
    assert recall("key") is None
    forget("key")
    forget("key")
    assert not list((tmp_path / "cache").iterdir())


def test_a_cache_that_cannot_be_written(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(measured, "folder", lambda: tmp_path / "file" / "cache")
    assert not remember("key", 1) and recall("key") is None
