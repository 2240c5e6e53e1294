"""Many threads, many processes from cold caches, writers that are killed, and damaged caches: always the same bits."""

import hashlib
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time

import inputs
import numpy as np
import pytest

from mcdenoise_cl import Denoiser, DeviceError, denoise, measured, pocl_cache
from mcdenoise_cl.device import identity, list_devices

SMALL = {"method": "nlm", "search_radius": 1, "patch_radius": 1}
COLOR = inputs.planes("hdr", 24, 32, 3)

#: A process that denoises COLOR and prints what came of it. OWN_CACHE makes it take the driver for one that keeps no
#: programs; KILL_AT is a folder to
#: keep them in, where it says when it has written the first one and stays, before it gives it its name, to be killed.
CHILD = """
import hashlib, os, sys, time
import numpy as np
from mcdenoise_cl import denoise, measured, program
if os.environ.get("OWN_CACHE"):
    program.has_src_build_cache = lambda device: None
class Stay(type(measured.Path())):
    def replace(self, target):
        print("writing", flush=True)
        time.sleep(1e6)
if os.environ.get("KILL_AT"):
    program.cache_folder = lambda: Stay(os.environ["KILL_AT"])
    measured.Path = Stay
while os.environ.get("WAIT_FOR") and not os.path.exists(os.environ["WAIT_FOR"]):
    time.sleep(0.01)
color = np.load(os.environ["COLOR"])
print(hashlib.sha256(denoise(color, method="nlm", search_radius=1, patch_radius=1).tobytes()).hexdigest())
"""


@pytest.fixture(scope="module")
def pocl():
    """The PoCL that is picked here, as the others have their caches elsewhere."""
    found = [info for info in list_devices() if "PoCL" in info.version]
    if not found:
        pytest.skip("no PoCL here")
    return found[0]


@pytest.fixture(scope="module")
def expected(pocl):
    return hashlib.sha256(denoise(COLOR, device=pocl.device, **SMALL).tobytes()).hexdigest()


class Place:
    """A folder with every cache of a process in it."""

    def __init__(self, folder, info):
        self.folder = folder
        folder.mkdir(exist_ok=True)
        np.save(folder / "color.npy", COLOR)
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("PYOPENCL")} | {
            "XDG_CACHE_HOME": str(folder),
            "POCL_CACHE_DIR": str(folder / "pocl"),
            "MCDENOISE_DEVICE": str(info.index),
            "COLOR": str(folder / "color.npy"),
            "PYTHONPATH": os.pathsep.join(sys.path),
        }

    def start(self, **environment):
        return subprocess.Popen(
            [sys.executable, "-c", CHILD],
            env=self.environment | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, **environment):
        return result(self.start(**environment))

    def files(self, pattern):
        return [path for path in self.folder.rglob(pattern) if path.is_file()]


def result(process):
    out, err = process.communicate()
    assert process.returncode == 0, err
    return out.strip()


@pytest.fixture
def place(tmp_path, pocl):
    return Place(tmp_path / "caches", pocl)


@pytest.fixture(scope="module")
def filled(tmp_path_factory, pocl, expected):
    """Caches that two processes have filled, of which one kept its programs itself."""
    place = Place(tmp_path_factory.mktemp("filled"), pocl)
    assert place.run() == place.run(OWN_CACHE="1") == expected
    return place.folder


@pytest.fixture
def warm(filled, tmp_path, pocl):
    shutil.copytree(filled, tmp_path / "warm")
    return Place(tmp_path / "warm", pocl)


def test_many_threads_at_one_denoiser_and_its_report():
    frames = [inputs.planes("uniform", 24, 32, 3, seed) for seed in range(3)]
    results = [denoise(frame, **SMALL) for frame in frames]
    shared, wrong = Denoiser(24, 32, **SMALL), []
    shared(frames[0])

    def work(index):
        for turn in range(8):
            which = (index + turn) % 3
            if not np.array_equal(shared(frames[which]), results[which]):
                wrong.append((index, turn))
            if shared.report.method != "nlm":
                wrong.append("report")

    together(work, 8)
    assert wrong == []


