"""The Dask cluster of a farm: how it is reached or started, and which of its workers can be used."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import pyopencl as cl

from . import farm_worker
from .choose import ALL, pick_devices
from .device import DEVICE_VARIABLE
from .errors import FarmError
from .farm_plan import MOST_AT_ONCE
from .farm_worker import Look

#: What `dask=` and `--dask` take for a cluster of this machine's own devices.
LOCAL = "local"
#: Seconds to wait for a scheduler to answer, and for a first worker.
ANSWER, FIRST_WORKER = 30, 60


@contextlib.contextmanager
def connected(dask: Any, device: Any) -> Iterator[tuple[Any, Any]]:
    """A client of the cluster, and which devices its workers are to use.

    Raises:
        FarmError: `dask.distributed` is missing, or there is no such cluster.
        DeviceError: with "local", there is no such device.
    """
    if any(isinstance(one, cl.Device) for one in (device if isinstance(device, list | tuple) else [device])):
        raise FarmError(f"device is {device!r}: give a name or a number, which is looked up on each worker")
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise FarmError(
            f"a farm needs dask.distributed, which is missing ({error}): pip install 'mcdenoise-cl[farm]'"
        ) from error
    if isinstance(dask, distributed.Client):
        if dask.asynchronous:
            raise FarmError("dask is an asynchronous Client: give a synchronous one, or the address of the scheduler")
        yield dask, device
        return
    if not isinstance(dask, str) or not dask.strip():
        raise FarmError(f"dask is {dask!r}: give an address such as tcp://host:8786, {LOCAL!r}, or a Client")
    with contextlib.ExitStack() as stack:
        if dask == LOCAL:
            if device is None and not os.environ.get(DEVICE_VARIABLE):
                device = ALL
            address: Any = stack.enter_context(_local(distributed, len(pick_devices(device))))
        else:
            address = dask
        try:
            client = distributed.Client(address, timeout=ANSWER, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise FarmError(
                f"no Dask scheduler answers at {dask} ({error}): start one with `dask scheduler`, and give the address "
                "that it prints"
            ) from error
        yield stack.enter_context(client), device


@contextlib.contextmanager
def _local(distributed: Any, count: int) -> Iterator[Any]:
    import dask

    # Without a limit of memory: Dask's would be a part of the machine's by the number of threads, and end workers that
    # do large frames. And a worker that ends twice within Dask's 15 seconds would not be started a third time.
    with (
        dask.config.set({"distributed.deploy.lost-worker-timeout": "1000 days"}),
        distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=MOST_AT_ONCE,
            processes=True,
            memory_limit=0,
            dashboard_address="127.0.0.1:0",
            preload=[*dask.config.get("distributed.worker.preload", []), farm_worker.__name__],
            silence_logs="CRITICAL",
        ) as cluster,
    ):
        yield cluster


def threads_of(client: Any) -> dict[str, int] | None:
    """Address and number of threads of each worker; None where the scheduler cannot be asked."""
    if client.status != "running":
        return None
    try:
        return dict(client.nthreads())
    except (OSError, TimeoutError):
        return None


def examine(
    client: Any,
    question: tuple[Any, str, list[str]],
    note: Callable[[str], None],
    known: set[str],
    strict: bool,
) -> dict[str, tuple[Look, int]]:
    """The workers that can be used, of those not yet known, which then are.

    Args:
        question: what `farm_worker.look` takes.
        note: told of those that cannot.
        strict: other versions, and that there is none, are errors.

    Raises:
        FarmError: with `strict`, as said there.
    """
    if strict:
        _check_scheduler(client)
        _await_worker(client)
    threads = {address: count for address, count in (threads_of(client) or {}).items() if address not in known}
    other = {}
    for address, found in client.run(farm_worker.versions, workers=[*threads], on_error="return").items():
        text = _mismatch(found)
        if text:
            other[f"worker {address}"] = text
            known.add(address)
    if other and strict:
        raise _versions_error(other)
    for name, text in other.items():
        note(f"{name} is left out, as it {text}")
    left = [address for address in threads if address not in known]
    looks: dict[str, Any] = client.run(farm_worker.look, *question, workers=left, on_error="return") if left else {}
    usable, problems = {}, []
    for address, look in looks.items():
        if isinstance(look, OSError):  # it went meanwhile; if not, it is asked again
            continue
        known.add(address)
        if isinstance(look, Look) and not look.problem:
            usable[address] = look, threads[address]
            continue
        problem = f"worker {look.host} ({address}): {look.problem}" if isinstance(look, Look) else f"{address}: {look}"
        problems.append(problem)
        note(f"left out {problem}")
    if strict and not usable:
        raise FarmError("no worker can be used: " + "; ".join(problems[:3]) + _more(problems))
    return usable


def _await_worker(client: Any) -> None:
    if not threads_of(client):
        with contextlib.suppress(TimeoutError):
            client.wait_for_workers(1, timeout=FIRST_WORKER)
    if not threads_of(client):
        raise FarmError(
            f"the cluster has no worker: start some with `dask worker {client.scheduler.address}`, "
            "on machines with an OpenCL device"
        )


def _check_scheduler(client: Any) -> None:
    """The scheduler reads the tasks too."""
    try:
        found: Any = client.run_on_scheduler(farm_worker.versions)
    except Exception as error:
        found = error
    text = _mismatch(found)
    if text:
        raise _versions_error({"the scheduler": text})


def _mismatch(found: Any) -> str:
    """In what the versions of another process are not those of this one; "" where they are."""
    if isinstance(found, OSError):
        return ""
    if isinstance(found, BaseException):
        return f"cannot load what a farm needs ({type(found).__name__}: {found})"
    there = dict(found)
    pairs = [(name, there.get(name), here) for name, here in farm_worker.versions() if there.get(name) != here]
    return "" if not pairs else "has " + ", ".join(f"{name} {other} (here {here})" for name, other, here in pairs)


def _versions_error(other: dict[str, str]) -> FarmError:
    named = [f"{name} {text}" for name, text in other.items()]
    return FarmError(
        "; ".join(named[:3]) + f"{_more(named)}: all machines of a farm need the same versions, "
        "pip install 'mcdenoise-cl[farm]' in each environment"
    )


def _more(items: list[str]) -> str:
    return f" and {len(items) - 3} more" if len(items) > 3 else ""
