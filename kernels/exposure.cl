/* Exposure and the tonemapped domain in which colours are compared.
 *
 * Automatic exposure = key / (geometric mean of the luminance over pixels that are not black), so that scaling
 * a frame scales its exposure by the inverse. One work-item sums a row; others add the rows in a fixed order, so that
 * the same frame gives the same bits.
 *
 * Black is 0, and what some renderers write for it: a tiny number, which would draw the mean down to nothing. Sums and
 * counts of each BIN_OCTAVES of luminance tell what lies too far below the level that the brightest LIT_PART reach.
 * Where nothing does, the mean is that of the plain sum.
 */
#include "fast_math.h"
#include "kahan.h"

/* A bin is a number's bits without the last BIN_BITS: 23 of the fraction and 3 of the exponent, so 8 octaves. */
#define BIN_BITS 26
#define BINS 32
/* Columns of sums and of counts: the bins, and everything. */
enum { EVERYTHING = BINS, COLUMNS_OF_BINS };

/* Rows that follow row `first` of the frame; COLUMNS_OF_BINS sums and counts each. A vector is added to each bin that it
 * has something of, 0 for the rest. */
kernel void log_luminance_rows(CONST_PLANES(color), int height, int width, int first, global float *restrict row_sum,
                               global int *restrict row_count)
{
    const int y = get_global_id(0);
    if (y >= height)
        return;
    vec sum[BINS], lost[BINS], count[BINS];
    for (int k = 0; k < BINS; k++)
        sum[k] = lost[k] = count[k] = (vec)(0.f);
    for (int x = 0; x < width; x += WIDTH) {
        vec v = luminance(VECTOR_AT(color, 0, y, x), VECTOR_AT(color, 1, y, x), VECTOR_AT(color, 2, y, x));
        if (x + WIDTH > width) {
            float lanes[WIDTH];
            STORE(v, lanes);
            for (int i = width - x; i < WIDTH; i++)
                lanes[i] = 0.f;
            v = LOAD(lanes);
        }
        const vec one = (vec)(1.f), zero = (vec)(0.f);
        const whole bin = AS_WHOLE(v) >> BIN_BITS;
        const int least = least_lane(v > zero ? bin : (whole)(BINS)), most = most_lane(v > zero ? bin : (whole)(-1));
        for (int k = least; k <= most; k++) {
            const vec low = (vec)(as_float(k << BIN_BITS)), next = (vec)(as_float((k + 1) << BIN_BITS));
            const vec from_here = v >= low ? (v > zero ? one : zero) : zero;
            const vec counted = k < BINS - 1 ? (v < next ? from_here : zero) : from_here;
            /* fast_log is for normal and finite numbers, as those between the first and the last bin are. */
            const vec logarithm = k > 0 && k < BINS - 1 ? fast_log(v) : log(v);
            add_vector_to(&sum[k], &lost[k], counted > zero ? logarithm : zero);
            count[k] += counted;
        }
    }
    float everything = 0.f, lost_of_it = 0.f;
    int counted = 0;
    for (int k = 0; k < BINS; k++) {
        float lanes[WIDTH], counts[WIDTH], lost_of_lanes = 0.f;
        STORE(sum[k], lanes);
        STORE(count[k], counts);
        for (int i = 1; i < WIDTH; i++) {
            add_to(&lanes[0], &lost_of_lanes, lanes[i]);
            counts[0] += counts[i];
        }
        add_to(&everything, &lost_of_it, lanes[0]);
        counted += (int)counts[0];
        row_sum[(first + y) * COLUMNS_OF_BINS + k] = lanes[0];
        row_count[(first + y) * COLUMNS_OF_BINS + k] = (int)counts[0];
    }
    row_sum[(first + y) * COLUMNS_OF_BINS + EVERYTHING] = everything;
    row_count[(first + y) * COLUMNS_OF_BINS + EVERYTHING] = counted;
}

/* A work-item a column. */
kernel void add_rows(global const float *restrict row_sum, global const int *restrict row_count, int height,
                     global float *restrict sums, global int *restrict counts)
{
    const int k = get_global_id(0);
    if (k >= COLUMNS_OF_BINS)
        return;
    float sum = 0.f, lost = 0.f;
    int count = 0;
    for (int y = 0; y < height; y++) {
        add_to(&sum, &lost, row_sum[y * COLUMNS_OF_BINS + k]);
        count += row_count[y * COLUMNS_OF_BINS + k];
    }
    sums[k] = sum;
    counts[k] = count;
}

/* Of a frame with next to no light, whose factor would be infinite. */
#define MOST_EXPOSURE 1e30f

/* One in so many pixels above 0 has to reach a level, and more than FEW, for what is far below it to be black: a few
 * fireflies and a small sun do not make the rest of the frame black. */
#define LIT_PART 100
#define FEW 15

