"""Intel's CPU runtime deletes a context that a queue is still attached to.

OpenCL deletes one when it is released and so is all that is attached to it (1.2, clReleaseContext). Here the queue is
left with a context that is no more. So tests hold on to theirs. Seen with 2026.22.10. Exits with 1 where it is so:

    MCDENOISE_DEVICE=intel python tests/upstream/intel_context.py
"""

import sys

import pyopencl as cl

from mcdenoise_cl.choose import pick_device


def main() -> int:
    context = cl.Context([pick_device().device])
    queue = cl.CommandQueue(context)
    del context
    try:
        print(f"the queue's context has {len(queue.context.devices)} device")
    except cl.LogicError as error:
        print(f"the queue's context: {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
