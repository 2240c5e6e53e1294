/* Features before regression: NLM with their own variances (Rousselle et al. 2013), and the variance that is left.
 *
 * First the weights of a tile, offset by offset; then the sums, pixel by pixel, which so stay in registers.
 */
#include "patch.h"
#include "window.h"

#define SIDE (2 * SEARCH_RADIUS + 1)

/* feature and variance: CHANNELS planes, total: the sum of the variances; mirrored borders of at least search radius +
 * patch radius */
kernel void prefilter(CONST_PLANES(feature), CONST_PLANES(variance), CONST_PLANES(total_variance), int height,
                      int width, PLANES(out), PLANES(out_variance))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    global const float *f = feature + INDEX(feature, 0, y, x);
    global const float *t = total_variance + INDEX(total_variance, 0, y, x);
    vec weight[SIDE * SIDE][ROWS][VECTORS];
    int count = 0;
    for (int dy = -SEARCH_RADIUS; dy <= SEARCH_RADIUS; dy++) {
        int first = -SEARCH_RADIUS;
        while (!IN_WINDOW(first, dy, SEARCH_RADIUS))
            first++;
        vec excess[SIDE][PATCH_ROWS][SPAN_VECTORS];
        excess_of_offsets(f, f + dy * feature_row + first, feature_row, feature_plane, t,
                          t + dy * total_variance_row + first, total_variance_row, 1, 1 - 2 * first, excess);
        for (int n = 0; n < 1 - 2 * first; n++, count++)
            for (int v = 0; v < VECTORS; v++) {
                vec column[ROWS];
                falloff_of_column(excess[n], v, column);
#pragma unroll
                for (int r = 0; r < ROWS; r++)
                    weight[count][r][v] = column[r];
            }
    }
    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int v = 0; v < VECTORS; v++) {
            global const float *pixel = f + r * feature_row + v * WIDTH;
            global const float *noise = variance + INDEX(variance, 0, y + r, x + v * WIDTH);
            vec own[CHANNELS], sum[CHANNELS], spread[CHANNELS], total = (vec)(0.f);
#pragma unroll
            for (int c = 0; c < CHANNELS; c++) {
                own[c] = LOAD(pixel + c * feature_plane);
                sum[c] = spread[c] = (vec)(0.f);
            }
            int k = 0;
            for (int dy = -SEARCH_RADIUS; dy <= SEARCH_RADIUS; dy++)
                for (int dx = -SEARCH_RADIUS; dx <= SEARCH_RADIUS; dx++) {
                    if (!IN_WINDOW(dx, dy, SEARCH_RADIUS))
                        continue;
                    const vec w = weight[k++][r][v];
                    total += w;
#pragma unroll
                    for (int c = 0; c < CHANNELS; c++) {
                        sum[c] += w * (LOAD(pixel + c * feature_plane + dy * feature_row + dx) - own[c]);
                        spread[c] += w * w * LOAD(noise + c * variance_plane + dy * variance_row + dx);
                    }
                }
#pragma unroll
            for (int c = 0; c < CHANNELS; c++) {
                STORE(own[c] + sum[c] / total, out + INDEX(out, c, y + r, x + v * WIDTH));
                STORE(spread[c] / (total * total), out_variance + INDEX(out_variance, c, y + r, x + v * WIDTH));
            }
        }
}
