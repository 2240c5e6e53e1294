"""exp, log and powers of kernels/fast_math.h against NumPy's, over all that the kernels ask of them."""

import numpy as np
import pyopencl as cl
import pytest

from mcdenoise_cl import program

KERNEL = """
kernel void apply(global const float *in, global float *out)
{
    const int i = get_global_id(0) * WIDTH;
    STORE(FUNCTION(LOAD(in + i)), out + i);
}
"""


def apply(engine, tmp_path, function, values, width, more=""):
    """The function of each value, in float64."""
    for header in program.kernel_folder().glob("*.h"):
        (tmp_path / header.name).write_text(header.read_text(encoding="utf-8"), encoding="utf-8")
    (tmp_path / "apply.cl").write_text('#include "fast_math.h"\n' + more + KERNEL, encoding="utf-8")
    built = program.build(engine.context, "apply.cl", {"WIDTH": width, "FUNCTION": function}, tmp_path)
    values = np.resize(values.astype(np.float32), len(values) // width * width)
    flags = cl.mem_flags
    source = cl.Buffer(engine.context, flags.READ_ONLY | flags.COPY_HOST_PTR, hostbuf=values)
    out = cl.Buffer(engine.context, flags.WRITE_ONLY, values.nbytes)
    cl.Kernel(built, "apply")(engine.queue, (len(values) // width,), None, source, out)
    result = np.empty_like(values)
    cl.enqueue_copy(engine.queue, result, out, is_blocking=True)
    return values.astype(np.float64), result.astype(np.float64)


@pytest.mark.parametrize("width", [1, 4, 8])
def test_exp(engine, tmp_path, width):
    values, found = apply(engine, tmp_path, "fast_exp", np.linspace(-86, 88, 200001), width)
    error = np.abs(found / np.exp(values) - 1)
    assert np.all(error < 3e-7 + 8e-8 * np.abs(values))
    values, found = apply(engine, tmp_path, "fast_exp", np.linspace(0, -1, 100001), width)
    assert np.abs(found / np.exp(values) - 1).max() < 3e-7
    assert found[0] == 1
    values, found = apply(engine, tmp_path, "fast_exp", -np.logspace(2, 38, 64), width)
    assert np.all((found >= 0) & (found < 2e-38))


@pytest.mark.parametrize("width", [1, 4, 8])
def test_log(engine, tmp_path, width):
    values, found = apply(engine, tmp_path, "fast_log", np.logspace(-37, 38, 200000), width)
    assert np.all(np.abs(found - np.log(values)) < 3e-7 * np.maximum(np.abs(np.log(values)), 1e-3))
    values, found = apply(engine, tmp_path, "fast_log", 1 - np.logspace(-7, -1, 64), width)
    expected = np.log(values)
    assert np.all(np.abs(found - expected) <= 3e-7 * np.abs(expected))
    values, found = apply(engine, tmp_path, "fast_log", np.ones(64), width)
    assert np.all(found == 0)


@pytest.mark.parametrize("width", [1, 8])
def test_power(engine, tmp_path, width):
    values = np.concatenate([np.zeros(8), np.logspace(-30, 0, 20000)])
    for exponent in (1 / 2.2, 1 / 2.4, 2.2):
        folder = tmp_path / str(exponent)
        folder.mkdir()
        (folder / "power.h").write_text(f"#define POWER(x) fast_power(x, {exponent:.9f}f)\n", encoding="utf-8")
        given, found = apply(engine, folder, "POWER", values, width, '#include "power.h"\n')
        expected = given**exponent
        shown = expected > 1e-35
        assert np.all(found[given == 0] == 0) and np.all(found[~shown] < 2e-35)
        error = np.abs(found[shown] / expected[shown] - 1)
        assert np.all(error < 5e-7 * (1 + np.abs(np.log(expected[shown]))))
