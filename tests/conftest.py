"""Fixtures shared by the tests of kernels: one engine on the default device."""

import signal

import pyopencl as cl
import pytest
from processes import digest, filled, place, pocl, warm  # noqa: F401 (fixtures of the tests of caches)

from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import context_for, most_turns
from mcdenoise_cl.engine import Engine


@pytest.fixture(scope="session")
def device():
    """The device that `mcdenoise_cl` picks; without any OpenCL this fails, as it should."""
    return pick_device().device


@pytest.fixture(scope="session")
def tiles_work(device):
    """Whether the tile schedule can be right: not where long loops end early, as upstream/rusticl_loops.py shows."""
    return most_turns(device) is None


@pytest.fixture(scope="session")
def can_be_right(tiles_work):
    """Skips a test of a schedule that cannot be right on this device."""

    def check(schedule):
        if schedule == "tile" and not tiles_work:
            pytest.skip("loops end early here, so that tiles come out wrong: upstream/rusticl_loops.py")

    return check


@pytest.fixture(scope="session")
def engine(device):
    return Engine(cl.CommandQueue(context_for(device), device))


@pytest.fixture
def interruptible():
    """Ctrl-C ends things, here and in processes that are started, also where a shell that runs the tests in the
    background has it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
