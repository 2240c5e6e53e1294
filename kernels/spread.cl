/* The energy removed from outliers, blurred, goes back: half of it evenly, half in proportion to the brightness.
 *
 * Rarely found light is spread well if many pixels have found some. One that has found more than MOST_LIGHT of all the
 * light around tells little of how much there is, and would be seen as a veil: only so much of it goes back.
 *
 * The blur is wide, so it is made of the means of blocks of SCALE x SCALE pixels, and interpolated between them.
 */
#include "interleave.h"

#if WIDTH > 1
/* The sums of neighbours: of a, then of b. */
inline vec pairs(vec a, vec b)
{
    vec sum;
    sum.lo = a.even + a.odd;
    sum.hi = b.even + b.odd;
    return sum;
}
#endif

/* The mean of each block, of each plane; a work-item takes WIDTH blocks. */
kernel void block_means(CONST_PLANES(in), int height, int width, PLANES(out))
{
    const int bx = get_global_id(0) * WIDTH, by = get_global_id(1), c = get_global_id(2);
    if (bx * SCALE >= width || by * SCALE >= height)
        return;
    const int bottom = min((by + 1) * SCALE, height);
#if SCALE == 4 && WIDTH > 1
    if ((bx + WIDTH) * SCALE <= width) {
        vec sum[SCALE];
        for (int k = 0; k < SCALE; k++)
            sum[k] = (vec)(0.f);
        for (int y = by * SCALE; y < bottom; y++)
            for (int k = 0; k < SCALE; k++)
                sum[k] += VECTOR_AT(in, c, y, bx * SCALE + k * WIDTH);
        const vec total = pairs(pairs(sum[0], sum[1]), pairs(sum[2], sum[3]));
        STORE(total / (SCALE * (bottom - by * SCALE)), out + INDEX(out, c, by, bx));
        return;
    }
#endif
    for (int i = bx; i < bx + WIDTH && i * SCALE < width; i++) {
        const int right = min((i + 1) * SCALE, width);
        float sum = 0.f;
        for (int y = by * SCALE; y < bottom; y++)
            for (int x = i * SCALE; x < right; x++)
                sum += AT(in, c, y, x);
        AT(out, c, by, i) = sum / ((bottom - by * SCALE) * (right - i * SCALE));
    }
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

/* What was removed from each block, as far as its blur makes no more than MOST_LIGHT of the light at its place; and the
 * part of it that this is. level: the light there with `counted` of what was removed, of which the block's own is taken
 * off again. left_down, left_across: what the blur leaves in place, of each row and of each column. */
kernel void limit_removed(CONST_PLANES(level), CONST_PLANES(removed), CONST_PLANES(counted), int down, int across,
                          global const float *restrict left_down, global const float *restrict left_across,
                          PLANES(limited), PLANES(kept))
{
    const int bx = get_global_id(0), by = get_global_id(1);
    if (bx >= across || by >= down)
        return;
    const float in_place = left_down[by] * left_across[bx] / 3.f;
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

/* A plane between two rows of blocks, at blocks bx - 1, bx and bx + 1; the first and the last go on beyond the ends. */
inline void around(CONST_PLANES(of_blocks), int c, int top, int next, float down, int bx, int last, vec out[3])
{
    for (int i = 0; i < 3; i++) {
        const int x = bx + i - 1;
        vec above, below;
        if (x >= 0 && x + WIDTH - 1 <= last) {
            above = VECTOR_AT(of_blocks, c, top, x);
            below = VECTOR_AT(of_blocks, c, next, x);
        } else {
            float lanes[2][WIDTH];
            for (int k = 0; k < WIDTH; k++) {
                lanes[0][k] = AT(of_blocks, c, top, min(max(x + k, 0), last));
                lanes[1][k] = AT(of_blocks, c, next, min(max(x + k, 0), last));
            }
            above = LOAD(lanes[0]);
            below = LOAD(lanes[1]);
        }
        out[i] = above + (below - above) * down;
    }
}

/* Interpolated at the SCALE WIDTH pixels of blocks bx to bx + WIDTH - 1, as they lie in a row. */
inline void at_pixels(CONST_PLANES(of_blocks), int c, int top, int next, float down, int bx, int last, vec out[SCALE])
{
    vec blocks[3], phase[SCALE];
    around(of_blocks, of_blocks_origin, of_blocks_row, of_blocks_plane, c, top, next, down, bx, last, blocks);
#pragma unroll
    for (int i = 0; i < SCALE; i++) {
        int before;
        const float across = between_blocks(i, &before);
        phase[i] = blocks[1 - before] + (blocks[2 - before] - blocks[1 - before]) * across;
    }
#if SCALE == 4 && WIDTH > 1
    vec even[2], odd[2];
    weave(phase[0], phase[2], &even[0], &even[1]);
    weave(phase[1], phase[3], &odd[0], &odd[1]);
    weave(even[0], odd[0], &out[0], &out[1]);
    weave(even[1], odd[1], &out[2], &out[3]);
#else
    for (int i = 0; i < SCALE; i++)
        out[i] = phase[i];
#endif
}
#define AT_PIXELS(p, c, out) at_pixels(p, p##_origin, p##_row, p##_plane, c, top, next, down, bx, last, out)

/* To three planes, which have lost `own`, with the gain that all light together has: at most half as much again, whatever
 * a fit has left of the surroundings. A work-item takes WIDTH blocks of a row. The image is rows `first` to `first + rows`
 * of a frame of `height`. */
kernel void give_back(CONST_PLANES(image), CONST_PLANES(own), CONST_PLANES(removed), CONST_PLANES(bright), int height,
                      int width, int first, int rows, PLANES(out))
{
    const int bx = get_global_id(0) * WIDTH, y = get_global_id(1);
    const int last = (width - 1) / SCALE, bottom = (height - 1) / SCALE;
    if (bx > last || y >= rows)
        return;
    int top, next;
    const float down = between_rows(first + y, bottom, &top, &next);
    vec light[SCALE], mean[SCALE], back[SCALE], gain[SCALE];
    AT_PIXELS(bright, 0, light);
    for (int c = 0; c < 3; c++) {
        AT_PIXELS(removed, c, back);
        for (int i = 0; i < SCALE; i++)
            mean[i] = c == 0 ? back[i] : mean[i] + back[i];
    }
    for (int i = 0; i < SCALE; i++) {
        mean[i] /= 3.f;
        gain[i] = 1.f + 0.5f * mean[i] / larger(larger(light[i], mean[i]), (vec)(1e-9f));
    }
    for (int c = 0; c < 3; c++) {
        AT_PIXELS(own, c, back);
        for (int i = 0; i < SCALE; i++) {
            const int x = bx * SCALE + i * WIDTH;
            STORE((VECTOR_AT(image, c, y, x) + 0.5f * back[i]) * gain[i], out + INDEX(out, c, y, x));
        }
    }
}
