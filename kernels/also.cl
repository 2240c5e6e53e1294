/* Further layers of a frame, filtered as its colour was: what was decided for the colour, done to them.
 *
 * Every step of a filter is linear in what it averages once its weights, factors and shares are known, so layers whose
 * sum is the colour come out with the clean colour as their sum. Layers are planes, three each, one after the other.
 */
#include "common.h"

/* In place: what `hold_back` does to colours, by the factor that it found. */
kernel void hold_back_also(PLANES(layers), CONST_PLANES(factor), int height, int width, PLANES(removed))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec before = VECTOR_AT(layers, c, y, x), after = VECTOR_AT(factor, 0, y, x) * before;
    STORE(after, layers + INDEX(layers, c, y, x));
    STORE(before - after, removed + INDEX(removed, c, y, x));
}

/* In place: a fit may overshoot below 0, where light cannot be; only a negative pixel may stay so. Where the colour's fit
 * does, it becomes its least, 0 or the pixel itself, and so do the layers', which keeps the sum. before: what was
 * fitted. */
kernel void bound_also(PLANES(fit), CONST_PLANES(color), PLANES(layers), CONST_PLANES(before), int count, int height,
                       int width)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec own = VECTOR_AT(color, c, y, x), value = VECTOR_AT(fit, c, y, x), least = smaller(own, (vec)(0.f));
    if (ALL(value >= least))
        return;
    STORE(larger(value, least), fit + INDEX(fit, c, y, x));
    for (int i = c; i < count; i += 3) {
        const vec kept = own < 0.f ? VECTOR_AT(before, i, y, x) : (vec)(0.f), fitted = VECTOR_AT(layers, i, y, x);
        STORE(value < least ? kept : fitted, layers + INDEX(layers, i, y, x));
    }
}

/* In place: from the layers to the candidate's, as far as its share goes. */
kernel void blend_also(PLANES(layers), CONST_PLANES(candidate), CONST_PLANES(share), int height, int width)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec before = VECTOR_AT(layers, c, y, x), after = VECTOR_AT(candidate, c, y, x), a = VECTOR_AT(share, 0, y, x);
    STORE(BLEND(before, after, a), layers + INDEX(layers, c, y, x));
}

/* What rounding, of half floats too, leaves between a colour and the sum of its layers, in units of what is summed. */
#define ROUNDING (1.f / 512.f)

/* Counts the pixels in which all layers together are the colour; a work-item a stretch of a row. */
kernel void count_sums(CONST_PLANES(layers), CONST_PLANES(color), int count, int height, int width, int stretch,
                       volatile global int *restrict counted)
{
    const int first = get_global_id(0) * stretch, y = get_global_id(1);
    if (y >= height)
        return;
    int found = 0;
    for (int x = first; x < min(first + stretch, width); x++) {
        bool whole = true;
        for (int c = 0; c < 3; c++) {
            float rest = AT(color, c, y, x), size = fabs(rest);
            for (int i = c; i < count; i += 3) {
                const float layer = AT(layers, i, y, x);
                rest -= layer;
                size += fabs(layer);
            }
            whole = whole && fabs(rest) <= ROUNDING * size;
        }
        found += whole;
    }
    atomic_add(counted, found);
}

/* In place: of layers that together are the colour in `enough` pixels, which were counted, each takes its part of what
 * rounding has left, by its size. */
kernel void settle_also(PLANES(layers), CONST_PLANES(color), int count, int height, int width,
                        global const int *restrict counted, int enough)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height || counted[0] < enough)
        return;
    vec sum = (vec)(0.f), size = (vec)(0.f);
    for (int i = c; i < count; i += 3) {
        const vec layer = VECTOR_AT(layers, i, y, x);
        sum += layer;
        size += fabs(layer);
    }
    const vec rest = VECTOR_AT(color, c, y, x) - sum;
    const vec part = fabs(rest) <= ROUNDING * size && size > 0.f ? rest / size : (vec)(0.f);
    for (int i = c; i < count; i += 3) {
        const vec layer = VECTOR_AT(layers, i, y, x);
        STORE(layer + part * fabs(layer), layers + INDEX(layers, i, y, x));
    }
}
