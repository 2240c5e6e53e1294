/* SSIM between patches of the prefiltered normals (Yang 2022, eq. 7; Wang et al. 2004). */
#include "pairs.h"

/* Of the patch around each pixel and channel: mean, and variance about the mean. `in` has a mirrored border of at least
 * the patch radius. */
kernel void patch_statistics(CONST_PLANES(in), int height, int width, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    vec sum = (vec)(0.f);
    for (int v = -PATCH_RADIUS; v <= PATCH_RADIUS; v++)
        for (int u = -PATCH_RADIUS; u <= PATCH_RADIUS; u++)
            sum += VECTOR_AT(in, c, y + v, x + u);
    const vec mean = sum / (PATCH * PATCH);
    vec squares = (vec)(0.f);
    for (int v = -PATCH_RADIUS; v <= PATCH_RADIUS; v++)
        for (int u = -PATCH_RADIUS; u <= PATCH_RADIUS; u++) {
            const vec d = VECTOR_AT(in, c, y + v, x + u) - mean;
            squares += d * d;
        }
    STORE(mean, out + INDEX(out, STAT(c, MEAN), y, x));
    STORE(squares / (PATCH * PATCH), out + INDEX(out, STAT(c, VARIANCE), y, x));
}

/* The map for one offset: SSIM(patch around i, patch around i + offset). `unit` and `stats` have mirrored borders
 * of at least the offset plus the patch radius. Not on the way from door to exit: there the weights of nlm.cl use
 * the same function tile by tile. */
kernel void patch_ssim(CONST_PLANES(unit), CONST_PLANES(stats), int height, int width, int dx, int dy,
                       float c1, float c2, PLANES(out))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    vec ssim[REGION_ROWS][REGION_VECTORS];
    const int move = dy * unit_row + dx, stats_move = dy * stats_row + dx;
    global const float *here = unit + INDEX(unit, 0, y, x);
    global const float *stats_here = stats + INDEX(stats, 0, y, x);
    patch_ssim_region(here, here + move, unit_row, unit_plane, stats_here, stats_here + stats_move, stats_row, stats_plane,
                      c1, c2, region_of(ROWS, COLUMNS), ssim);
    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int v = 0; v < VECTORS; v++) {
            float line[WIDTH];
            STORE(ssim[r][v], line);
            for (int i = 0; i < WIDTH && x + v * WIDTH + i < width; i++)
                AT(out, 0, y + r, x + v * WIDTH + i) = line[i];
        }
}
