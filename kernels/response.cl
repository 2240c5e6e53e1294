/* How much of its noise a filtered frame has, weights and all: a little more noise is added, and the frame filtered
 * again (Ramani, Blu and Unser 2008). Halves that go through the weights of the whole frame do not tell all of it, as
 * weights follow noise: a pixel is averaged with those that its noise makes it look like.
 */
#include "luminance.h"
#include "normal.h"

/* counts: in how many pixels the noise of the luminance is known and above 0, and in how many of them it is less than
 * `least` of the luminance. A work-item counts a stretch of a row. The rows are those of the planes. */
kernel void count_quiet(CONST_PLANES(color),
#ifdef HALVES
                        CONST_PLANES(a), CONST_PLANES(b),
#else
                        CONST_PLANES(variance),
#endif
                        int first_row, int last_row, int width, float least, int stretch,
                        volatile global int *restrict counts)
{
    const int first = get_global_id(0) * stretch, y = first_row + get_global_id(1);
    if (y >= last_row)
        return;
    int noisy = 0, quiet = 0;
    for (int x = first; x < min(first + stretch, width); x++) {
#ifdef HALVES
        const float deviation = 0.5f * (0.2126f * fabs(AT(a, 0, y, x) - AT(b, 0, y, x)) +
                                        0.7152f * fabs(AT(a, 1, y, x) - AT(b, 1, y, x)) +
                                        0.0722f * fabs(AT(a, 2, y, x) - AT(b, 2, y, x)));
#else
        const float deviation = DEVIATION(variance, y, x);
#endif
        noisy += deviation > 0.f;
        quiet += deviation > 0.f && deviation < least * LUMINANCE(color, y, x);
    }
    atomic_add(counts, noisy);
    atomic_add(counts + 1, quiet);
}

/* out: the colours and a part of the noise that they may have, which the channels share. The planes begin with row
 * `first` of the frame. */
kernel void disturb(CONST_PLANES(color), CONST_PLANES(variance), int height, int width, int first, float part,
                    PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float number = part * normal_number(first + y, x);
    for (int c = 0; c < 3; c++)
        AT(out, c, y, x) = AT(color, c, y, x) + number * sqrt(larger(AT(variance, c, y, x), 0.f));
}

/* The same from two halves, whose difference is noise as this frame has it. scale: what the colours were multiplied by;
 * factor: what outliers were besides. */
kernel void disturb_by_halves(CONST_PLANES(color), CONST_PLANES(a), CONST_PLANES(b), CONST_PLANES(factor), int height,
                              int width, global const float *restrict scale, float part, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float half_part = 0.5f * part * scale[0] * AT(factor, 0, y, x);
    for (int c = 0; c < 3; c++)
        AT(out, c, y, x) = AT(color, c, y, x) + half_part * (AT(a, c, y, x) - AT(b, c, y, x));
}
