/* Sums over patches by a work-group, through local memory.
 *
 * A group of GROUP_COLUMNS x GROUP_ROWS work-items filters a tile of GROUP_COLUMNS x (GROUP_ROWS * OUTPUTS) pixels,
 * OUTPUTS to a work-item, one below the other. For each offset the group writes one value a pixel of the tile and of
 * the patches' border around it, its points, to local memory. After a barrier each work-item walks down its column:
 * it sums PATCH points along every row, and adds that row to all of its outputs whose patch holds it. So a row is
 * summed once for OUTPUTS patches, and of the separable window only its first half is made more than once.
 *
 * Kernels write the points of one offset while slower work-items still read those of the one before: with two buffers
 * in turn, one barrier an offset is enough.
 *
 * A tile may hang over the image: what it reads below the last patch's border is that border's last row, and columns
 * are readable up to the next whole tile of any device (engine.py).
 */
#ifndef MCDENOISE_GROUP_PATCH_H
#define MCDENOISE_GROUP_PATCH_H
#include "common.h"
#include "inline.h"

#define PATCH (2 * PATCH_RADIUS + 1)
#define TILE_ROWS (GROUP_ROWS * OUTPUTS)
#define SPAN (GROUP_COLUMNS + 2 * PATCH_RADIUS)
#define LINES (TILE_ROWS + 2 * PATCH_RADIUS)
#define POINTS (SPAN * LINES)
#define ITEMS (GROUP_COLUMNS * GROUP_ROWS)
#define SHARE ((POINTS + ITEMS - 1) / ITEMS) /* points that a work-item makes, ITEMS apart */
#define GROUP_KERNEL kernel __attribute__((reqd_work_group_size(GROUP_COLUMNS, GROUP_ROWS, 1)))

/* This work-item's number in its group, and that of the first point it makes. */
INLINE int item_number(void)
{
    return get_local_id(1) * GROUP_COLUMNS + get_local_id(0);
}

/* Where the patch of the work-item's first output begins. */
INLINE local const float *first_point(local const float *points)
{
    return points + get_local_id(1) * (OUTPUTS * SPAN) + get_local_id(0);
}

/* sum[r] = the points of output r's patch, weighted by taps[k] taps[l]. */
INLINE void gaussian_sums(local const float *points, constant float *taps, float sum[OUTPUTS])
{
    local const float *line = first_point(points);
#pragma unroll
    for (int r = 0; r < OUTPUTS; r++)
        sum[r] = 0.f;
    for (int y = 0; y < OUTPUTS + 2 * PATCH_RADIUS; y++, line += SPAN) {
        float across = taps[0] * line[0];
#pragma unroll
        for (int k = 1; k < PATCH; k++)
            across += taps[k] * line[k];
#pragma unroll
        for (int r = 0; r < OUTPUTS; r++)
            if (y >= r && y - r < PATCH)
                sum[r] += taps[y - r] * across;
    }
}

/* sum[r] = the points of output r's patch. */
INLINE void plain_sums(local const float *points, float sum[OUTPUTS])
{
    local const float *line = first_point(points);
#pragma unroll
    for (int r = 0; r < OUTPUTS; r++)
        sum[r] = 0.f;
    for (int y = 0; y < OUTPUTS + 2 * PATCH_RADIUS; y++, line += SPAN) {
        float across = line[0];
#pragma unroll
        for (int k = 1; k < PATCH; k++)
            across += line[k];
#pragma unroll
        for (int r = 0; r < OUTPUTS; r++)
            if (y >= r && y - r < PATCH)
                sum[r] += across;
    }
}

#endif
