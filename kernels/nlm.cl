/* Non-local means (Buades et al. 2005; Yang 2022, eqs. 4-6) and, WITH_SSIM, the weights of eq. 8.
 *
 *   f(i) = c(i) + sum_j w(i, j) (c(j) - c(i)) / sum_j w(i, j)      (eq. 4, about the centre: a constant stays itself)
 *   w(i, j) = exp(-d(i, j) / h^2)                                   (eq. 5)
 *   w(i, j) = exp(-(stabiliser + ln(1 / SSIM(i, j))) d(i, j) / h^2) (eq. 8; as printed, stabiliser = 0)
 *
 * d is the Gaussian-weighted mean squared difference of the patches of `tone`, over three channels (eq. 6).
 * All inputs have mirrored borders of at least search radius + patch radius, so no pixel needs a test.
 */
#include "patch.h"

kernel void nlm(CONST_PLANES(tone), CONST_PLANES(color), int height, int width, int search_radius,
                constant float *gaussian, global const float *restrict noise_level, float h_factor,
                int center,
#ifdef WITH_SSIM
                CONST_PLANES(unit), CONST_PLANES(stats), float c1, float c2, float stabiliser,
#endif
                PLANES(out))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    const float scale = exponent_scale(h_factor, noise_level[0]);
    global const float *tone_here = tone + INDEX(tone, 0, y, x);
    global const float *color_here = color + INDEX(color, 0, y, x);
#ifdef WITH_SSIM
    global const float *unit_here = unit + INDEX(unit, 0, y, x);
    global const float *stats_here = stats + INDEX(stats, 0, y, x);
#endif
    vec total[ROWS][VECTORS], most[ROWS][VECTORS], sum[3][ROWS][VECTORS];
    for (int r = 0; r < ROWS; r++)
        for (int v = 0; v < VECTORS; v++) {
            total[r][v] = most[r][v] = (vec)(0.f);
            sum[0][r][v] = sum[1][r][v] = sum[2][r][v] = (vec)(0.f);
        }
    for (int dy = -search_radius; dy <= search_radius; dy++)
        for (int dx = -search_radius; dx <= search_radius; dx++) {
            if (dx == 0 && dy == 0)
                continue;
            vec distance[ROWS][VECTORS];
            patch_sum(tone_here, tone_here + dy * tone_row + dx, tone_row, tone_plane, 3, gaussian, distance);
#ifdef WITH_SSIM
            vec ssim[ROWS][VECTORS];
            patch_ssim_tile(unit_here, unit_here + dy * unit_row + dx, unit_row, unit_plane, stats_here,
                                stats_here + dy * stats_row + dx, stats_row, stats_plane, c1, c2, ssim);
#endif
            global const float *color_there = color_here + dy * color_row + dx;
            for (int r = 0; r < ROWS; r++)
                for (int v = 0; v < VECTORS; v++) {
                    vec exponent = scale * distance[r][v];
#ifdef WITH_SSIM
                    exponent *= stabiliser - log(ssim[r][v]);
#endif
                    const vec weight = exp(exponent);
                    total[r][v] += weight;
                    most[r][v] = fmax(most[r][v], weight);
                    for (int c = 0; c < 3; c++) {
                        const int i = c * color_plane + r * color_row + v * WIDTH;
                        sum[c][r][v] += weight * (LOAD(color_there + i) - LOAD(color_here + i));
                    }
                }
        }
    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int v = 0; v < VECTORS; v++) {
            const vec norm = total[r][v] + center_weight(center, most[r][v]);
            for (int c = 0; c < 3; c++) {
                const vec value = LOAD(color_here + c * color_plane + r * color_row + v * WIDTH) + sum[c][r][v] / norm;
                STORE(value, out + INDEX(out, c, y + r, x + v * WIDTH));
            }
        }
}
