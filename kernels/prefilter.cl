/* Features before regression: NLM with their own variances (Rousselle et al. 2013), and the variance that is left. */
#include "patch.h"
#include "window.h"

/* feature and variance: CHANNELS planes, total: the sum of the variances; mirrored borders of at least search radius +
 * patch radius */
kernel void prefilter(CONST_PLANES(feature), CONST_PLANES(variance), CONST_PLANES(total_variance), int height,
                      int width, int search_radius, PLANES(out), PLANES(out_variance))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    global const float *f = feature + INDEX(feature, 0, y, x);
    global const float *s = variance + INDEX(variance, 0, y, x);
    global const float *t = total_variance + INDEX(total_variance, 0, y, x);
    vec total[ROWS][VECTORS], sum[CHANNELS][ROWS][VECTORS], spread[CHANNELS][ROWS][VECTORS];
    for (int r = 0; r < ROWS; r++)
        for (int v = 0; v < VECTORS; v++) {
            total[r][v] = (vec)(0.f);
            for (int c = 0; c < CHANNELS; c++)
                sum[c][r][v] = spread[c][r][v] = (vec)(0.f);
        }
    for (int dy = -search_radius; dy <= search_radius; dy++)
        for (int dx = -search_radius; dx <= search_radius; dx++) {
            if (!IN_WINDOW(dx, dy, search_radius))
                continue;
            const int move = dy * feature_row + dx, s_move = dy * variance_row + dx;
            vec distance[ROWS][VECTORS];
            patch_variance_distance(f, f + move, feature_row, feature_plane, t, t + dy * total_variance_row + dx,
                                    total_variance_row, CHANNELS, distance);
            for (int r = 0; r < ROWS; r++)
                for (int v = 0; v < VECTORS; v++) {
                    const vec weight = falloff(distance[r][v], -0.25f);
                    total[r][v] += weight;
                    for (int c = 0; c < CHANNELS; c++) {
                        const int i = c * feature_plane + r * feature_row + v * WIDTH;
                        const int j = c * variance_plane + r * variance_row + v * WIDTH;
                        sum[c][r][v] += weight * (LOAD(f + move + i) - LOAD(f + i));
                        spread[c][r][v] += weight * weight * LOAD(s + s_move + j);
                    }
                }
        }
    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int v = 0; v < VECTORS; v++)
            for (int c = 0; c < CHANNELS; c++) {
                const int i = c * feature_plane + r * feature_row + v * WIDTH;
                STORE(LOAD(f + i) + sum[c][r][v] / total[r][v], out + INDEX(out, c, y + r, x + v * WIDTH));
                STORE(spread[c][r][v] / (total[r][v] * total[r][v]),
                      out_variance + INDEX(out_variance, c, y + r, x + v * WIDTH));
            }
}
