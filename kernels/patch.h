/* Distances between the patches around i and around j = i + offset, for a whole tile of pixels i at once.
 *
 * A tile is COLUMNS x ROWS pixels of one work-item, COLUMNS a multiple of WIDTH. Squared differences are summed
 * over the patch by a separable window: along the row as they are made, then down the tile. On a CPU the tile is
 * wide and its scratch lies in the first-level cache; with COLUMNS = ROWS = WIDTH = 1 the same code is the plain
 * one-pixel-a-work-item kernel.
 */
#ifndef MCDENOISE_PATCH_H
#define MCDENOISE_PATCH_H
#include "weight.h"

#define VECTORS (COLUMNS / WIDTH)
#define SPAN_VECTORS ((COLUMNS + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH)

/* excess_of_noise for the row of pixels that line y of a tile's patches needs. a and b as above; va and vb point likewise
 * into one plane, the sum of the channels' variances. */
inline void excess_row(global const float *a, global const float *b, int row, int plane, global const float *va,
                       global const float *vb, int v_row, int channels, int y, float excess[SPAN_VECTORS * WIDTH])
{
    const int start = (y - PATCH_RADIUS) * row - PATCH_RADIUS, v_start = (y - PATCH_RADIUS) * v_row - PATCH_RADIUS;
    for (int v = 0; v < SPAN_VECTORS; v++) {
        vec sum = (vec)(0.f);
        for (int c = 0; c < channels; c++) {
            const int i = start + v * WIDTH + c * plane;
            const vec difference = LOAD(a + i) - LOAD(b + i);
            sum += difference * difference;
        }
        const vec here = LOAD(va + v_start + v * WIDTH), there = LOAD(vb + v_start + v * WIDTH);
        STORE(excess_of_noise(sum, here, there), excess + v * WIDTH);
    }
}

/* Sums over a patch, along a row and down a column. */
inline vec sum_along(const float *values, int v)
{
    vec sum = LOAD(values + v * WIDTH);
#pragma unroll
    for (int k = 1; k < PATCH; k++)
        sum += LOAD(values + v * WIDTH + k);
    return sum;
}

inline vec sum_down(const vec across[ROWS + 2 * PATCH_RADIUS][VECTORS], int y, int v)
{
    vec sum = across[y][v];
#pragma unroll
    for (int k = 1; k < PATCH; k++)
        sum += across[y + k][v];
    return sum;
}

/* out[y][v] = excess_row's differences, mean over the patch, at least 0. */
inline void patch_variance_distance(global const float *a, global const float *b, int row, int plane,
                                    global const float *va, global const float *vb, int v_row, int channels,
                                    vec out[ROWS][VECTORS])
{
    vec across[ROWS + 2 * PATCH_RADIUS][VECTORS];
    float excess[SPAN_VECTORS * WIDTH];
    for (int y = 0; y < ROWS + 2 * PATCH_RADIUS; y++) {
        excess_row(a, b, row, plane, va, vb, v_row, channels, y, excess);
        for (int v = 0; v < VECTORS; v++)
            across[y][v] = sum_along(excess, v);
    }
    const float norm = 1.f / (PATCH * PATCH);
    for (int y = 0; y < ROWS; y++)
        for (int v = 0; v < VECTORS; v++)
            out[y][v] = larger(norm * sum_down(across, y, v), (vec)(0.f));
}

/* excess_of_noise of three channels for all pixels that a tile's patches need, at `count` offsets along a row, `step`
 * apart: what is loaded of the tile itself serves them all. b and vb point at the first. */
inline void excess_of_offsets(global const float *a, global const float *b, int row, int plane, global const float *va,
                              global const float *vb, int v_row, int step, int count,
                              vec excess[][ROWS + 2 * PATCH_RADIUS][SPAN_VECTORS])
{
    for (int y = 0; y < ROWS + 2 * PATCH_RADIUS; y++)
        for (int v = 0; v < SPAN_VECTORS; v++) {
            const int i = (y - PATCH_RADIUS) * row - PATCH_RADIUS + v * WIDTH;
            const int j = (y - PATCH_RADIUS) * v_row - PATCH_RADIUS + v * WIDTH;
            const vec red = LOAD(a + i), green = LOAD(a + i + plane), blue = LOAD(a + i + 2 * plane), here = LOAD(va + j);
            for (int n = 0; n < count; n++) {
                global const float *other = b + i + n * step;
                const vec r = red - LOAD(other), g = green - LOAD(other + plane), u = blue - LOAD(other + 2 * plane);
                excess[n][y][v] = excess_of_noise(r * r + g * g + u * u, here, LOAD(vb + j + n * step));
            }
        }
}

/* out[y] = weight_of_sums, for a column of vectors. */
INLINE void weights_of_column(const vec excess[ROWS + 2 * PATCH_RADIUS][SPAN_VECTORS], int v, float scale, vec out[ROWS])
{
    vec across[PATCH], inner[PATCH];
#pragma unroll
    for (int y = 0; y < ROWS + 2 * PATCH_RADIUS; y++) {
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
