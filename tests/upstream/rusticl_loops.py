"""Mesa's rusticl on llvmpipe ends the loops of a work-item after 65535 turns in all, and says nothing.

So `device.py` picks the group schedule there, whose work-items have short loops, and `stages/nlm.py` refuses windows
over which they would not be. Seen with Mesa 22.3.6. Exits with 1 where the loops end early:

    RUSTICL_ENABLE=llvmpipe MCDENOISE_DEVICE=rusticl python tests/upstream/rusticl_loops.py
"""

import sys

import numpy as np
import pyopencl as cl

from mcdenoise_cl.choose import pick_device

SOURCE = """
kernel void turns(global int *turns, int outer, int inner)
{
    int count = 0;
    for (int i = 0; i < outer; i++)
        for (int j = 0; j < inner; j++)
            count += turns[1]; /* 1, but the compiler does not know */
    turns[0] = count;
}
"""


def main() -> int:
    context = cl.Context([pick_device().device])
    queue = cl.CommandQueue(context)
    kernel = cl.Kernel(cl.Program(context, SOURCE).build(), "turns")
    wrong = 0
    for outer, inner in ((1, 65535), (1, 65536), (1, 100000), (300, 200), (300, 300)):
        turns = np.array([0, 1], np.int32)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=turns)
        kernel(queue, (1,), None, buffer, np.int32(outer), np.int32(inner))
        cl.enqueue_copy(queue, turns, buffer)
        print(f"{outer} x {inner} turns: {turns[0]} counted, {outer * inner} expected")
        wrong += turns[0] != outer * inner
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
