/* How far the patches around i and around j = i + offset differ, for a whole tile of pixels i at once.
 *
 * A tile is COLUMNS x ROWS pixels of one work-item, COLUMNS a multiple of WIDTH, with CHANNELS planes to compare. What
 * pixels differ by is found for a row of offsets at once, then summed over the patch by a separable window: along the row,
 * then down the tile. On a CPU the tile is wide and its scratch lies in the first two levels of cache.
 */
#ifndef MCDENOISE_PATCH_H
#define MCDENOISE_PATCH_H
#include "weight.h"

#define VECTORS (COLUMNS / WIDTH)
#define SPAN_VECTORS ((COLUMNS + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH)
#define PATCH_ROWS (ROWS + 2 * PATCH_RADIUS)

/* excess_of_noise for all pixels that a tile's patches need, at `count` offsets along a row, `step` apart: what is loaded
 * of the tile itself serves them all. a points at the tile, b at the same, moved by the first offset; va and vb point
 * likewise into one plane, the sum of the channels' variances. */
inline void excess_of_offsets(global const float *a, global const float *b, int row, int plane, global const float *va,
                              global const float *vb, int v_row, int step, int count,
                              vec excess[][PATCH_ROWS][SPAN_VECTORS])
{
    for (int y = 0; y < PATCH_ROWS; y++)
        for (int v = 0; v < SPAN_VECTORS; v++) {
            const int i = (y - PATCH_RADIUS) * row - PATCH_RADIUS + v * WIDTH;
            const int j = (y - PATCH_RADIUS) * v_row - PATCH_RADIUS + v * WIDTH;
            vec own[CHANNELS];
#pragma unroll
            for (int c = 0; c < CHANNELS; c++)
                own[c] = LOAD(a + i + c * plane);
            const vec here = LOAD(va + j);
            for (int n = 0; n < count; n++) {
                vec squares = (vec)(0.f);
#pragma unroll
                for (int c = 0; c < CHANNELS; c++) {
                    const vec difference = own[c] - LOAD(b + i + n * step + c * plane);
                    squares += difference * difference;
                }
                excess[n][y][v] = excess_of_noise(squares, here, LOAD(vb + j + n * step));
            }
        }
}

/* out[y] = falloff of the mean excess over a patch, for a column of vectors. */
INLINE void falloff_of_column(const vec excess[PATCH_ROWS][SPAN_VECTORS], int v, vec out[ROWS])
{
    vec across[PATCH];
#pragma unroll
    for (int y = 0; y < PATCH_ROWS; y++) {
        const float *line = (const float *)excess[y] + v * WIDTH;
        across[y % PATCH] = LOAD(line);
#pragma unroll
        for (int k = 1; k < PATCH; k++)
            across[y % PATCH] += LOAD(line + k);
        if (y >= 2 * PATCH_RADIUS) {
            vec sum = across[0];
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += across[k];
            out[y - 2 * PATCH_RADIUS] = falloff(sum, -0.25f / (PATCH * PATCH));
        }
    }
}

/* out[y] = weight_of_sums, for a column of vectors. */
INLINE void weights_of_column(const vec excess[PATCH_ROWS][SPAN_VECTORS], int v, float scale, vec out[ROWS])
{
    vec across[PATCH], inner[PATCH];
#pragma unroll
    for (int y = 0; y < PATCH_ROWS; y++) {
        const float *line = (const float *)excess[y] + v * WIDTH;
        vec narrow = LOAD(line + PATCH_RADIUS);
#pragma unroll
        for (int k = 1; k <= INNER_RADIUS; k++)
            narrow += LOAD(line + PATCH_RADIUS - k) + LOAD(line + PATCH_RADIUS + k);
        vec wide = narrow;
#pragma unroll
        for (int k = INNER_RADIUS + 1; k <= PATCH_RADIUS; k++)
            wide += LOAD(line + PATCH_RADIUS - k) + LOAD(line + PATCH_RADIUS + k);
        across[y % PATCH] = wide;
        inner[y % PATCH] = narrow;
        if (y >= 2 * PATCH_RADIUS) {
            vec sum = across[0], inner_sum = inner[(y - PATCH_RADIUS + PATCH) % PATCH];
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += across[k];
#pragma unroll
            for (int k = 1; k <= INNER_RADIUS; k++)
                inner_sum += inner[(y - PATCH_RADIUS - k) % PATCH] + inner[(y - PATCH_RADIUS + k) % PATCH];
            out[y - 2 * PATCH_RADIUS] = weight_of_sums(sum, inner_sum, scale);
        }
    }
}

#endif
