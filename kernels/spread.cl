/* The energy removed from outliers, blurred, goes back: half of it evenly, half in proportion to the brightness.
 *
 * Rarely found light is spread well if many pixels have found some. One that has found more than MOST_LIGHT of all the
 * light around tells little of how much there is, and would be seen as a veil: only so much of it goes back.
 *
 * The blur is wide, so it is made of the means of blocks of SCALE x SCALE pixels, and interpolated between them.
 */
#include "common.h"

/* The mean of each block, of each plane. */
kernel void block_means(CONST_PLANES(in), int height, int width, PLANES(out))
{
    const int bx = get_global_id(0), by = get_global_id(1), c = get_global_id(2);
    if (bx * SCALE >= width || by * SCALE >= height)
        return;
    const int right = min((bx + 1) * SCALE, width), bottom = min((by + 1) * SCALE, height);
    float sum = 0.f;
    for (int y = by * SCALE; y < bottom; y++)
        for (int x = bx * SCALE; x < right; x++)
            sum += AT(in, c, y, x);
    AT(out, c, by, bx) = sum / ((bottom - by * SCALE) * (right - bx * SCALE));
}

#define MOST_LIGHT 0.04f

/* The mean brightness of each block, of the means of a block's colours, once this part of the removed light is back. */
kernel void brightness(CONST_PLANES(blocks), CONST_PLANES(removed), int down, int across, float part, PLANES(out))
{
    const int bx = get_global_id(0), by = get_global_id(1);
    if (bx >= across || by >= down)
        return;
    const float own = AT(blocks, 0, by, bx) + AT(blocks, 1, by, bx) + AT(blocks, 2, by, bx);
    const float back = AT(removed, 0, by, bx) + AT(removed, 1, by, bx) + AT(removed, 2, by, bx);
    AT(out, 0, by, bx) = (own + part * back) / 3.f;
}

/* What three boxes, each so many blocks wide, leave in its place of the light of block i, of n in a row: a quadratic
 * spline and what its mirror images add. The first and the last block, which are not repeated, are their own images. */
inline float spline(float t)
{
    t = fabs(t);
    return t < 0.5f ? 0.75f - t * t : t < 1.5f ? 0.5f * (1.5f - t) * (1.5f - t) : 0.f;
}

inline float left_in_place(int i, int n, int box)
{
    if (n == 1)
        return 1.f;
    const int period = 2 * (n - 1), images = 3 * box / (2 * period) + 1;
    float sum = 0.f;
    for (int image = -images; image <= images; image++) {
        sum += spline(image * period / (float)box);
        if (i > 0 && i < n - 1)
            sum += spline((image * period - 2 * i) / (float)box);
    }
    return sum / box;
}

/* What was removed from each block, as far as its blur makes no more than MOST_LIGHT of the light at its place; and the
 * part of it that this is. level: the light there with `counted` of what was removed, of which the block's own is taken
 * off again. */
kernel void limit_removed(CONST_PLANES(level), CONST_PLANES(removed), CONST_PLANES(counted), int down, int across,
                          int box, PLANES(limited), PLANES(kept))
{
    const int bx = get_global_id(0), by = get_global_id(1);
    if (bx >= across || by >= down)
        return;
    const float in_place = left_in_place(by, down, box) * left_in_place(bx, across, box) / 3.f;
    const float alone = in_place * (AT(removed, 0, by, bx) + AT(removed, 1, by, bx) + AT(removed, 2, by, bx));
    const float own = in_place * (AT(counted, 0, by, bx) + AT(counted, 1, by, bx) + AT(counted, 2, by, bx));
    const float most = MOST_LIGHT / (1.f - MOST_LIGHT) * larger(AT(level, 0, by, bx) - own, 0.f);
    const float part = alone > most ? most / alone : 1.f;
    for (int c = 0; c < 3; c++)
        AT(limited, c, by, bx) = part * AT(removed, c, by, bx);
    AT(kept, 0, by, bx) = part;
}

/* Where pixel i of a block lies: this far from one block's middle to the next, of the pair that begins `before` it. */
inline float between_blocks(int i, int *before)
{
    const float at = (i + 0.5f) / SCALE - 0.5f;
    *before = at < 0.f;
    return at + *before;
}

