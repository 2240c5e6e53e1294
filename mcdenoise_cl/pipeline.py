"""Many jobs at once: reading, denoising on every device, and writing overlap, in memory that does not grow."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pyopencl as cl

from .crew import Crew, Task
from .denoisers import Clean, Denoisers, Material
from .errors import DeviceError
from .job import Job, Outcome, Reader, Recipe, finished, read_job, reader_for, write_job
from .stamp import judge


@dataclass(eq=False)
class _Item:
    """A job on its way through."""

    index: int
    job: Job
    reason: str = ""
    material: Material | None = None
    clean: Clean | None = None
    seconds: dict[str, float] = field(default_factory=dict)


def helpers() -> tuple[int, int]:
    """How many threads read, and how many write: OpenEXR lets others run meanwhile, and works on one core each.

    Packing a frame takes longer than unpacking it, and often longer than denoising it, so two write even where there
    are but two cores: what waits for the one is done by the other.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(4, cores // 4)), max(min(2, cores), min(4, cores // 4))


def run_jobs(
    jobs: Sequence[Job],
    recipe: Recipe,
    devices: Sequence[cl.Device],
    *,
    overwrite: bool = False,
    on_progress: Callable[[Outcome], None] | None = None,
) -> list[Outcome]:
    """Do jobs; one that fails does not stop the others.

    Each device denoises a frame at a time, while the next ones are read and the last ones are written by other
    threads. No more than a few frames are in memory at once, however many there are. A frame that a device fails at
    goes to the others.

    Args:
        devices: one or several, which take frames from one queue.
        overwrite: as for `run_job`.
        on_progress: called in this thread after each job, in the order in which they finish. What it raises ends the
            work like an interruption: frames that are being written are finished, others are given up.

    Returns:
        An outcome for each job, in order.
    """
    line = _Line(jobs, recipe, devices, overwrite)
    outcomes: list[Any] = [None] * len(jobs)
    try:
        line.start()
        for _ in jobs:
            index, outcome = line.results.get()
            outcomes[index] = outcome
            if on_progress is not None:
                on_progress(outcome)
    except BaseException:
        line.stop()
        raise
    finally:
        line.join()
    return outcomes


class _Line:
    """The threads of one run. Every job ends in `results`, exactly once, unless the run is stopped."""

    def __init__(self, jobs: Sequence[Job], recipe: Recipe, devices: Sequence[cl.Device], overwrite: bool) -> None:
        self.results: queue.SimpleQueue[tuple[int, Outcome]] = queue.SimpleQueue()
        self._jobs, self._recipe, self._overwrite = jobs, recipe, overwrite
        self._stopped = threading.Event()
        reading, writing = helpers()
        # A frame is being read or written by each helper, being denoised and waiting by each device.
        self._room = threading.Semaphore(reading + writing + 2 * len(devices))
        self._crew = Crew(len(devices), len(jobs))
        self._reader = reader_for(recipe)
        if recipe.temporal:
            halves = 2 if any(job.halves for job in jobs) else 1
            self._reader = _Kept(self._reader, halves * (2 * recipe.temporal + 1 + reading))
        self._reads = ThreadPoolExecutor(reading, "mcdenoise-read")
        self._writes = ThreadPoolExecutor(writing, "mcdenoise-write")
        self._devices = [
            threading.Thread(target=self._serve, args=(number, device), name=f"mcdenoise-device-{number}")
            for number, device in enumerate(devices)
        ]

    def start(self) -> None:
        for thread in self._devices:
            thread.start()
        for index, job in enumerate(self._jobs):
            self._reads.submit(self._read, _Item(index, job))

    def stop(self) -> None:
        """What is being read or denoised is given up, what is being written is finished."""
        self._stopped.set()
        self._crew.stop()
        self._reads.shutdown(wait=False, cancel_futures=True)
        self._writes.shutdown(wait=False, cancel_futures=True)
        for _ in self._jobs:
            self._room.release()

    def join(self) -> None:
        self._reads.shutdown()
        for thread in self._devices:
            if thread.ident is not None:
                thread.join()
        self._writes.shutdown()

    def _finish(self, item: _Item, outcome: Outcome) -> None:
        self._room.release()
        self.results.put((item.index, outcome))

    def _fail(self, item: _Item, error: Exception) -> None:
        self._finish(item, Outcome(item.job.source, item.job.target, error=error, seconds=item.seconds))

    def _read(self, item: _Item) -> None:
        self._room.acquire()
        if self._stopped.is_set():
            return
        started, job = time.perf_counter(), item.job
        try:
            verdict = judge(job, self._recipe, self._overwrite)
            if not verdict.needed:
                self._crew.settle()
                self._finish(item, Outcome(job.source, job.target, reason=verdict.reason))
                return
            item.reason = verdict.reason
            item.material = read_job(job, self._recipe, self._reader)
        except Exception as error:
            self._crew.settle()
            self._fail(item, error)
            return
        item.seconds["read"] = time.perf_counter() - started
        task = Task(item)
        if not self._crew.put(task):
            self._fail(item, task.error)

    def _serve(self, number: int, device: cl.Device) -> None:
        denoisers = Denoisers(device)
        while (task := self._crew.take(number)) is not None:
            item, started = task.work, time.perf_counter()
            try:
                item.clean = denoisers.denoise(item.material, self._recipe)
            except DeviceError as error:
                for lost in self._crew.fail(number, task, error):
                    self._fail(lost.work, lost.error)
                continue
            except Exception as error:
                self._crew.settle()
                self._fail(item, error)
                continue
            item.seconds["denoise"] = time.perf_counter() - started
            item.material = replace(item.material, frame=None, neighbours=(), also={})  # writing has no need of them
            if self._stopped.is_set():
                return
            try:
                self._writes.submit(self._write, item)
            except RuntimeError:  # stopped meanwhile
                return
            self._crew.settle(number)

    def _write(self, item: _Item) -> None:
        started = time.perf_counter()
        try:
            write_job(item.job, self._recipe, item.material, item.clean)
        except Exception as error:
            self._fail(item, error)
            return
        item.seconds["write"] = time.perf_counter() - started
        outcome = finished(item.job, item.material, item.clean, item.reason, item.seconds)
        item.material = item.clean = None
        self._finish(item, outcome)


class _Kept:
    """Reads a file once for all the frames that it is a neighbour of. Keeps the last few."""

    def __init__(self, reader: Reader, count: int) -> None:
        self._read, self._count = reader, count
        self._kept: OrderedDict[Path, Future[Any]] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, path: Path) -> Any:
        with self._lock:
            known = self._kept.get(path)
            if known is None:
                found = self._kept[path] = Future()
                while len(self._kept) > self._count:
                    self._kept.popitem(last=False)
            else:
                self._kept.move_to_end(path)
        if known is not None:
            return known.result()
        try:
            found.set_result(self._read(path))
        except Exception as error:
            found.set_exception(error)
        return found.result()
