/* The exit: planes become the interleaved array that the user gets. Strides and offset count elements. */
#include "common.h"

/* What the type cannot hold becomes the most it can; a NaN, which must not be, would stay one and be seen. */
#define WITHIN(v, most) (fabs(v) > most ? copysign(most, v) : v)

#if defined(TARGET_HALF)
#define TARGET half
#define WRITE(v, i) vstore_half_rte(WITHIN(v, 65504.f), i, target)
#elif defined(TARGET_DOUBLE)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define TARGET double
#define WRITE(v, i) target[i] = (double)(v)
#else
#define TARGET float
#define WRITE(v, i) target[i] = WITHIN(v, FLT_MAX)
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
