/* How alike the patches around i and around j = i + offset are, each pair compared once: the weight of j in i's mean is
 * that of i in j's. A tile of COLUMNS x ROWS pixels i (patch.h) needs the weights of i + offset and of i - offset; the
 * latter are those of the same offset, further up or to the left. So a region is compared that is larger than the tile
 * by the offset, up to SHARED rows and columns.
 */
#ifndef MCDENOISE_PAIRS_H
#define MCDENOISE_PAIRS_H
#include "patch.h"
#include "similarity.h"

#define REGION_ROWS (ROWS + SHARED)
#define REGION_VECTORS ((COLUMNS + SHARED + WIDTH - 1) / WIDTH)
#define REGION_SPAN ((REGION_VECTORS * WIDTH + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH * WIDTH)

/* Rows, vectors to a row, and vectors that their patches need: what lies beyond the image's memory is not read. */
typedef struct {
    int rows, vectors, reads;
} region;

INLINE region region_of(int rows, int columns)
{
    region area;
    area.rows = rows;
    area.vectors = (columns + WIDTH - 1) / WIDTH;
    area.reads = (columns + 2 * PATCH_RADIUS + WIDTH - 1) / WIDTH;
    return area;
}

/* line[x] = sum over `channels` of (a - b)^2 at x. The last vector of a region may need what was not read. */
INLINE void square_line(global const float *a, global const float *b, int plane, int channels, region area,
                        float line[REGION_SPAN])
{
    for (int v = 0; v < area.reads; v++) {
        vec sum = (vec)(0.f);
        for (int c = 0; c < channels; c++) {
            const vec difference = LOAD(a + v * WIDTH + c * plane) - LOAD(b + v * WIDTH + c * plane);
            sum += difference * difference;
        }
        STORE(sum, line + v * WIDTH);
    }
    for (int v = area.reads; v * WIDTH < REGION_SPAN; v++)
        STORE((vec)(0.f), line + v * WIDTH);
}

/* out[y][v] = sum over k, l of taps[k] taps[l] * sum over `channels` of (a - b)^2 at (y + k, x + l), where a points at
 * the region's first pixel in the first plane and b at the same, moved by the offset. */
INLINE void patch_sum(global const float *a, global const float *b, int row, int plane, int channels,
                      constant float *taps, region area, vec out[REGION_ROWS][REGION_VECTORS])
{
    vec across[REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS];
    float line[REGION_SPAN];
    for (int y = 0; y < area.rows + 2 * PATCH_RADIUS; y++) {
        const int start = (y - PATCH_RADIUS) * row - PATCH_RADIUS;
        square_line(a + start, b + start, plane, channels, area, line);
        for (int v = 0; v < area.vectors; v++) {
            vec sum = taps[0] * LOAD(line + v * WIDTH);
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += taps[k] * LOAD(line + v * WIDTH + k);
            across[y][v] = sum;
        }
    }
    for (int y = 0; y < area.rows; y++)
        for (int v = 0; v < area.vectors; v++) {
            vec sum = taps[0] * across[y][v];
#pragma unroll
            for (int k = 1; k < PATCH; k++)
                sum += taps[k] * across[y + k][v];
            out[y][v] = sum;
        }
}

/* ssim[y][v] = ssim_of_channels; x and y point at the region's first pixel and at the same, moved by the offset, in the
 * normals; stats_x and stats_y likewise in their statistics.
 *
 * Of a channel, the variance of x - y over the patch is mean(e^2) - mean(e)^2, whose rounding is below 1e-4 of SSIM's C2
 * for values in [0, 1]; the mean is known before. */
INLINE void patch_ssim_region(global const float *x, global const float *y, int row, int plane,
                              global const float *stats_x, global const float *stats_y, int stats_row, int stats_plane,
                              float c1, float c2, region area, vec ssim[REGION_ROWS][REGION_VECTORS])
{
    vec across[REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS];
    float line[REGION_SPAN];
    for (int c = 0; c < 3; c++) {
        for (int r = 0; r < area.rows + 2 * PATCH_RADIUS; r++) {
            const int start = (r - PATCH_RADIUS) * row - PATCH_RADIUS + c * plane;
            square_line(x + start, y + start, plane, 1, area, line);
            for (int v = 0; v < area.vectors; v++)
                across[r][v] = sum_along(line, v);
        }
        for (int r = 0; r < area.rows; r++)
            for (int v = 0; v < area.vectors; v++) {
                const int i = r * stats_row + v * WIDTH + STAT(c, MEAN) * stats_plane;
                const int j = r * stats_row + v * WIDTH + STAT(c, VARIANCE) * stats_plane;
                const vec mean_x = LOAD(stats_x + i), mean_y = LOAD(stats_y + i), mean = mean_x - mean_y;
                vec squares = across[r][v];
#pragma unroll
                for (int k = 1; k < PATCH; k++)
                    squares += across[r + k][v];
                const vec spread = fmax(squares * (1.f / (PATCH * PATCH)) - mean * mean, (vec)(0.f));
                const vec part = dissimilarity(mean_x, mean_y, LOAD(stats_x + j), LOAD(stats_y + j), spread, c1, c2);
                const vec sum = c == 0 ? part : ssim[r][v] + part;
                ssim[r][v] = c == 2 ? ssim_of_channels(sum) : sum;
            }
    }
}

#endif