def test_many_threads_build_their_own_from_cold(monkeypatch):
    """Each context and program is made once, however many ask at the same moment."""
    from mcdenoise_cl import device, program

    result = denoise(COLOR, **SMALL)
    monkeypatch.setattr(device, "_contexts", {})
    monkeypatch.setattr(program, "_programs", {})
    barrier, wrong, queues = threading.Barrier(8), [], []

    def work(index):
        barrier.wait()
        denoiser = Denoiser(24, 32, **SMALL)
        queues.append(denoiser.queue)
        if not np.array_equal(denoiser(COLOR), result):
            wrong.append(index)

    together(work, 8)
    assert wrong == [] and len({queue.context for queue in queues}) == 1 and len(queues) == 8


def together(work, count):
    failures = []

    def guarded(index):
        try:
            work(index)
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=guarded, args=(i,)) for i in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []


def test_many_processes_fill_the_cold_cache_of_the_driver_together(place, expected):
    assert race(place) == [expected] * 3
    assert all(map(pocl_cache.is_whole_elf, place.files("*.so"))) and place.files("*.so")
    assert place.run() == expected


def test_many_processes_fill_our_cold_cache_together(warm, expected):
    for path in warm.files("program-*.bin"):
        path.unlink()
    assert race(warm, OWN_CACHE="1") == [expected] * 3
    assert warm.files("program-*.bin") and all(map(is_whole, warm.files("program-*.bin"))) and not warm.files("part-*")
    assert warm.run(OWN_CACHE="1") == expected


def race(place, **environment):
    """What three processes print that are let go at the same moment."""
    start = place.folder / "start"
    processes = [place.start(WAIT_FOR=str(start), **environment) for _ in range(3)]
    start.touch()
    return [result(process) for process in processes]


def is_whole(program):
    data = program.read_bytes()
    return len(data) > 32 and hashlib.sha256(data[32:]).digest() == data[:32]


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()


def test_killed_while_it_writes_a_program(warm, expected, monkeypatch):
    """It leaves a part of a file of its own, and a lock of PyOpenCL's would be no obstacle either."""
    own = warm.folder / "own"
    process = warm.start(OWN_CACHE="1", KILL_AT=str(own))
    assert process.stdout.readline() == "writing\n"
    kill(process)
    [part] = own.iterdir()
    assert part.name.startswith("part-")
    lock = warm.folder / "pyopencl" / f"pyopencl-compiler-cache-v2-py{'.'.join(map(str, sys.version_info))}" / "lock"
    lock.parent.mkdir(parents=True)
    lock.touch()
    for path in warm.files("program-*.bin"):
        path.unlink()
    assert warm.run(OWN_CACHE="1") == expected
    assert all(map(is_whole, warm.files("program-*.bin"))) and lock.exists()


