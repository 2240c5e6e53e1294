"""Many jobs on a Dask cluster, a frame a task: `denoise_files(..., dask=ADDRESS)` and `mcdenoise denoise --dask`.

Dask moves frames and answers, and says which workers there are. Which worker gets a frame, and when, is decided here:
each device of each machine is served by one worker process and given three frames at most at a time, so that neither
workers with many threads nor many workers on one machine crowd a GPU, and the scheduler never knows of more than a few
frames. A worker that is lost is noticed here too, and what it had is done again by others.
"""

from __future__ import annotations

import logging
import os
import queue
import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from . import farm_worker
from .errors import DeviceError, ExrError, FarmError, NoRoomError
from .farm_check import difference, sign_in
from .farm_cluster import connected, examine, threads_of
from .farm_plan import Places, Queue, Slot, Task
from .farm_worker import Answer, UnseenError, named
from .job import Job, Outcome, Recipe
from .stamp import stamp

#: Seconds between two looks at which workers there are.
TICK = 1.0
#: Seconds without any worker, or without the scheduler, after which the frames that are left are given up. Workers that
#: end are started again by their nannies, which takes a minute on a machine that is busy.
PATIENCE = 300.0
#: Seconds until a file that a worker has written must be seen here: network file systems remember for up to a minute
#: what was not there.
STORAGE_PATIENCE = 90.0
#: How often a frame is done again whose worker was lost.
RETRIES = 3
#: Seconds to wait for an answer that is said to be there: its worker may be lost just then.
FETCH = 10.0

_log = logging.getLogger(__name__)


def run_jobs(
    jobs: Sequence[Job],
    recipe: Recipe,
    dask: Any,
    *,
    device: Any = None,
    overwrite: bool = False,
    on_progress: Callable[[Outcome], None] | None = None,
    on_note: Callable[[str], None] | None = None,
    retries: int = RETRIES,
) -> list[Outcome]:
    """Do jobs on a Dask cluster; one that fails does not stop the others.

    Args:
        dask: the address of a scheduler, such as "tcp://host:8786"; "local" for a cluster of this machine's devices,
            which is closed at the end; or a `dask.distributed.Client`, which is not.
        device: as for `denoise_files`, looked up on each worker; None: the default device of each worker, with "local"
            all.
        overwrite: as for `run_job`.
        on_progress: as for `denoise_files`.
        on_note: called with a sentence about each worker that cannot be used or was lost; None: they are logged.
        retries: how often a frame is done again whose worker was lost while it had it.

    Returns:
        An outcome for each job, in order.

    Raises:
        FarmError: `dask.distributed` is missing, no scheduler answers, a worker has other versions than this process,
            or there is no worker that can be used.
    """
    outcomes: list[Any] = [None] * len(jobs)
    note = on_note or _log.warning
    with connected(dask, device) as (client, choice), sign_in(jobs) as sign:
        run = _Run(client, jobs, recipe, choice, overwrite, retries, note, sign)
        try:
            for index, outcome in run.outcomes():
                outcomes[index] = outcome
                if on_progress is not None:
                    on_progress(outcome)
        finally:
            run.stop()
    return outcomes


@dataclass(frozen=True, eq=False)
class _Flight:
    """A frame that a worker has."""

    task: Task
    slot: Slot
    future: Any


