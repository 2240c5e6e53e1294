"""oclgrind takes what it knows of a freed buffer for that of the next one: whether and how far it has been written.

The second buffer is larger than the first; the kernel has written all of it, and oclgrind calls what lies beyond the
size of the first uninitialised. The third holds nothing yet, and oclgrind takes what the first had written for written.
So small_frames.py keeps every buffer that the engine asks for. Seen with oclgrind 21.10:

    oclgrind --uninitialized python tests/upstream/oclgrind_freed.py
"""

import pyopencl as cl

SOURCE = """
kernel void ones(global float *out) { out[get_global_id(0)] = 1.f; }
kernel void copy(global const float *in, global float *out) { out[get_global_id(0)] = in[get_global_id(0)]; }
"""


def main() -> None:
    context = cl.Context(cl.get_platforms()[0].get_devices()[:1])
    queue = cl.CommandQueue(context)
    program = cl.Program(context, SOURCE).build()
    ones, copy = cl.Kernel(program, "ones"), cl.Kernel(program, "copy")
    out = cl.Buffer(context, cl.mem_flags.READ_WRITE, 256)
    for count, written in ((4, True), (8, True), (8, False)):
        print(f"{count} floats, {'all' if written else 'none'} of them written", flush=True)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * count)
        if written:
            ones(queue, (count,), None, buffer)
        copy(queue, (count,), None, buffer, out)
        queue.finish()
        buffer.release()


if __name__ == "__main__":
    main()
