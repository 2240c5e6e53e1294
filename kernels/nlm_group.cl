/* Non-local means as in nlm.cl (Yang 2022, eqs. 4-6; WITH_SSIM, eq. 8), for GPUs: a work-group filters a tile, with the
 * scheme of group_patch.h.
 *
 * The points of an offset are the squared differences of `tone`. A work-item makes the same points of every offset, so
 * their own side of the difference stays in registers; the other side is read from global memory, coalesced and mostly
 * from the cache, or, with COPY_RADIUS, from a copy of the tile and of the search window's border in local memory.
 * WITH_SSIM, three more sets of points follow through the same two buffers, the squared differences of the normals in
 * each channel: the variances of x - y over the patches come from them (as mean(e^2) - mean(e)^2, whose rounding is
 * below 1e-4 of SSIM's C2 for values in [0, 1]), all else of SSIM from the patch statistics.
 *
 * Cost with 5x5 patches and groups of 32 x 8, registers as built for NVIDIA's sm_75:
 *                                        without SSIM, OUTPUTS = 4     with SSIM, OUTPUTS = 2
 *   tile, points                         32 x 32, 36 x 36              32 x 16, 36 x 20
 *   local memory (8 POINTS bytes)        10.1 KiB                      5.6 KiB
 *     and a copy for 7x7 offsets         20.7 KiB                      12.8 KiB
 *   registers                            96                            80; 168 if OUTPUTS = 4
 *   a pixel and offset: global loads     6.8                           28
 *     local loads, stores                10, 1.3                       60, 5.6
 *     operations                         52, an exp                    170, an exp, a log, three divisions
 */
#include "group_patch.h"
#include "similarity.h"

#ifdef COPY_RADIUS
#define COPY_SPAN (SPAN + 2 * COPY_RADIUS)
#define COPY_POINTS (COPY_SPAN * (LINES + 2 * COPY_RADIUS))
#define TONE_AT(line, column) (((line) + COPY_RADIUS) * COPY_SPAN + (column) + COPY_RADIUS)
#define TONE(c) copy[c]
#define TONE_ROW COPY_SPAN
#else
#define TONE_AT(line, column) INDEX(tone, 0, top + (line), left + (column))
#define TONE(c) (tone + (c) * tone_plane)
#define TONE_ROW tone_row
#endif

