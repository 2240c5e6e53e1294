"""What a device can do at all: multiply-adds and bytes copied a second. The floors of bench/README.md rest on them.

python bench/peaks.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pyopencl as cl

from mcdenoise_cl.choose import pick_device
from mcdenoise_cl.device import context_for, shape_for

SOURCE = """
/* CHAINS independent chains of multiply-adds, enough to hide how long each takes. */
kernel void multiply_add(global float *out, int steps, float factor)
{
    VEC sum[CHAINS];
    for (int i = 0; i < CHAINS; i++)
        sum[i] = (VEC)(get_global_id(0) + i);
    for (int step = 0; step < steps; step++)
#pragma unroll
        for (int i = 0; i < CHAINS; i++)
            sum[i] = fma(sum[i], (VEC)(factor), (VEC)(1e-7f));
    VEC total = sum[0];
    for (int i = 1; i < CHAINS; i++)
        total += sum[i];
    float lane[WIDTH];
    STORE(total, lane);
    out[get_global_id(0)] = lane[0];
}

kernel void copy(global const float *in, global float *out)
{
    STORE(LOAD(in + get_global_id(0) * WIDTH), out + get_global_id(0) * WIDTH);
}
"""
CHAINS, STEPS, ITEMS = 12, 20_000, 4096
FLOATS = 1 << 25


def best_of(run: Callable[[], cl.Event], rounds: int = 7) -> float:
    """Seconds of the fastest run, the first one left out."""
    times = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        run().wait()
        times.append(time.perf_counter() - start)
    return min(times[1:])


def main() -> None:
    info = pick_device()
    context, width = context_for(info.device), shape_for(info.device).width
    queue = cl.CommandQueue(context, info.device)
    vector = "float" if width == 1 else f"float{width}"
    load, store = ("*(p)", "*(p) = (v)") if width == 1 else (f"vload{width}(0, p)", f"vstore{width}(v, 0, p)")
    head = f"#define WIDTH {width}\n#define VEC {vector}\n#define CHAINS {CHAINS}\n"
    head += f"#define LOAD(p) {load}\n#define STORE(v, p) {store}\n"
    program = cl.Program(context, head + SOURCE).build()
    multiply_add, copy = (cl.Kernel(program, name) for name in ("multiply_add", "copy"))
    a, b = (cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * FLOATS) for _ in range(2))
    cl.enqueue_fill_buffer(queue, a, np.float32(1), 0, 4 * FLOATS).wait()
    items = ITEMS if width == 1 else ITEMS // width
    adds = best_of(lambda: multiply_add(queue, (items,), None, b, np.int32(STEPS), np.float32(0.999)))
    copied = best_of(lambda: copy(queue, (FLOATS // width,), None, a, b))
    print(f"{info.name} ({info.runtime}), {info.compute_units} compute units")
    print(f"multiply-adds: {items * width * CHAINS * STEPS / adds * 1e-9:.1f} billion a second")
    print(f"copied: {8 * FLOATS / copied * 1e-9:.1f} GB a second, read and written")


if __name__ == "__main__":
    main()
