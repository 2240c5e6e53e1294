/* A filtered frame drawn back to its input, as far as the noise of the input cannot explain what the filter changed
 * (James and Stein 1961).
 *
 * Of a pixel y = x + n, n of variance V, and a filtered one f that kept the part t of n: among the mixes y + a (f - y),
 * a = V (1 - t) / E (f - y)^2 has the least error, 1 where f lies as far off as its noise tells, and less where f is
 * wrong. Each channel has its own a, as a dark one has little say in a choice made by luminance. Means are over blocks
 * of 8x8 pixels and the eight around, relative to the brightness, as a light is no reason to change the wall beside it;
 * to that of the brighter frame, as one pixel that the filter took for the light must not speak for a block.
 */
#include "luminance.h"

#define BLOCK 8

/* What noise is relative to: the square of a channel, but not less than that of a faint part of the luminance. */
#define FAINT 0.03f
#define DARKEST2 1e-6f
#define RELATIVE_TO(value, light) ((value) * (value) + FAINT * FAINT * (light) * (light) + DARKEST2)

/* Variances so many times the squared brightness, and more, are alike. */
#define MOST_NOISE 1e12f

/* A share of the filtered frame below this is none: there is next to nothing to gain. */
#define LEAST_SHARE 0.1f

/* Planes of blocks: three of noise, three of squared changes, d_f d_y and d_y^2 for t: of the luminance, or, where the
 * frame was disturbed (response.cl), of each channel. */
#ifdef DISTURBED
#define DIFFERENCES 3
#else
#define DIFFERENCES 1
#endif
enum { NOISE, MOVED = NOISE + 3, KEPT = MOVED + 3, OWN = KEPT + DIFFERENCES };

inline float8 light_of(const float8 *color)
{
    return 0.2126f * color[0] + 0.7152f * color[1] + 0.0722f * color[2];
}

inline float total(float8 v)
{
    const float4 four = v.lo + v.hi;
    return (four.x + four.y) + (four.z + four.w);
}

/* The planes of `block_means`, a work-item a block. Noise is sum V^2 / sum V, the variance that the average bit of
 * noise comes with: where few samples have found the light, most pixels seem to have none. */
kernel void block_means(CONST_PLANES(filtered), CONST_PLANES(input), CONST_PLANES(variance),
#ifdef DISTURBED
                        CONST_PLANES(disturbed), CONST_PLANES(response),
#endif
                        int height, int width, PLANES(out))
{
    const int left = get_global_id(0) * BLOCK, top = get_global_id(1) * BLOCK;
    if (left >= width || top >= height)
        return;
    const int8 inside = left + (int8)(0, 1, 2, 3, 4, 5, 6, 7) < width;
    const int bottom = min(top + BLOCK, height);
    float8 noise[3], squares[3], moved[3], kept[DIFFERENCES], own[DIFFERENCES];
    for (int c = 0; c < 3; c++)
        noise[c] = squares[c] = moved[c] = (float8)(0.f);
    for (int i = 0; i < DIFFERENCES; i++)
        kept[i] = own[i] = (float8)(0.f);
    for (int y = top; y < bottom; y++) {
        float8 before[3], after[3];
        for (int c = 0; c < 3; c++) {
            before[c] = vload8(0, input + INDEX(input, c, y, left));
            after[c] = vload8(0, filtered + INDEX(filtered, c, y, left));
        }
        const float8 light = light_of(before), new_light = light_of(after);
        for (int c = 0; c < 3; c++) {
            const float8 scale = RELATIVE_TO(before[c], light), change = after[c] - before[c];
            const float8 v = vload8(0, variance + INDEX(variance, c, y, left)) / scale;
            const float8 each = select((float8)(0.f), clamp(v, 0.f, MOST_NOISE), inside);
            noise[c] += each;
            squares[c] += each * each;
            const float8 distance2 = change * change / fmax(scale, RELATIVE_TO(after[c], new_light));
            moved[c] += select((float8)(0.f), distance2, inside);
        }
        for (int i = 0; i < DIFFERENCES; i++) {
#ifdef DISTURBED
            const float8 d = vload8(0, disturbed + INDEX(disturbed, i, y, left)) - before[i];
            const float8 of_filtered = vload8(0, response + INDEX(response, i, y, left)) - after[i];
            const float8 scaled = d / fmax(RELATIVE_TO(before[i], light), RELATIVE_TO(after[i], new_light));
#else
            const float8 d = vload8(0, input + INDEX(input, 3, y, left));
            const float8 of_filtered = vload8(0, filtered + INDEX(filtered, 3, y, left));
            const float8 scaled = d / (fmax(light * light, new_light * new_light) + LEAST_LUMINANCE2);
#endif
            kept[i] += select((float8)(0.f), scaled * of_filtered, inside);
            own[i] += select((float8)(0.f), scaled * d, inside);
        }
    }
    const int x = get_global_id(0), y = get_global_id(1);
    const float each = 1.f / ((bottom - top) * (min(left + BLOCK, width) - left));
    for (int c = 0; c < 3; c++) {
#ifdef DISTURBED
        AT(out, NOISE + c, y, x) = each * total(noise[c]);
#else
        AT(out, NOISE + c, y, x) = total(squares[c]) / (total(noise[c]) + 1e-30f);
#endif
        AT(out, MOVED + c, y, x) = each * total(moved[c]);
    }
    for (int i = 0; i < DIFFERENCES; i++) {
        AT(out, KEPT + i, y, x) = each * total(kept[i]);
        AT(out, OWN + i, y, x) = each * total(own[i]);
    }
}

