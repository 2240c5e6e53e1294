"""A farm with a real scheduler and real workers, which are killed, and the parts of it by themselves."""

import sys
import threading
from dataclasses import replace
from pathlib import Path

import farms
import inputs
import numpy as np
import pyopencl as cl
import pytest

from mcdenoise_cl import DeviceError, ExrError, FarmError, denoise_files, farm, farm_worker
from mcdenoise_cl.batch import denoise_file
from mcdenoise_cl.cli import main
from mcdenoise_cl.exr import write_exr
from mcdenoise_cl.exr_file import load
from mcdenoise_cl.farm_check import difference, sign_in
from mcdenoise_cl.farm_plan import MOST_AT_ONCE, Places, Queue, Slot, Task
from mcdenoise_cl.farm_worker import Found, Look
from mcdenoise_cl.job import Job, Recipe

H, W = 24, 16
NLM = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
RECIPE = Recipe.of(**NLM)


@pytest.fixture(scope="module")
def running():
    farm = farms.Farm()
    yield farm
    farm.close()


@pytest.fixture
def cluster(running):
    """A scheduler with two living workers."""
    running.fill()
    return running


def write_frames(folder, count):
    folder.mkdir()
    for number in range(count):
        write_exr(folder / f"f.{number:04d}.exr", inputs.planes("hdr", H, W, 3, seed=number))
    return sorted(folder.iterdir())


def check(sources, out, tmp_path):
    """Each result has the bits and the stamp that it would have on this machine alone; there is nothing else."""
    for source in sources:
        denoise_file(source, tmp_path / "expected" / source.name, overwrite=True, **NLM)
        (expected,), (found,) = load(tmp_path / "expected" / source.name), load(out / source.name)
        assert found.header.keys() == expected.header.keys()
        assert found.header["mcdenoise"] == expected.header["mcdenoise"]
        for name, (pixels, _) in expected.channels.items():
            np.testing.assert_array_equal(found.channels[name][0], pixels)
    assert sorted(path.name for path in out.iterdir()) == [source.name for source in sources]


@pytest.fixture
def expected(tmp_path):
    (tmp_path / "expected").mkdir()
    return tmp_path


def statuses(outcomes):
    return [outcome.status for outcome in outcomes]


def idle(address):
    """Whether neither the scheduler nor any worker has anything of a run left."""
    from distributed import Client

    with Client(address) as client:
        tasks = client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))
        return tasks == 0 and not any(client.run(lambda: sum(farm_worker._running.values())).values())


