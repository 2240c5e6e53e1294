"""A Dask scheduler and workers, each a process of its own, for test_farm.py."""

import os
import queue
import re
import subprocess
import sys
import threading
from pathlib import Path

PRELOAD = Path(__file__).with_name("farm_preload.py")
#: Seconds after which something is taken to hang. Nothing here is waited for by the clock.
HANGS = 3600


class Process:
    """A process, and what it says."""

    def __init__(self, *command, **environment):
        path = os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])])
        self.popen = subprocess.Popen(
            [sys.executable, "-m", *map(str, command)],
            env=os.environ | {"PYTHONPATH": path} | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.said, self._lines = [], queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self):
        for line in self.popen.stdout:
            self._lines.put(line)
        self._lines.put(None)

    def find(self, pattern):
        """The next line with this pattern, as a match; None: it has ended."""
        while (line := self._lines.get(timeout=HANGS)) is not None:
            self.said.append(line)
            match = re.search(pattern, line)
            if match:
                return match
        return None

    def wait_for(self, pattern):
        match = self.find(pattern)
        assert match, "it ended and said:\n" + "".join(self.said)
        return match

    def kill(self):
        self.popen.kill()
        self.popen.wait(HANGS)


class Farm:
    """A scheduler with two workers, each of which takes the device for its own, as with a GPU each."""

    def __init__(self):
        self.scheduler = Process(
            "distributed.cli.dask_scheduler", "--host=127.0.0.1", "--port=0", "--no-dashboard", "--no-show"
        )
        self.address = self.scheduler.wait_for(r"Scheduler at:\s+(tcp://\S+)")[1]
        self.workers = {}

    def fill(self):
        """Start as many workers as are missing; they are there when this returns."""
        self.workers = {number: worker for number, worker in self.workers.items() if worker.popen.poll() is None}
        missing = [number for number in range(2) if number not in self.workers]
        for number in missing:
            options = ("--host=127.0.0.1", "--no-nanny", "--no-dashboard", "--nthreads=2", f"--preload={PRELOAD}")
            self.workers[number] = Process(
                "distributed.cli.dask_worker", self.address, *options, CUDA_VISIBLE_DEVICES=str(number)
            )
        for number in missing:
            self.workers[number].wait_for(r"Registered to:")

    def close(self):
        for process in (*self.workers.values(), self.scheduler):
            process.kill()
