"""Many threads, many processes from cold caches, and writers that are killed: always the same bits."""

import signal
import sqlite3
import subprocess
import sys
import threading
import time

import inputs
import numpy as np
from processes import COLOR, SMALL, is_whole, result

from mcdenoise_cl import Denoiser, denoise, device, measured, pocl_cache, program


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


def test_many_processes_fill_the_cold_cache_of_the_driver_together(place, digest):
    assert race(place) == [digest] * 3
    assert all(map(pocl_cache.is_whole_elf, place.files("*.so"))) and place.files("*.so")
    assert place.run() == digest


def test_many_processes_fill_our_cold_cache_together(warm, digest):
    for path in warm.files("program-*.bin"):
        path.unlink()
    assert race(warm, OWN_CACHE="1") == [digest] * 3
    assert warm.files("program-*.bin") and all(map(is_whole, warm.files("program-*.bin"))) and not warm.files("part-*")
    assert warm.run(OWN_CACHE="1") == digest


def race(place, **environment):
    """What three processes print that are let go at the same moment."""
    start = place.folder / "start"
    processes = [place.start(WAIT_FOR=str(start), **environment) for _ in range(3)]
    start.touch()
    return [result(process) for process in processes]


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()


def test_killed_while_it_writes_a_program(warm, digest, monkeypatch):
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
    assert warm.run(OWN_CACHE="1") == digest
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


def test_killed_again_and_again_while_pocl_builds(place, digest):
    """At the first program, at the first kernel linked, at the fourth."""
    for pattern, count in (("program.bc", 1), ("*.so", 1), ("*.so", 4)):
        process = place.start()
        while process.poll() is None and len(place.files(pattern)) < count:
            time.sleep(0.002)
        kill(process)
    assert place.run() == digest


def test_killed_within_a_transaction_of_pyopencls_database(warm, digest):
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
    assert warm.run() == digest
    with sqlite3.connect(database) as check:
        assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)
