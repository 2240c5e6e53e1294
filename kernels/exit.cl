/* The exit: planes become the interleaved array that the user gets. Strides and offset count elements. */
#include "common.h"
#include "interleave.h"

/* What the type cannot hold becomes the most it can; a NaN, which must not be, would stay one and be seen. */
#define WITHIN(v, type) ((v) > MOST ? (type)(MOST) : (v) < -MOST ? (type)(-MOST) : (v))

#if defined(TARGET_HALF)
#define TARGET half
#define WRITE(v, i) vstore_half_rte(WITHIN(v, float), i, target)
#define MOST 65504.f
#define WRITE_VECTOR(v, p) JOIN(JOIN(vstore_half, WIDTH), _rte)(v, 0, p)
#elif defined(TARGET_DOUBLE)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define TARGET double
#define WRITE(v, i) target[i] = (double)(v)
#else
#define TARGET float
#define WRITE(v, i) target[i] = WITHIN(v, float)
#define MOST FLT_MAX
#define WRITE_VECTOR(v, p) STORE(v, p)
#endif

#if defined(PACKED) && WIDTH > 1
/* Three channels that follow each other, pixels too. */
kernel void leave_packed(CONST_PLANES(in), int height, int width, global TARGET *restrict target, int offset, int row)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    vec out[3];
    put_together(WITHIN(VECTOR_AT(in, 0, y, x), vec), WITHIN(VECTOR_AT(in, 1, y, x), vec),
                 WITHIN(VECTOR_AT(in, 2, y, x), vec), out);
    global TARGET *to = target + offset + y * row + x * 3;
    if (x + WIDTH <= width) {
        for (int k = 0; k < 3; k++)
            WRITE_VECTOR(out[k], to + k * WIDTH);
        return;
    }
    float lanes[3 * WIDTH];
    for (int k = 0; k < 3; k++)
        STORE(out[k], lanes + k * WIDTH);
    for (int i = 0; i < 3 * (width - x); i++)
        WRITE(lanes[i], offset + y * row + x * 3 + i);
}
#endif

kernel void leave(CONST_PLANES(in), int channels, int height, int width, global TARGET *restrict target,
                  int offset, int row, int column, int channel)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    for (int c = 0; c < channels; c++)
        WRITE(AT(in, c, y, x), offset + y * row + x * column + c * channel);
}
