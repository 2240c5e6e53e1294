/* Distances between the patches around i and around j = i + offset, for a whole tile of pixels i at once.
 *
 * A tile is COLUMNS x ROWS pixels of one work-item, COLUMNS a multiple of WIDTH. Squared differences are summed
 * over the patch by a separable window: along the row as they are made, then down the tile. On a CPU the tile is
 * wide and its scratch lies in the first-level cache; with COLUMNS = ROWS = WIDTH = 1 the same code is the plain
 * one-pixel-a-work-item kernel.
 */
#ifndef MCDENOISE_PATCH_H
#define MCDENOISE_PATCH_H
#include "common.h"

#define PATCH (2 * PATCH_RADIUS + 1)
#define VECTORS (COLUMNS / WIDTH)
#define SPAN_VECTORS ((COLUMNS + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH)

/* out[y][v] = sum over k, l of taps[k] taps[l] * sum over `channels` of (a - b)^2 at (y + k, x + l), where a
 * points at the tile's first pixel in the first plane and b at the same, moved by the offset. */
inline void patch_sum(global const float *a, global const float *b, int row, int plane, int channels,
                      constant float *taps, vec out[ROWS][VECTORS])
{
    vec across[ROWS + 2 * PATCH_RADIUS][VECTORS];
    for (int y = 0; y < ROWS + 2 * PATCH_RADIUS; y++) {
        float square[SPAN_VECTORS * WIDTH];
        const int start = (y - PATCH_RADIUS) * row - PATCH_RADIUS;
        for (int v = 0; v < SPAN_VECTORS; v++) {
            vec sum = (vec)(0.f);
            for (int c = 0; c < channels; c++) {
                const int i = start + v * WIDTH + c * plane;
                const vec difference = LOAD(a + i) - LOAD(b + i);
                sum += difference * difference;
            }
            STORE(sum, square + v * WIDTH);
        }
        for (int v = 0; v < VECTORS; v++) {
            vec sum = taps[0] * LOAD(square + v * WIDTH);
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += taps[k] * LOAD(square + v * WIDTH + k);
            across[y][v] = sum;
        }
    }
    for (int y = 0; y < ROWS; y++)
        for (int v = 0; v < VECTORS; v++) {
            vec sum = taps[0] * across[y][v];
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += taps[k] * across[y + k][v];
            out[y][v] = sum;
        }
}

/* 1 - SSIM of two patches of one channel (Wang et al. 2004; Yang 2022, eq. 7, with C3 = C2 / 2), from the means,
 * the variances and the mean squared difference of the patches:
 *   luminance = 1 - (mu_x - mu_y)^2 / (mu_x^2 + mu_y^2 + C1)
 *   contrast * structure = 1 - var(x - y) / (var_x + var_y + C2)
 * Differences first: equal patches give exactly 0, where the textbook form leaves rounding noise for the
 * logarithm of eq. 8 to magnify.
 */
inline vec dissimilarity(vec mean_x, vec mean_y, vec variance_x, vec variance_y, vec mean_square, float c1, float c2)
{
    const vec step = mean_x - mean_y;
    const vec step2 = step * step;
    const vec spread = fmax(mean_square - step2, (vec)(0.f));
    const vec luminance_scale = mean_x * mean_x + mean_y * mean_y + c1;
    const vec structure_scale = variance_x + variance_y + c2;
    return (step2 * (structure_scale - spread) + spread * luminance_scale) / (luminance_scale * structure_scale);
}

/* SSIM of three channels: the mean over them, kept away from 0 so that eq. 8's logarithm stays finite. */
#define LEAST_SSIM 1e-6f

/* dissimilar[y][v] = 1 - SSIM; x_ and y_ point at the tile's first pixel and at the same, moved by the offset,
 * in the normals and in their patch statistics (three means, then three variances). */
inline void patch_dissimilarity(global const float *x, global const float *y, int row, int plane,
                                global const float *stats_x, global const float *stats_y, int stats_row,
                                int stats_plane, constant float *uniform, float c1, float c2,
                                vec dissimilar[ROWS][VECTORS])
{
    vec mean_square[ROWS][VECTORS];
    for (int r = 0; r < ROWS; r++)
        for (int v = 0; v < VECTORS; v++)
            dissimilar[r][v] = (vec)(0.f);
    for (int c = 0; c < 3; c++) {
        patch_sum(x + c * plane, y + c * plane, row, plane, 1, uniform, mean_square);
        for (int r = 0; r < ROWS; r++)
            for (int v = 0; v < VECTORS; v++) {
                const int i = r * stats_row + v * WIDTH + c * stats_plane, j = i + 3 * stats_plane;
                dissimilar[r][v] += dissimilarity(LOAD(stats_x + i), LOAD(stats_y + i), LOAD(stats_x + j),
                                                  LOAD(stats_y + j), mean_square[r][v], c1, c2);
            }
    }
    for (int r = 0; r < ROWS; r++)
        for (int v = 0; v < VECTORS; v++)
            dissimilar[r][v] = clamp(dissimilar[r][v] * (1.f / 3.f), (vec)(0.f), (vec)(1.f - LEAST_SSIM));
}

#endif
