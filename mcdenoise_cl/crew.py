"""The devices that share a queue of frames: what one fails at goes to the others."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any

#: After so many failures in a row a device is given no more frames.
MOST_FAILURES = 3


@dataclass(eq=False)
class Task:
    """A frame on its way.

    Attributes:
        work: whatever the devices are to do.
        failed_on: the devices that failed at it.
        error: what the last of them said.
    """

    work: Any
    failed_on: set[int] = field(default_factory=set)
    error: Exception | None = None


class Crew:
    """Frames that wait for a device, and the devices that still work. Devices are numbers from 0 on.

    A frame is tried once on each device at most. A device that fails three times in a row is left out from then on; a
    frame that no device is left for has failed.

    Args:
        devices: how many there are.
        expected: how many frames will come; `settle` tells of those that will not, or are done.
    """

    def __init__(self, devices: int, expected: int) -> None:
        self._working = dict.fromkeys(range(devices), 0)
        self._expected = expected
        self._waiting: list[Task] = []
        self._last_error: Exception | None = None
        self._changed = threading.Condition()

    def put(self, task: Task) -> bool:
        """Hand in a frame; False if there is no device left, whose error is then the frame's."""
        with self._changed:
            if not self._working:
                task.error = self._last_error
                self._settle()
                return False
            self._waiting.append(task)
            self._changed.notify_all()
            return True

    def take(self, device: int) -> Task | None:
        """The next frame for a device; waits for it. None: there is nothing more to do for this device."""
        with self._changed:
            while self._expected > 0 and device in self._working:
                for task in self._waiting:
                    if device not in task.failed_on:
                        self._waiting.remove(task)
                        return task
                self._changed.wait()
            return None

    def settle(self, device: int | None = None) -> None:
        """One of the expected frames is done, by this device, or will not come."""
        with self._changed:
            if device in self._working:
                self._working[device] = 0
            self._settle()

    def fail(self, device: int, task: Task, error: Exception) -> list[Task]:
        """A device failed at a frame, which waits for another now. Returns the frames that no device is left for."""
        with self._changed:
            task.failed_on.add(device)
            task.error = self._last_error = error
            self._working[device] += 1
            if self._working[device] >= MOST_FAILURES:
                del self._working[device]
            self._waiting.insert(0, task)
            hopeless = [task for task in self._waiting if task.failed_on.issuperset(self._working)]
            for lost in hopeless:
                self._waiting.remove(lost)
                lost.error = lost.error or error
                self._settle()
            self._changed.notify_all()
            return hopeless

    def stop(self) -> None:
        """Let nobody wait any longer."""
        with self._changed:
            self._expected = 0
            self._changed.notify_all()

    def _settle(self) -> None:
        self._expected -= 1
        if self._expected <= 0:
            self._changed.notify_all()