/* range: bins below the level that count. */
kernel void exposure_from_bins(global const float *restrict sums, global const int *restrict counts, float key,
                               int range, global float *restrict exposure)
{
    float sum = sums[EVERYTHING];
    int count = counts[EVERYTHING], level = BINS - 1;
    for (int reached = counts[level]; level > 0 && reached <= max(count / LIT_PART, FEW); reached += counts[level])
        level--;
    int black = 0;
    for (int k = 0; k < level - range; k++)
        black += counts[k];
    if (black > 0) {
        count -= black;
        sum = 0.f;
        for (int k = max(level - range, 0); k < BINS; k++)
            sum += sums[k];
    }
    exposure[0] = count > 0 ? smaller(key / exp(sum / count), MOST_EXPOSURE) : 1.f;
}

/* Two curves from light to tone, both followed by a gamma of 2.2: CLIP cuts at 1, as a display does, and so takes
 * a lamp and a sunlit wall for the same; REINHARD, x / (1 + x), keeps all of them apart and can be undone. */
#define CLIP 0
#define REINHARD 1

kernel void tonemap(CONST_PLANES(color), int height, int width, global const float *restrict exposure, int curve,
                    PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec light = larger(exposure[0] * VECTOR_AT(color, c, y, x), (vec)(0.f));
    const vec tone = curve == CLIP ? smaller(light, (vec)(1.f)) : light / (light + 1.f);
    STORE(fast_power(tone, 1.f / 2.2f), out + INDEX(out, c, y, x));
}

kernel void tonemap_inverse(CONST_PLANES(in), int height, int width, global const float *restrict exposure, int curve,
                            PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec tone = fast_power(clamp(VECTOR_AT(in, c, y, x), (vec)(0.f), (vec)(1.f)), 2.2f);
    const vec light = curve == CLIP ? tone : tone / larger((vec)(1.f) - tone, (vec)(1e-6f));
    STORE(light / exposure[0], out + INDEX(out, c, y, x));
}

/* Light compressed for averaging, x / (1 + |x|) of the exposed colour: nearly linear in the dark, so that averaging
 * there keeps the energy, and bounded in the light, so that one firefly cannot outweigh its neighbours. */
inline vec compressed(vec light)
{
    return light / (1.f + fabs(light));
}

kernel void compress(CONST_PLANES(color), int height, int width, global const float *restrict exposure, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    STORE(compressed(exposure[0] * VECTOR_AT(color, c, y, x)), out + INDEX(out, c, y, x));
}

inline vec expanded(vec light)
{
    return light / larger((vec)(1.f) - fabs(light), (vec)(1e-6f));
}

/* Back to light, as a change of the colour that was compressed, so that what compression rounds off stays: a pixel
 * that the average left alone comes out to the last bit. */
kernel void expand(CONST_PLANES(in), CONST_PLANES(color), int height, int width,
                   global const float *restrict exposure, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec before = VECTOR_AT(color, c, y, x);
    const vec change = expanded(VECTOR_AT(in, c, y, x)) - expanded(compressed(exposure[0] * before));
    STORE(before + change / exposure[0], out + INDEX(out, c, y, x));
}

/* What the kernels above do to a colour, done to a layer of it: curves are scales, each pixel and channel its own, that
 * the colour says, and a mean of scaled light is linear in the light. */

/* layer: becomes the part of the compressed colour that it is of the colour. */
kernel void compress_also(CONST_PLANES(layer), CONST_PLANES(color), int height, int width,
                          global const float *restrict exposure, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec light = exposure[0] * VECTOR_AT(color, c, y, x);
    STORE(exposure[0] * VECTOR_AT(layer, c, y, x) / (1.f + fabs(light)), out + INDEX(out, c, y, x));
}

/* in, averaged: means of the compressed layer and of the compressed colour. */
kernel void expand_also(CONST_PLANES(in), CONST_PLANES(layer), CONST_PLANES(color), CONST_PLANES(averaged), int height,
                        int width, global const float *restrict exposure, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec before = VECTOR_AT(layer, c, y, x), light = exposure[0] * VECTOR_AT(color, c, y, x);
    const vec own = exposure[0] * before / (1.f + fabs(light)), tone = compressed(light);
    const vec old = own / larger((vec)(1.f) - fabs(tone), (vec)(1e-6f));
    const vec mean = VECTOR_AT(in, c, y, x) / larger((vec)(1.f) - fabs(VECTOR_AT(averaged, c, y, x)), (vec)(1e-6f));
    STORE(before + (mean - old) / exposure[0], out + INDEX(out, c, y, x));
}

/* in * to / from: what has become of a colour that was `from` and is `to`; 0 where there was none. */
kernel void scale_as(CONST_PLANES(in), CONST_PLANES(from), CONST_PLANES(to), int height, int width, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const vec before = VECTOR_AT(from, c, y, x), scaled = VECTOR_AT(in, c, y, x) * (VECTOR_AT(to, c, y, x) / before);
    STORE(before > 0.f ? scaled : (vec)(0.f), out + INDEX(out, c, y, x));
}
