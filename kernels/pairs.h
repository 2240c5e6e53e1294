/* How alike the patches around i and around j = i + offset are, each pair compared once: the weight of j in i's mean is
 * that of i in j's. A tile of COLUMNS x ROWS pixels i needs the weights of i + offset and of i - offset; the latter are
 * those of the same offset, further up or to the left. So a region is compared that is larger than the tile by the
 * offset, up to SHARED rows and columns.
 *
 * What differs between the patches is summed by a separable window, along the rows as it is made, then down the columns;
 * the scratch between lies in the first two levels of cache.
 */
#ifndef MCDENOISE_PAIRS_H
#define MCDENOISE_PAIRS_H
#include "similarity.h"

#define PATCH (2 * PATCH_RADIUS + 1)
#define VECTORS (COLUMNS / WIDTH)
#define REGION_ROWS (ROWS + SHARED)
#define REGION_VECTORS ((COLUMNS + SHARED + WIDTH - 1) / WIDTH)
#define REGION_SPAN ((REGION_VECTORS * WIDTH + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH * WIDTH)

/* Rows, vectors to a row, and vectors that their patches need: what lies beyond the image's memory is not read. */
typedef struct {
    int rows, vectors, reads;
} region;

/* No function: a struct that one returns leaves marks of LLVM where it is inlined, at which oclgrind 21.10 stops. */
#define REGION(rows, columns)                                                                                          \
    {(rows), ((columns) + WIDTH - 1) / WIDTH, ((columns) + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH}

/* across[y][v] = sum over k of taps[k] * sum over `channels` of (a - b)^2 at (y, x + k), for the region and what its
 * patches need above and below. a points at the region's first pixel in the first plane, b at the same, moved by the
 * offset. Without taps all are 1. */
INLINE void sum_across(global const float *a, global const float *b, int row, int plane, int channels,
                       constant float *taps, region area, vec across[REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS])
{
    float line[REGION_SPAN];
    for (int v = area.reads; v * WIDTH < REGION_SPAN; v++) /* the last vector of a region may need what was not read */
        STORE((vec)(0.f), line + v * WIDTH);
    for (int y = 0; y < area.rows + 2 * PATCH_RADIUS; y++) {
        const int start = (y - PATCH_RADIUS) * row - PATCH_RADIUS;
        for (int v = 0; v < area.reads; v++) {
            vec sum = (vec)(0.f);
            for (int c = 0; c < channels; c++) {
                const int i = start + v * WIDTH + c * plane;
                const vec difference = LOAD(a + i) - LOAD(b + i);
                sum += difference * difference;
            }
            STORE(sum, line + v * WIDTH);
        }
        for (int v = 0; v < area.vectors; v++) {
            vec sum = taps ? taps[0] * LOAD(line + v * WIDTH) : LOAD(line + v * WIDTH);
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += taps ? taps[k] * LOAD(line + v * WIDTH + k) : LOAD(line + v * WIDTH + k);
            across[y][v] = sum;
        }
    }
}

/* The same down a column. */
INLINE vec sum_down(vec across[REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS], int y, int v, constant float *taps)
{
    vec sum = taps ? taps[0] * across[y][v] : across[y][v];
#pragma unroll
    for (int k = 1; k < PATCH; k++)
        sum += taps ? taps[k] * across[y + k][v] : across[y + k][v];
    return sum;
}

/* SSIM of the patches around WIDTH pixels, of the normals x and y. squares: sums of (x - y)^2 over the patches, for each
 * channel; stats_x and stats_y point at the pixels in the first plane of the statistics.
 *
 * Of a channel, the variance of x - y over the patch is mean(e^2) - mean(e)^2, whose rounding is below 1e-4 of SSIM's C2
 * for values in [0, 1]; the mean is known before. */
INLINE vec ssim_of(const vec squares[3], global const float *stats_x, global const float *stats_y, int plane, float c1,
                   float c2)
{
    vec sum = (vec)(0.f);
#pragma unroll
    for (int c = 0; c < 3; c++) {
        const vec mean_x = LOAD(stats_x + STAT(c, MEAN) * plane), mean_y = LOAD(stats_y + STAT(c, MEAN) * plane);
        const vec step = mean_x - mean_y;
        const vec spread = larger(squares[c] * (1.f / (PATCH * PATCH)) - step * step, (vec)(0.f));
        sum += dissimilarity(mean_x, mean_y, LOAD(stats_x + STAT(c, VARIANCE) * plane),
                             LOAD(stats_y + STAT(c, VARIANCE) * plane), spread, c1, c2);
    }
    return ssim_of_channels(sum);
}

#endif
