/* Non-local means (Buades et al. 2005; Yang 2022, eqs. 4-6) and, WITH_SSIM, the weights of eq. 8.
 *
 *   f(i) = c(i) + sum_j w(i, j) (c(j) - c(i)) / sum_j w(i, j)      (eq. 4, about the centre: a constant stays itself)
 *   w(i, j) = exp(-d(i, j) / h^2)                                   (eq. 5)
 *   w(i, j) = exp(-(stabiliser + ln(1 / SSIM(i, j))) d(i, j) / h^2) (eq. 8; as printed, stabiliser = 0)
 *
 * d is the Gaussian-weighted mean squared difference of the patches of `tone`, over three channels (eq. 6).
 * All inputs have mirrored borders of at least search radius + patch radius, so no pixel needs a test.
 */
#include "fast_math.h"
#include "pairs.h"

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
    global const float *color_here = color + INDEX(color, 0, y, x);
    vec total[ROWS][VECTORS], most[ROWS][VECTORS], sum[3][ROWS][VECTORS];
    float weights[REGION_ROWS][REGION_VECTORS * WIDTH];
    vec across[REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS];
#ifdef WITH_SSIM
    vec unit_across[3][REGION_ROWS + 2 * PATCH_RADIUS][REGION_VECTORS];
#endif
    for (int r = 0; r < ROWS; r++)
        for (int v = 0; v < VECTORS; v++) {
            total[r][v] = most[r][v] = (vec)(0.f);
            sum[0][r][v] = sum[1][r][v] = sum[2][r][v] = (vec)(0.f);
        }
    /* Of each offset and its opposite, the one that points down or to the right. Where they are too long to share their
     * weights, each has its own, over the tile alone. */
    for (int dy = 0; dy <= search_radius; dy++)
        for (int dx = dy == 0 ? 1 : -search_radius; dx <= search_radius; dx++) {
            const bool shared = dy <= SHARED && abs(dx) <= SHARED;
            const int up = shared ? dy : 0, left = shared ? max(dx, 0) : 0, wide = shared ? abs(dx) : 0;
            const region area = REGION(ROWS + up, COLUMNS + wide);
            for (int side = 0; side < (shared ? 1 : 2); side++) {
                const int sy = side == 0 ? dy : -dy, sx = side == 0 ? dx : -dx;
                global const float *here = tone + INDEX(tone, 0, y - up, x - left);
                sum_across(here, here + sy * tone_row + sx, tone_row, tone_plane, 3, gaussian, area, across);
#ifdef WITH_SSIM
                global const float *unit_here = unit + INDEX(unit, 0, y - up, x - left);
                global const float *stats_here = stats + INDEX(stats, 0, y - up, x - left);
                for (int c = 0; c < 3; c++) {
                    global const float *from = unit_here + c * unit_plane;
                    sum_across(from, from + sy * unit_row + sx, unit_row, 0, 1, 0, area, unit_across[c]);
                }
#endif
                for (int r = 0; r < area.rows; r++)
                    for (int v = 0; v < area.vectors; v++) {
                        vec exponent = scale * sum_down(across, r, v, gaussian);
#ifdef WITH_SSIM
                        vec squares[3];
#pragma unroll
                        for (int c = 0; c < 3; c++)
                            squares[c] = sum_down(unit_across[c], r, v, 0);
                        global const float *stats_at = stats_here + r * stats_row + v * WIDTH;
                        exponent *= stabiliser - fast_log(ssim_of(squares, stats_at, stats_at + sy * stats_row + sx,
                                                                      stats_plane, c1, c2));
#endif
                        STORE(fast_exp(exponent), weights[r] + v * WIDTH);
                    }
                const int ahead = sy * color_row + sx, back = shared ? -ahead : ahead;
                for (int r = 0; r < ROWS; r++) {
                    const float *first = weights[r + up] + left;
                    const float *second = weights[r] + left - dx;
                    for (int v = 0; v < VECTORS; v++) {
                        global const float *pixel = color_here + r * color_row + v * WIDTH;
                        const vec one = LOAD(first + v * WIDTH);
                        const vec other = shared ? LOAD(second + v * WIDTH) : (vec)(0.f);
                        total[r][v] += one + other;
                        most[r][v] = larger(most[r][v], larger(one, other));
                        for (int c = 0; c < 3; c++) {
                            const vec own = LOAD(pixel + c * color_plane);
                            sum[c][r][v] += one * (LOAD(pixel + c * color_plane + ahead) - own);
                            sum[c][r][v] += other * (LOAD(pixel + c * color_plane + back) - own);
                        }
                    }
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
