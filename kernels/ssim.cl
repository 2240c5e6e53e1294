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
    const int move = dy * unit_row + dx, stats_move = dy * stats_row + dx;
    vec across[3][REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS];
    const region area = REGION(ROWS, COLUMNS);
    for (int c = 0; c < 3; c++) {
        global const float *here = unit + INDEX(unit, c, y, x);
        sum_across(here, here + move, unit_row, 0, 1, 0, area, across[c]);
    }
    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int v = 0; v < VECTORS; v++) {
            float line[WIDTH];
            vec squares[3];
            for (int c = 0; c < 3; c++)
                squares[c] = sum_down(across[c], r, v, 0);
            global const float *here = stats + INDEX(stats, 0, y + r, x + v * WIDTH);
            STORE(ssim_of(squares, here, here + stats_move, stats_plane, c1, c2), line);
            for (int i = 0; i < WIDTH && x + v * WIDTH + i < width; i++)
                AT(out, 0, y + r, x + v * WIDTH + i) = line[i];
        }
}