class _Run:
    """One run: hands out frames, gathers answers, and keeps an eye on the workers, all in the calling thread."""

    def __init__(
        self,
        client: Any,
        jobs: Sequence[Job],
        recipe: Recipe,
        device: Any,
        overwrite: bool,
        retries: int,
        note: Callable[[str], None],
        sign: str,
    ) -> None:
        self._client, self._jobs, self._recipe, self._overwrite = client, jobs, recipe, overwrite
        self._retries, self._note, self._id = retries, note, secrets.token_hex(8)
        self._queue = Queue(Task(index, _absolute(job)) for index, job in enumerate(jobs))
        sources = [str(path) for job in jobs[:1] for path in _absolute(job).inputs[:1] if path.is_file()]
        self._question = (device, sign, sources)
        self._places, self._known = Places(), set[str]()
        self._flights: dict[str, _Flight] = {}
        self._load: Counter[Any] = Counter()  # frames of each slot and of each worker
        self._unseen: list[tuple[float, _Flight, Answer]] = []
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._looked = self._served = time.monotonic()
        self._waits = False

    def outcomes(self) -> Iterator[tuple[int, Outcome]]:
        """What became of each job, in the order in which they finish."""
        if not self._jobs:
            return
        self._places.add(examine(self._client, self._question, self._note, self._known, strict=True))
        while self._queue or self._flights or self._unseen:
            self._hand_out()
            try:
                future = self._events.get(timeout=TICK)
            except queue.Empty:
                pass
            else:
                flight = self._flights.get(future.key)
                if flight is not None:
                    yield from self._landed(flight)
            if time.monotonic() - self._looked >= TICK:
                yield from self._look()
                self._looked = time.monotonic()

    def stop(self) -> None:
        """Take back what no worker has begun, and wait until what they have begun is finished."""
        if not self._flights or self._client.status != "running":
            return
        self._client.cancel([flight.future for flight in self._flights.values()])
        here = threads_of(self._client) or {}
        workers = [address for address in self._places.workers if address in here]
        if workers:
            self._client.run(farm_worker.end, self._id, workers=workers, on_error="ignore")
        self._flights.clear()

    def _hand_out(self) -> None:
        for slot in self._places.slots:
            while True:
                task = self._queue.next(slot, self._load[slot], self._load[slot.worker])
                if task is None:
                    break
                self._load.update((slot, slot.worker))
                future = self._client.submit(
                    farm_worker.do,
                    self._id,
                    task.job,
                    self._recipe,
                    slot.device.index,
                    self._overwrite,
                    task.losses > 0,
                    workers=[slot.worker],
                    pure=False,
                    key=f"mcdenoise-{self._id}-{task.index}-{secrets.token_hex(4)}",
                )
                self._flights[future.key] = _Flight(task, slot, future)
                future.add_done_callback(self._events.put)

    def _landed(self, flight: _Flight) -> Iterator[tuple[int, Outcome]]:
        """Something came back: an answer, or word that there will be none."""
        if flight.future.status in ("cancelled", "lost"):
            yield from self._lost(flight)
            return
        try:
            answer = flight.future.result(timeout=FETCH)
        except TimeoutError:  # the worker went with the answer; the next look at the workers settles it
            flight.future.add_done_callback(self._events.put)
            return
        except Exception as error:
            if type(error).__name__ in ("KilledWorker", "FutureCancelledError", "CancelledError"):
                yield from self._lost(flight)
            else:  # what `do` itself could not catch
                yield self._finish(flight, error=named(error, flight.slot.place))
            return
        error = answer.outcome.error
        if isinstance(error, UnseenError):
            yield from self._leave_out(flight, error)
        elif isinstance(error, DeviceError):
            yield from self._failed(flight, error)
        else:
            self._places.worked(flight.slot)
            yield from self._settle(flight, answer, time.monotonic() + STORAGE_PATIENCE)

    def _settle(self, flight: _Flight, answer: Answer, until: float) -> Iterator[tuple[int, Outcome]]:
        """Believe an answer when the file is seen here as well."""
        wrong = difference(flight.task.job, self._recipe, answer)
        if not wrong:
            yield self._finish(flight, outcome=answer.outcome)
        elif time.monotonic() < until:
            self._unseen.append((until, flight, answer))
            self._drop(flight)
        else:
            yield self._finish(flight, error=FarmError(f"{wrong} (written on {flight.slot.place})"))

    def _lost(self, flight: _Flight) -> Iterator[tuple[int, Outcome]]:
        """A worker is gone, and the frame with it."""
        task = flight.task
        task.losses += 1
        if task.losses <= self._retries:
            self._drop(flight)
            self._queue.again(task)
            return
        text = f"{task.job.source} was begun {task.losses} times and each time its worker was lost"
        hint = "see the logs of the workers, or do it without --dask"
        yield self._finish(flight, error=FarmError(f"{text}, last {flight.slot.place}: {hint}"))

    def _failed(self, flight: _Flight, error: Exception) -> Iterator[tuple[int, Outcome]]:
        """A device failed, so another one may do it."""
        task, slot = flight.task, flight.slot
        task.failed_on.add(slot)
        task.error = error
        self._drop(flight)
        self._queue.again(task)
        if not isinstance(error, NoRoomError) and self._places.failed(slot):
            self._note(f"{slot.device.name} of {slot.place} is left out from now on: {error}")
        yield from self._give_up_hopeless()

    def _leave_out(self, flight: _Flight, error: Exception) -> Iterator[tuple[int, Outcome]]:
        """A worker does not see what is seen here, and would fail at every frame in no time."""
        slot, task = flight.slot, flight.task
        try:
            stamp(task.job, self._recipe)
        except ExrError as missing:  # here neither
            yield self._finish(flight, error=missing)
            return
        task.failed_on.add(slot)
        task.error = error
        self._drop(flight)
        self._queue.again(task)
        if slot.worker in self._places.workers:
            self._note(f"worker {slot.place} is left out from now on: {error}")
            self._places.lose(slot.worker)
        yield from self._give_up_hopeless()

    def _give_up_hopeless(self) -> Iterator[tuple[int, Outcome]]:
        if self._places.slots:
            for task in self._queue.hopeless(self._places.slots):
                yield self._outcome(task, Outcome(task.job.source, task.job.target, error=task.error))

    def _look(self) -> Iterator[tuple[int, Outcome]]:
        """See which workers are gone and which are new, and which files are seen by now."""
        unseen, self._unseen = self._unseen, []
        for until, flight, answer in unseen:
            yield from self._settle(flight, answer, until)
        here = threads_of(self._client)
        if here is not None:
            for address in self._known - here.keys():
                self._known.discard(address)
                if address in self._places.workers:
                    self._note(f"worker {address} was lost: what it had is done again by others")
                    self._places.lose(address)
                for flight in [flight for flight in self._flights.values() if flight.slot.worker == address]:
                    yield from self._lost(flight)
            if here.keys() - self._known:
                self._places.add(examine(self._client, self._question, self._note, self._known, strict=False))
        yield from self._give_up_hopeless()
        if here and self._places.slots:
            self._served, self._waits = time.monotonic(), False
        elif self._client.status == "closed" or time.monotonic() - self._served > PATIENCE:
            yield from self._give_up(here)
        elif not self._waits:
            self._waits = True
            self._note(f"{_missing(here)}: waiting {PATIENCE:.0f} seconds for one")

    def _give_up(self, here: dict[str, int] | None) -> Iterator[tuple[int, Outcome]]:
        error = f"{_missing(here)}: start one and run again, what is done already will be skipped"
        for flight in list(self._flights.values()):
            yield self._finish(flight, error=FarmError(error))
        for task in self._queue.drain():
            yield self._outcome(task, Outcome(task.job.source, task.job.target, error=task.error or FarmError(error)))

    def _drop(self, flight: _Flight) -> None:
        if self._flights.pop(flight.future.key, None) is not None:
            self._load.subtract((flight.slot, flight.slot.worker))
            flight.future.release()

    def _finish(
        self, flight: _Flight, outcome: Outcome | None = None, error: Exception | None = None
    ) -> tuple[int, Outcome]:
        self._drop(flight)
        job = flight.task.job
        return self._outcome(flight.task, outcome or Outcome(job.source, job.target, error=error))

    def _outcome(self, task: Task, outcome: Outcome) -> tuple[int, Outcome]:
        """With the paths that were given, and what happened on the way."""
        job, notes = self._jobs[task.index], outcome.notes
        if task.losses and outcome.error is None:
            workers = "1 worker that had it was" if task.losses == 1 else f"{task.losses} workers that had it were"
            notes += (f"handed out again, as {workers} lost",)
        return task.index, replace(outcome, source=job.source, target=job.target, notes=notes)


def _missing(here: dict[str, int] | None) -> str:
    return "the Dask scheduler is lost" if here is None else "no worker that can be used is left"


def _absolute(job: Job) -> Job:
    """Workers have working folders of their own. Links stay: they may lead elsewhere there."""

    def absolute(path: Path) -> Path:
        return Path(os.path.abspath(path))  # noqa: PTH100 (a Path's follows links)

    halves = None if job.halves is None else tuple(map(absolute, job.halves))
    return Job(absolute(job.source), absolute(job.target), halves, tuple(map(absolute, job.neighbours)))