GROUP_KERNEL void nlm_group(CONST_PLANES(tone), CONST_PLANES(color), int height, int width, int search_radius,
                            constant float *gaussian, global const float *restrict noise_level, float h_factor,
                            int center,
#ifdef WITH_SSIM
                            CONST_PLANES(unit), CONST_PLANES(stats), float c1, float c2, float stabiliser,
#endif
                            PLANES(out))
{
    local float buffers[2][POINTS];
    const int item = item_number();
    const int x = get_global_id(0), y = get_global_id(1) * OUTPUTS;
    /* The first point's pixel, and the last line of points that any patch of the image needs. */
    const int left = get_group_id(0) * GROUP_COLUMNS - PATCH_RADIUS, top = get_group_id(1) * TILE_ROWS - PATCH_RADIUS;
    const int last = height - 1 + PATCH_RADIUS - top;
    const float scale = exponent_scale(h_factor, noise_level[0]);

#ifdef COPY_RADIUS
    local float copy[3][COPY_POINTS];
    for (int n = item; n < COPY_POINTS; n += ITEMS) {
        const int line = min(n / COPY_SPAN - COPY_RADIUS, last + COPY_RADIUS);
        const int column = n % COPY_SPAN - COPY_RADIUS;
        for (int c = 0; c < 3; c++)
            copy[c][n] = AT(tone, c, top + line, left + column);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
#endif
    /* Where this work-item's points are, kept because to work it out anew takes more registers. */
    int at[SHARE];
#ifdef WITH_SSIM
    int unit_at[SHARE];
#endif
    float own[SHARE][3];
#pragma unroll
    for (int k = 0; k < SHARE; k++) {
        const int n = item + k * ITEMS;
        at[k] = TONE_AT(min(n / SPAN, last), n % SPAN);
#ifdef WITH_SSIM
        unit_at[k] = INDEX(unit, 0, top + min(n / SPAN, last), left + n % SPAN);
#endif
        if (n < POINTS)
#pragma unroll
            for (int c = 0; c < 3; c++)
                own[k][c] = TONE(c)[at[k]];
    }
    float total[OUTPUTS], most[OUTPUTS], sum[OUTPUTS][3], here[OUTPUTS][3];
#pragma unroll
    for (int r = 0; r < OUTPUTS; r++) {
        total[r] = most[r] = 0.f;
#pragma unroll
        for (int c = 0; c < 3; c++) {
            sum[r][c] = 0.f;
            here[r][c] = AT(color, c, min(y + r, height - 1), x);
        }
    }

    const int side = 2 * search_radius + 1, middle = side * side / 2;
    int turn = 0;
    for (int offset = 0; offset < side * side - 1; offset++) {
        const int moved = offset + (offset >= middle); /* not the pixel itself */
        const int dy = moved / side - search_radius, dx = moved % side - search_radius;
        const int move = dy * TONE_ROW + dx;
        local float *points = buffers[turn];
        turn ^= 1;
#pragma unroll
        for (int k = 0; k < SHARE; k++) {
            const int n = item + k * ITEMS;
            if (n < POINTS) {
                float squares = 0.f;
#pragma unroll
                for (int c = 0; c < 3; c++) {
                    const float difference = own[k][c] - TONE(c)[at[k] + move];
                    squares += difference * difference;
                }
                points[n] = squares;
            }
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        float distance[OUTPUTS];
        gaussian_sums(points, gaussian, distance);

#ifdef WITH_SSIM
        const int unit_move = dy * unit_row + dx;
        float ssim[OUTPUTS];
#pragma unroll
        for (int r = 0; r < OUTPUTS; r++)
            ssim[r] = 0.f;
        /* Not unrolled: three channels at once would take twice the registers. */
#pragma unroll 1
        for (int c = 0; c < 3; c++) {
            points = buffers[turn];
            turn ^= 1;
#pragma unroll
            for (int k = 0; k < SHARE; k++) {
                const int n = item + k * ITEMS;
                if (n < POINTS) {
                    const int i = unit_at[k] + c * unit_plane;
                    const float difference = unit[i] - unit[i + unit_move];
                    points[n] = difference * difference;
                }
            }
            barrier(CLK_LOCAL_MEM_FENCE);
            float squares[OUTPUTS];
            plain_sums(points, squares);
#pragma unroll
            for (int r = 0; r < OUTPUTS; r++) {
                const int row = min(y + r, height - 1);
                const float mean_x = AT(stats, STAT(c, MEAN), row, x);
                const float mean_y = AT(stats, STAT(c, MEAN), row + dy, x + dx), step = mean_x - mean_y;
                const float spread = fmax(squares[r] * (1.f / (PATCH * PATCH)) - step * step, 0.f);
                ssim[r] += dissimilarity(mean_x, mean_y, AT(stats, STAT(c, VARIANCE), row, x),
                                         AT(stats, STAT(c, VARIANCE), row + dy, x + dx), spread, c1, c2);
            }
        }
#endif
#pragma unroll
        for (int r = 0; r < OUTPUTS; r++) {
            float exponent = scale * distance[r];
#ifdef WITH_SSIM
            exponent *= stabiliser - log(ssim_of_channels(ssim[r]));
#endif
            const float weight = exp(exponent);
            total[r] += weight;
            most[r] = fmax(most[r], weight);
            const int row = min(y + r, height - 1) + dy;
#pragma unroll
            for (int c = 0; c < 3; c++)
                sum[r][c] += weight * (AT(color, c, row, x + dx) - here[r][c]);
        }
    }
#pragma unroll
    for (int r = 0; r < OUTPUTS; r++) {
        const float norm = total[r] + center_weight(center, most[r]);
        if (x < width && y + r < height)
#pragma unroll
            for (int c = 0; c < 3; c++)
                AT(out, c, y + r, x) = here[r][c] + sum[r][c] / norm;
    }
}