/* The mean of a block and of those around, weighted 1 2 1 both ways; blocks at the edge count for those beyond. */
#define AROUND(plane) around(means + INDEX(means, plane, 0, 0), means_row, above, y, below, left, x, right)
inline float around(global const float *p, int row, int above, int y, int below, int left, int x, int right)
{
    const float first = p[above * row + left] + 2.f * p[above * row + x] + p[above * row + right];
    const float second = p[y * row + left] + 2.f * p[y * row + x] + p[y * row + right];
    const float third = p[below * row + left] + 2.f * p[below * row + x] + p[below * row + right];
    return (first + 2.f * second + third) / 16.f;
}

/* a of each block, three planes. The noise is the largest of the nine blocks. */
kernel void block_shares(CONST_PLANES(means), int down, int across, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= across || y >= down)
        return;
    const int above = max(y - 1, 0), below = min(y + 1, down - 1), left = max(x - 1, 0), right = min(x + 1, across - 1);
    float noise = 0.f;
    for (int j = above; j <= below; j++)
        for (int i = left; i <= right; i++)
            noise = larger(noise, AT(means, NOISE + c, j, i));
    const int difference = min(c, DIFFERENCES - 1);
    const float kept = clamp(AROUND(KEPT + difference) / (AROUND(OWN + difference) + 1e-30f), 0.f, 1.f);
    const float best = noise * (1.f - kept) / (AROUND(MOVED + c) + 1e-30f);
    AT(out, c, y, x) = clamp((best - LEAST_SHARE) / (1.f - LEAST_SHARE), 0.f, 1.f);
}

/* In place: filtered becomes input + a (filtered - input), a linear between the centres of blocks; the input's share in
 * it, where one is kept, grows by the mean of the channels. */
kernel void shrink(PLANES(filtered), CONST_PLANES(input), CONST_PLANES(shares), int height, int width
#ifdef WITH_SHARE
                   , PLANES(share)
#endif
)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const int down = (height + BLOCK - 1) / BLOCK, across = (width + BLOCK - 1) / BLOCK;
    const float v = (y + 0.5f) / BLOCK - 0.5f;
    const int above = max((int)floor(v), 0), below = min((int)floor(v) + 1, down - 1);
    const int first = max(x / BLOCK - 1, 0), last = min((x + WIDTH - 1) / BLOCK + 1, across - 1);
    int trusted = 1;
    for (int c = 0; c < 3; c++)
        for (int i = first; i <= last; i++)
            trusted &= AT(shares, c, above, i) == 1.f && AT(shares, c, below, i) == 1.f;
    /* To the last bit where nothing changes, which is nearly everywhere. */
    if (trusted)
        return;
    vec sum = (vec)(0.f);
    for (int c = 0; c < 3; c++) {
        float line[WIDTH];
        for (int k = 0; k < WIDTH; k++) {
            const float u = (x + k + 0.5f) / BLOCK - 0.5f;
            const int near = clamp((int)floor(u), 0, across - 1), far = min((int)floor(u) + 1, across - 1);
            const float upper = mix(AT(shares, c, above, near), AT(shares, c, above, far), u - floor(u));
            const float lower = mix(AT(shares, c, below, near), AT(shares, c, below, far), u - floor(u));
            line[k] = mix(upper, lower, v - floor(v));
        }
        const vec a = LOAD(line), before = VECTOR_AT(input, c, y, x), after = VECTOR_AT(filtered, c, y, x);
        STORE(a < 1.f ? before + a * (after - before) : after, filtered + INDEX(filtered, c, y, x));
        sum += a;
    }
#ifdef WITH_SHARE
    const vec part = VECTOR_AT(share, 0, y, x);
    STORE(1.f - sum / 3.f * (1.f - part), share + INDEX(share, 0, y, x));
#endif
}
