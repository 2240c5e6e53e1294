"""Small frames: they launch every kernel, none compiles with a warning, and what memory held reaches no result."""

import math

import numpy as np
import pyopencl as cl
import pytest
import small_frames

from mcdenoise_cl import program
from mcdenoise_cl.device import SCHEDULE_VARIABLE, SCHEDULES, context_for


@pytest.fixture(params=SCHEDULES)
def queue(request, device, can_be_right, monkeypatch):
    """A queue on which engines take this schedule."""
    can_be_right(request.param)
    monkeypatch.setenv(SCHEDULE_VARIABLE, request.param)
    return cl.CommandQueue(context_for(device), device)


def test_every_kernel_is_launched_and_compiles_without_a_warning(device, monkeypatch):
    queue = cl.CommandQueue(context_for(device), device)
    built, build = set(), program.build

    def noted(context, file, defines):
        built.add((file, *sorted(f"-D{n}" if value is None else f"-D{n}={value}" for n, value in defines.items())))
        return build(context, file, defines)

    monkeypatch.setattr(program, "build", noted)
    with small_frames.recorded() as launched:
        for schedule in SCHEDULES:
            monkeypatch.setenv(SCHEDULE_VARIABLE, schedule)
            for name in small_frames.NAMES:
                small_frames.run(name, queue)
    assert launched == small_frames.kernels()
    strict = ["-cl-std=CL1.2", "-Werror"]  # so a warning is an error
    for file, *options in built:
        cl.Program(queue.context, program.source(file)).build([*strict, *options], cache_dir=False)


@pytest.mark.parametrize("name", small_frames.NAMES)
@pytest.mark.parametrize(
    ("size", "small"),
    [(small_frames.SMALL, True), (small_frames.WHOLE, False), ((1, 1), False)],
    ids=["seams", "whole", "pixel"],
)
def test_what_memory_held_before_reaches_no_result(queue, name, size, small):
    how = {"size": size, "small": small}
    expected = small_frames.run(name, queue, **how)
    for value in (math.nan, 1e30, -1e30):
        with small_frames.filled(value):
            found = small_frames.run(name, queue, **how)
        assert found.keys() == expected.keys()
        for part, values in expected.items():
            np.testing.assert_array_equal(found[part], values, err_msg=f"{part} with memory full of {value}")


def test_filled_memory_shows_where_it_is_used(queue):
    with small_frames.filled(math.nan):
        engine = small_frames.Engine(queue)
        assert np.isnan(small_frames.to_array(engine, engine.planes(2, 3, 5))).all()