def test_killed_while_it_writes_what_was_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(measured, "folder", lambda: tmp_path)
    assert measured.remember("a", 1)
    code = (
        "import sys, time; from mcdenoise_cl import measured\n"
        "class Stay(type(measured.Path())):\n"
        "    def replace(self, target): print('writing', flush=True); time.sleep(1e6)\n"
        "measured.Path = Stay; measured.folder = lambda: Stay(sys.argv[1]); measured.remember('a', 2)"
    )
    process = subprocess.Popen([sys.executable, "-c", code, tmp_path], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "writing\n"
    kill(process)
    assert measured.recall("a") == 1 and len(list(tmp_path.iterdir())) == 2
    assert measured.remember("a", 3) and measured.recall("a") == 3


def test_killed_again_and_again_while_pocl_builds(place, expected):
    """At the first program, at the first kernel linked, at the fourth."""
    for pattern, count in (("program.bc", 1), ("*.so", 1), ("*.so", 4)):
        process = place.start()
        while process.poll() is None and len(place.files(pattern)) < count:
            time.sleep(0.002)
        kill(process)
    assert place.run() == expected


def test_killed_within_a_transaction_of_pyopencls_database(warm, expected):
    [database] = warm.files("*invoker*.sqlite")
    code = (
        "import sqlite3, sys, time\n"
        "c = sqlite3.connect(sys.argv[1], isolation_level=None)\n"
        "c.execute('PRAGMA cache_size = 1'); c.execute('BEGIN IMMEDIATE')\n"
        "for i in range(500): c.execute('INSERT INTO dict VALUES (?, ?)', (str(i), 'x' * 4000))\n"
        "print('writing', flush=True); time.sleep(1e6)"
    )
    process = subprocess.Popen([sys.executable, "-c", code, database], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "writing\n"
    kill(process)
    assert warm.run() == expected
    with sqlite3.connect(database) as check:
        assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)


DAMAGES = {
    "empty": lambda data: b"",
    "cut": lambda data: data[: len(data) // 2],
    "garbage": lambda data: np.random.default_rng(0).bytes(max(len(data), 100)),
}


@pytest.mark.parametrize("first", DAMAGES)
def test_a_damaged_database_of_pyopencl_is_made_again(warm, expected, first):
    [database] = warm.files("*invoker*.sqlite")
    database.write_bytes(DAMAGES[first](database.read_bytes()))
    assert warm.run() == warm.run() == expected
    with sqlite3.connect(database) as check:
        assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)


@pytest.mark.parametrize(
    ("pattern", "whole"),
    [("*.so", pocl_cache.is_whole_elf), ("program.bc", pocl_cache.is_whole_bitcode), ("program-*.bin", is_whole)],
)
def test_damaged_programs_are_built_again(warm, expected, pattern, whole):
    files = warm.files(pattern)
    assert len(files) > 3 and all(map(whole, files))
    for number, path in enumerate(files):  # one is empty, the next cut short, the next overwritten, and so on
        path.write_bytes(list(DAMAGES.values())[number % 3](path.read_bytes()))
    assert not any(map(whole, files))
    assert warm.run(**({"OWN_CACHE": "1"} if pattern == "program-*.bin" else {})) == expected
    assert warm.files(pattern) and all(map(whole, warm.files(pattern)))


@pytest.mark.parametrize("damage", [*DAMAGES, "other JSON"])
def test_damaged_measurements_are_made_again(damage, monkeypatch, tmp_path, pocl):
    from mcdenoise_cl import choose
    from mcdenoise_cl.device import shape_as_text, shape_for, shapes

    monkeypatch.setattr(measured, "folder", lambda: tmp_path)
    monkeypatch.delenv("MCDENOISE_DEVICE", raising=False)
    monkeypatch.setattr(choose, "list_devices", lambda: [pocl, pocl])
    monkeypatch.setattr(choose, "_time", lambda device: 1.0)
    last = shapes(pocl.device)[-1]
    measured.remember(identity(pocl), shape_as_text(last))
    assert choose.pick_device() == pocl and shape_for(pocl.device) == last
    files = list(tmp_path.iterdir())
    assert len(files) == 2
    for path in files:
        path.write_bytes(b'{"a": [1, null]}' if damage == "other JSON" else DAMAGES[damage](path.read_bytes()))
    assert choose.pick_device() == pocl and shape_for(pocl.device) == shapes(pocl.device)[0]


@pytest.mark.parametrize("folder", [os.devnull, "a file"])
def test_without_any_folder_for_caches(tmp_path, pocl, expected, folder):
    (tmp_path / "a file").touch()
    nowhere = str(tmp_path / folder)
    process = Place(tmp_path / "place", pocl).start(XDG_CACHE_HOME=nowhere, POCL_CACHE_DIR=nowhere)
    out, err = process.communicate()
    assert (process.returncode, out.strip(), err) == (0, expected, "")


def test_without_room_for_the_kernels_of_pocl(device, monkeypatch, tmp_path):
    monkeypatch.setenv(pocl_cache.VARIABLE, str(tmp_path))
    pocl_cache.check_room()
    usage = shutil.disk_usage(tmp_path)._replace(free=pocl_cache.ROOM - 1)
    monkeypatch.setattr(pocl_cache.shutil, "disk_usage", lambda folder: usage)
    with pytest.raises(
        DeviceError, match=rf"in {tmp_path}, where .* less than 32 MiB are free: make room there, or set"
    ):
        pocl_cache.check_room()


def test_a_full_disk_under_our_own_cache(monkeypatch, tmp_path):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(measured, "folder", lambda: tmp_path)
    monkeypatch.setattr(measured.Path, "replace", full)
    assert not measured.remember("a", 1) and list(tmp_path.iterdir()) == []
    monkeypatch.setattr(measured.tempfile, "NamedTemporaryFile", full)
    assert not measured.remember("a", 1) and measured.recall("a") is None
    measured.forget("a")
