"""The processes that `speed.py` times: one a denoiser, started at its turn, stopped when memory runs short."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

#: Where compilers keep programs between processes, by the variable that moves them: PyOpenCL and Mesa, PoCL, NVIDIA,
#: Intel's GPU driver, its older form, AMD. The folders need not be there.
CACHE_VARIABLES = {
    "XDG_CACHE_HOME": ".",
    "POCL_CACHE_DIR": "pocl",
    "CUDA_CACHE_PATH": "nvidia",
    "NEO_CACHE_DIR": "neo",
    "cl_cache_dir": "intel",
    "AMD_COMGR_CACHE_DIR": "amd",
}
#: Bytes a pixel that a denoiser is taken to need, inputs included, before it has told: more than any seen.
GUESS = 1200
#: Bytes that stay free whatever is running.
RESERVE = 1 << 30


class WorkerError(Exception):
    """A worker that ended or took too long; the message says which."""


@dataclass(frozen=True)
class Place:
    """Where workers run: the folder of planes, environment variables, and what room there is.

    Attributes:
        planes: folder of the frame's planes.
        pixels: of the frame.
        variables: environment of the workers, on top of this process's.
        device_memory: bytes that our methods share on the device; None where that is the host's memory.
    """

    planes: Path
    pixels: int
    variables: dict[str, str]
    device_memory: int | None = None


class Worker:
    """One denoiser in a process of its own."""

    def __init__(self, name: str, place: Place) -> None:
        self.name = name
        self.place = place
        self.host_need = self.device_need = GUESS * place.pixels
        self.process: subprocess.Popen[str] | None = None
        self._errors: Any = None

    def start(self, longest: float | None = None) -> dict[str, float]:
        """Start, load, make ready and denoise once; returns the times of the last two.

        Raises:
            WorkerError: it failed, or the whole took longer than `longest` seconds.
        """
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115, closed by stop()
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("worker.py")), self.name, str(self.place.planes)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, **self.place.variables},
            text=True,
        )
        return self._answer(longest)

    def run(self, longest: float | None = None) -> dict[str, Any]:
        """One turn."""
        with contextlib.suppress(OSError):  # it has ended, and reading its answer says why
            print("run", file=self.process.stdin, flush=True)
        answer = self._answer(longest)
        self.host_need = answer["host_bytes"] + GUESS * self.place.pixels // 8
        self.device_need = answer["device_bytes"] or 0
        return answer

    def stop(self) -> None:
        """End the process and wait for it."""
        if self.process is None:
            return
        with contextlib.suppress(OSError):  # a line that it did not live to read
            self.process.stdin.close()
        try:
            self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()
        self._errors.close()
        self.process = None

    def _answer(self, longest: float | None) -> dict[str, Any]:
        late = threading.Event()

        def end() -> None:
            late.set()
            self.process.kill()

        timer = threading.Timer(longest or threading.TIMEOUT_MAX, end)
        timer.daemon = True
        timer.start()
        try:
            line = self.process.stdout.readline()
        finally:
            timer.cancel()
        if line:
            return json.loads(line)
        if late.is_set():
            raise WorkerError(f"its first run took longer than {longest:g} s (--longest)")
        code = self.process.wait()
        self._errors.seek(0)
        said = self._errors.read().strip().splitlines() or ["it said nothing"]
        raise WorkerError(f"it ended with code {code}: {said[-1]}")


class Crew:
    """The workers of one frame size. No two run at a time; those that wait keep what they made ready."""

    def __init__(self, names: list[str], place: Place) -> None:
        self.place = place
        self.workers = {name: Worker(name, place) for name in names}
        self._order: list[str] = []  # those that are alive, by their last turn

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self.workers.values():
            worker.stop()

    def turn(self, name: str, longest: float | None = None) -> dict[str, Any]:
        """One turn of a denoiser, which is started if it is not alive; `longest`: for its start, in seconds."""
        worker = self.workers[name]
        if worker.process is None:
            self._make_room(worker)
            worker.start(longest)
        if name in self._order:
            self._order.remove(name)
        self._order.append(name)
        return worker.run()

    def dismiss(self, name: str) -> None:
        """Stop a denoiser."""
        self.workers[name].stop()
        if name in self._order:
            self._order.remove(name)

    def _make_room(self, worker: Worker) -> None:
        """Stop others until a worker's memory is there: first the one that ran last, whose next turn is farthest."""
        while self._order and not self._has_room(worker):
            self.dismiss(self._order[-1])

    def _has_room(self, worker: Worker) -> bool:
        available = available_memory()
        if available is not None and available < worker.host_need + RESERVE:
            return False
        if self.place.device_memory is None:
            return True
        taken = sum(self.workers[name].device_need for name in self._order)
        return taken + worker.device_need <= 0.8 * self.place.device_memory


def available_memory() -> int | None:
    """Bytes of host memory that a new process can have; None where it is not known."""
    path = Path("/proc/meminfo")
    if not path.exists():
        return None
    return next(int(line.split()[1]) << 10 for line in path.read_text().splitlines() if line.startswith("MemAvailable"))


def first_call(name: str, place: Place) -> tuple[float, float]:
    """Seconds until the first frame is done, making the denoiser included: with empty program caches, then filled.

    Both are of fresh processes, without the start of Python and imports.
    """
    with tempfile.TemporaryDirectory(prefix="mcdenoise-cache-") as folder:
        caches = {variable: str(Path(folder) / part) for variable, part in CACHE_VARIABLES.items()}
        for path in caches.values():
            Path(path).mkdir(exist_ok=True)
        worker = Worker(name, Place(place.planes, place.pixels, {**place.variables, **caches}))
        seconds = []
        for _ in range(2):
            try:
                seconds.append(sum(worker.start().values()))
            finally:
                worker.stop()
    return seconds[0], seconds[1]
