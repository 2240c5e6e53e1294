/* The door: a user's interleaved array becomes planes, and no NaN or infinity gets past it.
 *
 * A pixel with any non-finite channel is replaced as a whole (one channel alone would change its hue) by the
 * mean of the good pixels in the smallest window around it that has any, up to radius 8; else by `lost`.
 * Strides and offset count elements, so any layout of the user's array can be read.
 */
#include "common.h"
#include "interleave.h"

#if defined(SOURCE_HALF)
#define SOURCE half
#define READ(i) vload_half(i, source)
#define READ_VECTOR(p) JOIN(vload_half, WIDTH)(0, p)
#elif defined(SOURCE_DOUBLE)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#define SOURCE double
#define READ(i) ((float)source[i])
#else
#define SOURCE float
#define READ(i) source[i]
#define READ_VECTOR(p) LOAD(p)
#endif

#define FILL_RADIUS 8

/* Channels that follow each other, and pixels too, need no strides. */
#ifdef PACKED
#define AT_SOURCE(c, y, x) READ(offset + (y) * row + (x) * CHANNELS + (c))
#else
#define AT_SOURCE(c, y, x) READ(offset + (y) * row + (x) * column + (c) * channel)
#endif

#define SOURCE_ARGUMENTS global const SOURCE *restrict source, int offset, int row, int column, int channel

/* All ones in an infinity and in a NaN: bits are asked, since to some compilers x * 0 is 0 whatever x is. */
#define EXPONENT 0x7f800000

/* The pixel, or what takes its place. */
inline bool pixel_at(SOURCE_ARGUMENTS, int y, int x, float value[CHANNELS])
{
    bool finite = true;
    for (int c = 0; c < CHANNELS; c++) {
        value[c] = AT_SOURCE(c, y, x);
        finite = finite && isfinite(value[c]);
    }
    return finite;
}

inline void replacement(SOURCE_ARGUMENTS, int height, int width, int y, int x, float lost, float value[CHANNELS])
{
    for (int c = 0; c < CHANNELS; c++)
        value[c] = lost;
    int found = 0;
    for (int r = 1; r <= FILL_RADIUS && found == 0; r++)
        for (int v = max(y - r, 0); v <= min(y + r, height - 1); v++)
            for (int u = max(x - r, 0); u <= min(x + r, width - 1); u++) {
                float other[CHANNELS];
                if (pixel_at(source, offset, row, column, channel, v, u, other)) {
                    found++;
                    for (int c = 0; c < CHANNELS; c++)
                        value[c] += (other[c] - value[c]) / found;
                }
            }
}

/* Rows `start` to `stop` of a source of `height` rows. Of its replaced pixels those count that lie in rows `first` to
 * `last`. */
kernel void door(SOURCE_ARGUMENTS, int height, int width, int start, int stop, int first, int last, PLANES(out),
                 volatile global int *restrict bad, int slot, float lost)
{
    const int x = get_global_id(0) * WIDTH, y = start + get_global_id(1);
    if (x >= width || y >= stop)
        return;
    if (x + WIDTH <= width) {
        vec value[CHANNELS];
        whole largest = (whole)(0);
#if defined(PACKED) && defined(READ_VECTOR) && WIDTH > 1 && CHANNELS == 3
        global const SOURCE *from = source + offset + y * row + x * CHANNELS;
        take_apart(READ_VECTOR(from), READ_VECTOR(from + WIDTH), READ_VECTOR(from + 2 * WIDTH), value);
#elif defined(PACKED) && defined(READ_VECTOR) && WIDTH > 1 && CHANNELS == 1
        value[0] = READ_VECTOR(source + offset + y * row + x);
#else
        float lanes[CHANNELS][WIDTH];
        for (int i = 0; i < WIDTH; i++)
            for (int c = 0; c < CHANNELS; c++)
                lanes[c][i] = AT_SOURCE(c, y, x + i);
        for (int c = 0; c < CHANNELS; c++)
            value[c] = LOAD(lanes[c]);
#endif
        for (int c = 0; c < CHANNELS; c++)
            largest = max(largest, AS_WHOLE(value[c]) & EXPONENT);
        if (ALL(largest < EXPONENT)) {
            for (int c = 0; c < CHANNELS; c++)
                STREAM(value[c], out + INDEX(out, c, y - start, x));
            return;
        }
    }
    for (int i = 0; i < WIDTH && x + i < width; i++) {
        float value[CHANNELS];
        if (!pixel_at(source, offset, row, column, channel, y, x + i, value)) {
            if (y >= first && y < last)
                atomic_inc(bad + slot);
            replacement(source, offset, row, column, channel, height, width, y, x + i, lost, value);
        }
        for (int c = 0; c < CHANNELS; c++)
            AT(out, c, y - start, x + i) = value[c];
    }
}
