"""Who does what in a farm: which worker serves which device, and which frame it gets next. Knows nothing of Dask."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from .crew import MOST_FAILURES
from .farm_worker import Found, Look
from .job import Job

#: Frames that a device is given at once: one to read, one to denoise, one to write.
MOST_AT_ONCE = 3


@dataclass(frozen=True)
class Slot:
    """A device of a machine, served by one worker.

    Attributes:
        worker: its address.
        place: worker and machine, in words.
        device: which device it is, there.
        room: how many frames it is given at once.
    """

    worker: str
    place: str
    device: Found
    room: int


@dataclass(eq=False)
class Task:
    """A frame.

    Attributes:
        index: which one.
        job: what there is to do, with paths that hold on every machine.
        losses: how many workers were lost while they had it.
        failed_on: devices it failed on, for reasons that may be the device's.
        error: what the last of them said.
    """

    index: int
    job: Job
    losses: int = 0
    failed_on: set[Slot] = field(default_factory=set)
    error: Exception | None = None


class Places:
    """The workers, and the slots that follow from them: each device of each machine is served by one worker.

    Where several workers of a machine may use one device, the others wait in reserve until that one is lost. Where a
    worker may use several devices, they are shared among the workers of its machine.
    """

    def __init__(self) -> None:
        self._workers: dict[str, tuple[Look, int]] = {}
        self._slots: dict[tuple[Any, ...], Slot] = {}
        self._failures: dict[Slot, int] = {}
        self._retired: set[tuple[str, tuple[Any, ...]]] = set()

    @property
    def slots(self) -> list[Slot]:
        return list(self._slots.values())

    @property
    def workers(self) -> list[str]:
        return list(self._workers)

    def add(self, looks: Mapping[str, tuple[Look, int]]) -> None:
        """Workers that can be used, by address, each with its number of threads."""
        self._workers.update(looks)
        self._deal()

    def lose(self, address: str) -> None:
        """A worker is gone, or must not be used any more."""
        self._workers.pop(address, None)
        self._deal()

    def worked(self, slot: Slot) -> None:
        """A frame came back as it should."""
        self._failures.pop(slot, None)

    def failed(self, slot: Slot) -> bool:
        """A device failed; whether that was once too often in a row, so that this worker no longer uses it."""
        self._failures[slot] = self._failures.get(slot, 0) + 1
        if self._failures[slot] < MOST_FAILURES or slot not in self._slots.values():
            return False
        self._retired.add((slot.worker, slot.device.key))
        self._deal()
        return True

    def _deal(self) -> None:
        offers: dict[tuple[Any, ...], list[tuple[str, Found]]] = {}
        for address, (look, _) in self._workers.items():
            for device in look.devices:
                if (address, device.key) not in self._retired:
                    offers.setdefault(device.key, []).append((address, device))
        kept = {
            key: slot
            for key, slot in self._slots.items()
            if any(address == slot.worker for address, _ in offers.get(key, ()))
        }
        burden = dict.fromkeys(self._workers, 0)
        for slot in kept.values():
            burden[slot.worker] += 1
        # Devices that few workers offer come first, so that those who offer many are left for the others.
        for key, offered in sorted(offers.items(), key=lambda item: len(item[1])):
            if key in kept:
                continue
            address, device = min(offered, key=lambda offer: burden[offer[0]])
            burden[address] += 1
            look, threads = self._workers[address]
            kept[key] = Slot(address, f"{look.host} ({address})", device, min(threads + 1, MOST_AT_ONCE))
        self._slots = kept


class Queue:
    """The frames that wait. Those that were lost with a worker, or failed on a device, come last and alone.

    Alone, so that it is known which frame a worker was lost with; last, so that a frame that ends every process it
    gets into does so when the others are done.
    """

    def __init__(self, tasks: Iterable[Task]) -> None:
        self._fresh = deque(tasks)
        self._again: deque[Task] = deque()

    def __len__(self) -> int:
        return len(self._fresh) + len(self._again)

    def again(self, task: Task) -> None:
        self._again.append(task)

    def next(self, slot: Slot, has: int, busy: int) -> Task | None:
        """The next frame for a slot that has so many already, of a worker that has so many on all its devices."""
        if self._fresh:
            return self._fresh.popleft() if has < slot.room else None
        if busy == 0:
            for task in self._again:
                if slot not in task.failed_on:
                    self._again.remove(task)
                    return task
        return None

    def hopeless(self, slots: Iterable[Slot]) -> list[Task]:
        """Takes out the frames that have failed on every slot there is."""
        slots = set(slots)
        lost = [task for task in self._again if task.failed_on and task.failed_on >= slots]
        for task in lost:
            self._again.remove(task)
        return lost

    def drain(self) -> list[Task]:
        """Takes out all."""
        rest = [*self._again, *self._fresh]
        self._fresh.clear()
        self._again.clear()
        return rest