def test_a_farm_does_what_one_machine_does(cluster, expected, tmp_path):
    sources, out, seen = write_frames(tmp_path / "in", 6), tmp_path / "out", []
    whole = sources[2].read_bytes()
    sources[2].write_bytes(whole[: len(whole) // 2])
    outcomes = denoise_files(tmp_path / "in", out, dask=cluster.address, on_progress=seen.append, **NLM)
    assert statuses(outcomes) == ["done", "done", "failed", "done", "done", "done"]
    assert isinstance(outcomes[2].error, ExrError) and "damaged" in str(outcomes[2].error)
    assert [outcome.source for outcome in outcomes] == sources
    assert sorted(seen, key=lambda outcome: outcome.source) == outcomes
    check([*sources[:2], *sources[3:]], out, expected)

    # Again, with the same rules as on one machine: what is up to date is skipped, what has changed is done.
    sources[2].write_bytes(whole)
    write_exr(sources[4], inputs.planes("hdr", H, W, 3, seed=9))
    (out / sources[0].name).write_bytes(b"mine")
    outcomes = denoise_files(tmp_path / "in", out, dask=cluster.address, **NLM)
    assert statuses(outcomes) == ["skipped", "skipped", "done", "skipped", "done", "skipped"]
    assert (out / sources[0].name).read_bytes() == b"mine"
    outcomes = denoise_files(sources[:2], out, dask=cluster.address, overwrite=True, **NLM)
    assert statuses(outcomes) == ["done", "done"]
    check(sources, out, expected)
    assert idle(cluster.address)


def test_a_worker_is_killed_while_it_writes(cluster, expected, tmp_path, caplog):
    sources, out = write_frames(tmp_path / "in", 8), tmp_path / "out"
    sources[2].with_suffix(".hold").touch()  # the third: others of the same worker wait behind it
    left = []

    def kill(worker):
        line = worker.find(r"^holding (\d+)")
        if line:
            left.append([path.name for path in out.iterdir() if f"-{worker.popen.pid}-" in path.name])
            left.append((out / sources[2].name).exists())
            assert int(line[1]) == worker.popen.pid
            worker.kill()

    threads = [threading.Thread(target=kill, args=(worker,), daemon=True) for worker in cluster.workers.values()]
    for thread in threads:
        thread.start()
    outcomes = denoise_files(tmp_path / "in", out, dask=cluster.address, **NLM)
    assert left[0] and left[1] is False  # it was killed between the last byte and the name
    lost = [any("1 worker that had it was lost" in note for note in outcome.notes) for outcome in outcomes]
    assert lost[2] and outcomes[2].status == "done"
    for outcome, once_more in zip(outcomes, lost, strict=True):  # a worker may be lost before it can say what it did
        assert outcome.status == "done" or (once_more and outcome.reason == "up to date")
    assert any("was lost" in record.message for record in caplog.records)
    check(sources, out, expected)


def test_a_frame_that_ends_its_workers_fails_alone(expected, tmp_path):
    """On a cluster that is started for it: workers that end are started again."""
    import dask
    import distributed  # noqa: F401 (its settings must be there before one is changed for a while)

    sources, out = write_frames(tmp_path / "in", 4), tmp_path / "out"
    sources[1].with_suffix(".deadly").touch()
    jobs, notes = [Job(source, out / source.name) for source in sources], []
    with dask.config.set({"distributed.worker.preload": [str(farms.PRELOAD)]}):
        outcomes = farm.run_jobs(jobs, RECIPE, "local", device=0, on_note=notes.append, retries=1)
    assert statuses(outcomes) == ["done", "failed", "done", "done"]
    assert "was begun 2 times and each time its worker was lost" in str(outcomes[1].error)
    assert sum("was lost" in note for note in notes) == 2
    check([sources[0], *sources[2:]], out, expected)


@pytest.mark.parametrize("what", ["broken", "unseen"])
def test_a_worker_that_fails_at_everything_is_left_out(what, cluster, expected, tmp_path, caplog):
    sources, out = write_frames(tmp_path / "in", 2 * MOST_AT_ONCE), tmp_path / "out"  # so that it gets three
    for source in sources:
        source.with_suffix(f".{what}").touch()
    outcomes = denoise_files(tmp_path / "in", out, dask=cluster.address, **NLM)
    assert statuses(outcomes) == ["done"] * len(sources)
    assert ["is left out from now on: as asked" in record.message for record in caplog.records] == [True]
    check(sources, out, expected)


def test_a_frame_at_which_every_device_fails(cluster, tmp_path):
    sources = write_frames(tmp_path / "in", 2)
    sources[0].with_suffix(".broken").write_text("all")
    outcomes = denoise_files(sources, tmp_path / "out", dask=cluster.address, **NLM)
    assert statuses(outcomes) == ["failed", "done"]
    assert isinstance(outcomes[0].error, DeviceError) and "as asked (on " in str(outcomes[0].error)


def test_no_worker_is_left(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(farm, "PATIENCE", 0.1)
    sources = write_frames(tmp_path / "in", 1)
    sources[0].with_suffix(".deadly").touch()
    (outcome,) = denoise_files(sources, tmp_path / "out", dask=cluster.address, **NLM)
    assert "no worker that can be used is left: start one and run again" in str(outcome.error)
    assert list((tmp_path / "out").iterdir()) == []


def test_interruption_takes_back_what_waits(cluster, expected, tmp_path):
    sources, out = write_frames(tmp_path / "in", 8), tmp_path / "out"

    def interrupt(outcome):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        denoise_files(tmp_path / "in", out, dask=cluster.address, on_progress=interrupt, **NLM)
    there = sorted(path.name for path in out.iterdir())
    assert 1 <= len(there) <= 2 * MOST_AT_ONCE and set(there) <= {source.name for source in sources}
    assert idle(cluster.address)
    outcomes = denoise_files(tmp_path / "in", out, dask=cluster.address, **NLM)
    assert statuses(outcomes).count("skipped") == len(there) and "failed" not in statuses(outcomes)
    check(sources, out, expected)


def test_from_the_shell(cluster, expected, tmp_path, monkeypatch, capsys):
    sources = write_frames(tmp_path / "in", 2)
    monkeypatch.chdir(tmp_path)  # the workers are elsewhere
    command = ["denoise", "in", "-o", "out", "--dask", cluster.address, "--method", "nlm", "--json"]
    assert main([*command, "--set", "search_radius=1", "--set", "patch_radius=1"]) == 0
    out = capsys.readouterr().out
    assert out.count('"event": "file", "status": "done", "source": "in/f.000') == 2
    check(sources, tmp_path / "out", expected)


def test_a_client_is_left_open(cluster, tmp_path):
    from distributed import Client

    sources = write_frames(tmp_path / "in", 1)
    with Client(cluster.address) as client:
        assert statuses(denoise_files(sources, tmp_path / "out", dask=client, **NLM)) == ["done"]
        assert client.status == "running" and len(client.nthreads()) == 2


def test_other_versions_are_refused_before_any_frame(cluster, tmp_path, monkeypatch):
    sources = write_frames(tmp_path / "in", 1)
    here = dict(farm_worker.versions())
    monkeypatch.setattr(farm_worker.np, "__version__", "0.9")
    farm_worker.versions.cache_clear()
    try:
        with pytest.raises(FarmError) as error:
            denoise_files(sources, tmp_path / "out", dask=cluster.address, **NLM)
    finally:
        monkeypatch.undo()
        farm_worker.versions.cache_clear()
    assert f"has NumPy {here['NumPy']} (here 0.9)" in str(error.value)
    assert list((tmp_path / "out").iterdir()) == []


def test_workers_that_cannot_be_used_are_left_out(cluster, tmp_path, caplog):
    sources = write_frames(tmp_path / "in", 1)
    with pytest.raises(FarmError, match=r"no worker can be used: worker .* none of the devices here"):
        denoise_files(sources, tmp_path / "out", dask=cluster.address, device="no such device", **NLM)
    assert len([record for record in caplog.records if record.message.startswith("left out worker")]) == 2


def test_what_is_no_cluster(tmp_path, monkeypatch):
    sources = write_frames(tmp_path / "in", 1)
    monkeypatch.setattr("mcdenoise_cl.farm_cluster.ANSWER", 0.1)
    for dask, message in (
        ("tcp://127.0.0.1:9", "no Dask scheduler answers at tcp://127.0.0.1:9 .* start one with `dask scheduler`"),
        ("", "dask is '': give an address"),
        (7, "dask is 7: give an address"),
    ):
        with pytest.raises(FarmError, match=message):
            denoise_files(sources, tmp_path / "out", dask=dask, **NLM)
    device = cl.get_platforms()[0].get_devices()[0]
    with pytest.raises(FarmError, match="give a name or a number"):
        denoise_files(sources, tmp_path / "out", dask="local", device=device, **NLM)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        FarmError, match=r"needs dask.distributed, which is missing .* pip install 'mcdenoise-cl\[farm\]'"
    ):
        denoise_files(sources, tmp_path / "out", dask="local", **NLM)


def test_look(tmp_path, monkeypatch):
    job = Job(tmp_path / "in.exr", tmp_path / "out" / "in.exr")
    write_exr(job.source, inputs.planes("hdr", H, W, 3))
    with sign_in([job]) as sign:
        assert Path(sign).parent == tmp_path / "out"
        found = farm_worker.look(0, sign, [str(job.source)])
        assert not found.problem and [device.index for device in found.devices] == [0]
        missing = farm_worker.look(0, sign, [str(tmp_path / "no.exr")])
        assert f"no.exr is not seen by {found.host}: every worker needs the shared storage" in missing.problem
        assert "does not see" in farm_worker.look(0, str(tmp_path / "other" / "sign"), []).problem
        monkeypatch.setattr(Path, "touch", lambda *_, **__: (_ for _ in ()).throw(PermissionError(13, "No")))
        assert "cannot write to" in farm_worker.look(0, sign, []).problem
    assert list((tmp_path / "out").iterdir()) == []


def test_a_frame_that_a_worker_does_not_see(tmp_path):
    job = Job(tmp_path / "no.exr", tmp_path / "out.exr")
    error = farm_worker.do("run", job, RECIPE, 0, False, False).outcome.error
    assert isinstance(error, farm_worker.UnseenError) and "no.exr is not seen by" in str(error)


def test_results_are_checked(tmp_path):
    job = Job(tmp_path / "in.exr", tmp_path / "out.exr")
    write_exr(job.source, inputs.planes("hdr", H, W, 3))
    answer = farm_worker.do("run", job, RECIPE, 0, False, False)
    assert answer.outcome.status == "done" and difference(job, RECIPE, answer) == ""
    whole = job.target.read_bytes()
    job.target.write_bytes(whole[:-1])
    assert f"has {len(whole) - 1} bytes, but {len(whole)} were written" in difference(job, RECIPE, answer)
    job.target.write_bytes(b"\0" * len(whole))
    assert "is not an EXR file" in difference(job, RECIPE, answer)
    job.target.write_bytes(whole)
    assert "was made of something else" in difference(job, Recipe.of("nlm"), answer)
    write_exr(job.target, inputs.planes("hdr", H, W + 1, 3))
    smaller = replace(answer, size=job.target.stat().st_size)
    assert "has another size than" in difference(job, RECIPE, smaller)
    job.target.unlink()
    assert "out.exr is not there" in difference(job, RECIPE, answer)


def device(key):
    return Found(0, "a device", (key,))


def test_each_device_is_served_by_one_worker():
    places = Places()
    both = Look("host", (device("gpu 0"), device("gpu 1")))
    places.add({"a": (both, 16), "b": (both, 1), "c": (both, 16)})
    assert sorted((slot.worker, slot.device.key) for slot in places.slots) == [("a", ("gpu 0",)), ("b", ("gpu 1",))]
    assert {slot.worker: slot.room for slot in places.slots} == {"a": MOST_AT_ONCE, "b": 2}
    kept = next(slot for slot in places.slots if slot.worker == "b")
    places.lose("a")
    assert {slot.worker for slot in places.slots} == {"b", "c"} and kept in places.slots
    places.lose("b")
    assert [slot.worker for slot in places.slots] == ["c", "c"]
    places.add({"d": (Look("other", (device("cpu"),)), 1)})
    assert [slot.worker for slot in places.slots] == ["c", "c", "d"]


def test_a_device_that_fails_again_and_again_is_left_out():
    places = Places()
    places.add({"a": (Look("host", (device("gpu"),)), 1), "b": (Look("host", (device("gpu"),)), 1)})
    (slot,) = places.slots
    assert [places.failed(slot), places.failed(slot)] == [False, False]
    places.worked(slot)
    assert [places.failed(slot) for _ in range(3)] == [False, False, True]
    assert [slot.worker for slot in places.slots] == ["b"]


def test_frames_that_were_lost_come_last_and_alone():
    one, two = (Slot(worker, worker, device(worker), 2) for worker in "ab")
    tasks = [Task(number, None) for number in range(4)]
    waiting = Queue(tasks)
    assert [waiting.next(one, has, has) for has in (0, 1, 2)] == [tasks[0], tasks[1], None]
    waiting.again(tasks[0])
    tasks[1].failed_on.add(one)
    waiting.again(tasks[1])
    assert [waiting.next(two, 0, 0), waiting.next(two, 1, 1)] == tasks[2:]
    assert waiting.next(two, 1, 1) is None
    assert waiting.next(one, 0, 1) is None  # the worker has a frame on another device
    assert waiting.next(one, 0, 0) is tasks[0]
    assert waiting.next(one, 0, 0) is None
    assert waiting.hopeless([one, two]) == [] and waiting.hopeless([one]) == [tasks[1]]
    assert len(waiting) == 0


def test_errors_of_a_device_say_where():
    error = farm_worker.named(DeviceError("it failed"), "render02")
    assert isinstance(error, DeviceError) and str(error) == "it failed (on render02)"
