/* Features before regression, as in prefilter.cl (Rousselle et al. 2013), for GPUs: a work-group filters a tile, with
 * the scheme of group_patch.h.
 *
 * The points of an offset are how far two pixels differ beyond what their noise explains. A work-item makes the same
 * points of every offset, so their own side of the comparison stays in registers.
 *
 * Cost with 3x3 patches, groups of 32 x 8 and two outputs (tiles of 32 x 16 pixels, 34 x 18 points), C channels:
 *   local memory          8 POINTS bytes, 4.8 KiB
 *   a pixel and offset    1.2 (C + 1) + 2 C global loads, 6 local loads, 1.2 local stores;
 *                         20 + 10 C operations and 1.2 divisions
 * With four outputs it would be 4.5 local loads, but 128 registers instead of 64 (C = 3, built for NVIDIA's sm_75).
 */
#include "group_patch.h"
#include "weight.h"
#include "window.h"

/* feature and variance: CHANNELS planes, noise: the sum of the variances; mirrored borders of at least search radius +
 * patch radius */
GROUP_KERNEL void prefilter_group(CONST_PLANES(feature), CONST_PLANES(variance), CONST_PLANES(noise), int height,
                                  int width, int search_radius, PLANES(out), PLANES(out_variance))
{
    local float buffers[2][POINTS];
    const int item = item_number();
    const int x = get_global_id(0), y = get_global_id(1) * OUTPUTS;
    /* The first point's pixel, and the last row that any patch of the image needs. */
    const int left = get_group_id(0) * GROUP_COLUMNS - PATCH_RADIUS, top = get_group_id(1) * TILE_ROWS - PATCH_RADIUS;
    const int last = height - 1 + PATCH_RADIUS;

    float own[SHARE][CHANNELS], own_noise[SHARE];
#pragma unroll
    for (int k = 0; k < SHARE; k++) {
        const int n = item + k * ITEMS, row = min(top + n / SPAN, last), column = left + n % SPAN;
        if (n < POINTS) {
            own_noise[k] = AT(noise, 0, row, column);
#pragma unroll
            for (int c = 0; c < CHANNELS; c++)
                own[k][c] = AT(feature, c, row, column);
        }
    }
    /* A pixel's distance from itself is 0 and its weight 1. */
    float total[OUTPUTS], here[OUTPUTS][CHANNELS], sum[OUTPUTS][CHANNELS], spread[OUTPUTS][CHANNELS];
#pragma unroll
    for (int r = 0; r < OUTPUTS; r++) {
        total[r] = 1.f;
#pragma unroll
        for (int c = 0; c < CHANNELS; c++) {
            here[r][c] = AT(feature, c, min(y + r, height - 1), x);
            sum[r][c] = 0.f;
            spread[r][c] = AT(variance, c, min(y + r, height - 1), x);
        }
    }

    const int side = 2 * search_radius + 1, middle = side * side / 2;
    int turn = 0;
    for (int offset = 0; offset < side * side - 1; offset++) {
        const int moved = offset + (offset >= middle);
        const int dy = moved / side - search_radius, dx = moved % side - search_radius;
        if (!IN_WINDOW(dx, dy, search_radius)) /* the same for the whole group, so that barriers stay in step */
            continue;
        local float *points = buffers[turn];
        turn ^= 1;
#pragma unroll
        for (int k = 0; k < SHARE; k++) {
            const int n = item + k * ITEMS, row = min(top + n / SPAN, last) + dy, column = left + n % SPAN + dx;
            if (n < POINTS) {
                float squares = 0.f;
#pragma unroll
                for (int c = 0; c < CHANNELS; c++) {
                    const float difference = own[k][c] - AT(feature, c, row, column);
                    squares += difference * difference;
                }
                points[n] = excess_of_noise(squares, own_noise[k], AT(noise, 0, row, column));
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        float excess[OUTPUTS];
        plain_sums(points, excess);
#pragma unroll
        for (int r = 0; r < OUTPUTS; r++) {
            const float distance = fmax(excess[r] * (1.f / (PATCH * PATCH)), 0.f);
            const float weight = falloff(distance, -0.25f);
            const int row = min(y + r, height - 1) + dy;
            total[r] += weight;
#pragma unroll
            for (int c = 0; c < CHANNELS; c++) {
                sum[r][c] += weight * (AT(feature, c, row, x + dx) - here[r][c]);
                spread[r][c] += weight * weight * AT(variance, c, row, x + dx);
            }
        }
    }
#pragma unroll
    for (int r = 0; r < OUTPUTS; r++)
        if (x < width && y + r < height)
#pragma unroll
            for (int c = 0; c < CHANNELS; c++) {
                AT(out, c, y + r, x) = here[r][c] + sum[r][c] / total[r];
                AT(out_variance, c, y + r, x) = spread[r][c] / (total[r] * total[r]);
            }
}
