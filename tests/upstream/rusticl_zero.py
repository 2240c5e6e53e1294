"""To Mesa's rusticl on llvmpipe x * 0 is 0 for every x, infinities and NaN too.

So door.cl asks the bits. Seen with Mesa 22.3.6. Exits with 1 where it is so, or where `isfinite` is wrong:

    RUSTICL_ENABLE=llvmpipe MCDENOISE_DEVICE=rusticl python tests/upstream/rusticl_zero.py
"""

import sys

import numpy as np
import pyopencl as cl

from mcdenoise_cl.choose import pick_device

SOURCE = """
kernel void finite(global const float *in, global int *out)
{
    const int i = get_global_id(0);
    out[2 * i] = isfinite(in[i]) ? 1 : 0;
    out[2 * i + 1] = in[i] * 0.f == 0.f ? 1 : 0;
}
"""


def main() -> int:
    context = cl.Context([pick_device().device])
    queue = cl.CommandQueue(context)
    kernel = cl.Kernel(cl.Program(context, SOURCE).build(), "finite")
    values, found = np.array([1, np.inf, -np.inf, np.nan], np.float32), np.empty((4, 2), np.int32)
    given = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=values)
    out = cl.Buffer(context, cl.mem_flags.WRITE_ONLY, found.nbytes)
    kernel(queue, values.shape, None, given, out)
    cl.enqueue_copy(queue, found, out)
    for value, (finite, product) in zip(values, found, strict=True):
        print(f"{value}: isfinite says {bool(finite)}, x * 0 == 0 says {bool(product)}")
    return int((found != np.isfinite(values)[:, None]).any())


if __name__ == "__main__":
    sys.exit(main())