/* Removed light and brightness of a block. */
#define BLOCK_AT(y, x) \
    (float4)(AT(removed, 0, y, x), AT(removed, 1, y, x), AT(removed, 2, y, x), AT(bright, 0, y, x))

/* At most half as much again, whatever a fit has left of the surroundings. */
inline float gain_of(float4 here)
{
    const float mean = (here.x + here.y + here.z) / 3.f;
    return 1.f + 0.5f * mean / larger(larger(here.w, mean), 1e-9f);
}

/* The two rows of blocks, of those up to `bottom`, between which a row of pixels lies, and how far from the first. */
inline float between_rows(int y, int bottom, int *top, int *next)
{
    int before;
    const float down = between_blocks(y % SCALE, &before);
    const int row = y / SCALE - before;
    *top = max(row, 0);
    *next = min(row + 1, bottom);
    return down;
}

/* A work-item takes SCALE pixels of a row. The image is rows `first` to `first + rows` of a frame of `height`. */
kernel void give_back(CONST_PLANES(image), CONST_PLANES(removed), CONST_PLANES(bright), int height, int width, int first,
                      int rows, PLANES(out))
{
    const int bx = get_global_id(0), y = get_global_id(1);
    const int last = (width - 1) / SCALE, bottom = (height - 1) / SCALE;
    if (bx > last || y >= rows)
        return;
    int before, top, next;
    const float down = between_rows(first + y, bottom, &top, &next);
    float4 blocks[3]; /* left, own, right */
    for (int i = 0; i < 3; i++) {
        const int x = clamp(bx + i - 1, 0, last);
        blocks[i] = mix(BLOCK_AT(top, x), BLOCK_AT(next, x), down);
    }
#pragma unroll
    for (int i = 0; i < SCALE; i++) {
        const int x = bx * SCALE + i;
        if (x >= width)
            return;
        const float across = between_blocks(i, &before);
        const float4 here = mix(blocks[1 - before], blocks[2 - before], across);
        const float gain = gain_of(here);
        AT(out, 0, y, x) = (AT(image, 0, y, x) + 0.5f * here.x) * gain;
        AT(out, 1, y, x) = (AT(image, 1, y, x) + 0.5f * here.y) * gain;
        AT(out, 2, y, x) = (AT(image, 2, y, x) + 0.5f * here.z) * gain;
    }
}

/* The same for three planes of a layer, of which `own` was removed, with the gain that the colour has. */
#define OWN_AT(y, x) (float3)(AT(own, 0, y, x), AT(own, 1, y, x), AT(own, 2, y, x))
kernel void give_back_also(CONST_PLANES(image), CONST_PLANES(own), CONST_PLANES(removed), CONST_PLANES(bright), int height,
                           int width, int first, int rows, PLANES(out))
{
    const int bx = get_global_id(0), y = get_global_id(1);
    const int last = (width - 1) / SCALE, bottom = (height - 1) / SCALE;
    if (bx > last || y >= rows)
        return;
    int before, top, next;
    const float down = between_rows(first + y, bottom, &top, &next);
    float4 blocks[3];
    float3 owns[3];
    for (int i = 0; i < 3; i++) {
        const int x = clamp(bx + i - 1, 0, last);
        blocks[i] = mix(BLOCK_AT(top, x), BLOCK_AT(next, x), down);
        owns[i] = mix(OWN_AT(top, x), OWN_AT(next, x), down);
    }
#pragma unroll
    for (int i = 0; i < SCALE; i++) {
        const int x = bx * SCALE + i;
        if (x >= width)
            return;
        const float across = between_blocks(i, &before);
        const float3 back = mix(owns[1 - before], owns[2 - before], across);
        const float gain = gain_of(mix(blocks[1 - before], blocks[2 - before], across));
        AT(out, 0, y, x) = (AT(image, 0, y, x) + 0.5f * back.x) * gain;
        AT(out, 1, y, x) = (AT(image, 1, y, x) + 0.5f * back.y) * gain;
        AT(out, 2, y, x) = (AT(image, 2, y, x) + 0.5f * back.z) * gain;
    }
}
