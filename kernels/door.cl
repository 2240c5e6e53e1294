/* The door: a user's interleaved array becomes planes, and no NaN or infinity gets past it.
 *
 * A pixel with any non-finite channel is replaced as a whole (one channel alone would change its hue) by the
 * mean of the good pixels in the smallest window around it that has any, up to radius 8; else by zero.
 * Strides and offset count elements, so any layout of the user's array can be read.
 */
#include "common.h"

#if defined(SOURCE_HALF)
#define SOURCE half
#define READ(i) vload_half(i, source)
#elif defined(SOURCE_DOUBLE)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define SOURCE double
#define READ(i) ((float)source[i])
#else
#define SOURCE float
#define READ(i) source[i]
#endif

#define FILL_RADIUS 8

kernel void door(global const SOURCE *restrict source, int offset, int row, int column, int channel,
                 int channels, int height, int width, PLANES(out), volatile global int *restrict bad,
                 int slot)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    float value[3] = {0.f, 0.f, 0.f};
    bool good = true;
    for (int c = 0; c < channels; c++) {
        value[c] = READ(offset + y * row + x * column + c * channel);
        good = good && isfinite(value[c]);
    }
    if (!good) {
        atomic_inc(bad + slot);
        for (int c = 0; c < 3; c++)
            value[c] = 0.f;
        int found = 0;
        for (int r = 1; r <= FILL_RADIUS && found == 0; r++)
            for (int v = max(y - r, 0); v <= min(y + r, height - 1); v++)
                for (int u = max(x - r, 0); u <= min(x + r, width - 1); u++) {
                    float other[3];
                    bool finite = true;
                    for (int c = 0; c < channels; c++) {
                        other[c] = READ(offset + v * row + u * column + c * channel);
                        finite = finite && isfinite(other[c]);
                    }
                    if (finite) {
                        found++;
                        for (int c = 0; c < channels; c++)
                            value[c] += (other[c] - value[c]) / found;
                    }
                }
    }
    for (int c = 0; c < channels; c++)
        AT(out, c, y, x) = value[c];
}
