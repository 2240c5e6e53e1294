/* The terms of a regression as one stack of planes, and which of its features carry something, block by block.
 *
 * The stack holds 1, the features, x, y and the colours. A feature that is constant in and around a block, or whose
 * spread there is the noise that it still has, is left out of the fits of that block, and costs them nothing.
 */
#include "common.h"

/* The planes 1, x and y: positions in pixels, also in the border. `first`: its first row and column. */
kernel void constant_and_position(PLANES(stack), int features, int border)
{
    const int x = (int)get_global_id(0) - border, y = (int)get_global_id(1) - border;
    AT(stack, 0, y, x) = 1.f;
    AT(stack, 1 + features, y, x) = x;
    AT(stack, 2 + features, y, x) = y;
}

#ifdef BLOCK_COLUMNS
/* For each block and feature: its mean over the block and `reach` pixels around, and its variance there, or -1 where
 * the feature is left out. used[q] counts the blocks that use feature q. */
kernel void choose_terms(CONST_PLANES(feature), CONST_PLANES(noise), int features, int height, int width, int reach,
                         float least_variance, float least_signal, global float *restrict blocks,
                         global int *restrict used)
{
    const int q = get_global_id(0), bx = get_global_id(1), by = get_global_id(2);
    const int x0 = bx * BLOCK_COLUMNS, y0 = by * BLOCK_ROWS;
    global const float *f = feature + INDEX(feature, q, y0 - reach, x0 - reach);
    const int columns = BLOCK_COLUMNS + 2 * reach, rows = BLOCK_ROWS + 2 * reach;
    /* About the first value, so that a constant feature has no variance at all. */
    const float origin = f[0];
    float lane_sum[WIDTH], lane_squares[WIDTH], sum = 0.f, squares = 0.f;
    vec vector_sum = (vec)(0.f), vector_squares = (vec)(0.f);
    for (int y = 0; y < rows; y++) {
        int x = 0;
        for (; x + WIDTH <= columns; x += WIDTH) {
            const vec d = LOAD(f + y * feature_row + x) - origin;
            vector_sum += d;
            vector_squares += d * d;
        }
        for (; x < columns; x++) {
            const float d = f[y * feature_row + x] - origin;
            sum += d;
            squares += d * d;
        }
    }
    STORE(vector_sum, lane_sum);
    STORE(vector_squares, lane_squares);
    for (int i = 0; i < WIDTH; i++) {
        sum += lane_sum[i];
        squares += lane_squares[i];
    }
    const float mean = sum / (rows * columns);
    const float variance = fmax(squares / (rows * columns) - mean * mean, 0.f);
    float left = 0.f;
    const int right = min(x0 + BLOCK_COLUMNS, width), bottom = min(y0 + BLOCK_ROWS, height);
    for (int y = y0; y < bottom; y++)
        for (int x = x0; x < right; x++)
            left += AT(noise, q, y, x);
    left /= (right - x0) * (bottom - y0);
    const bool carries = variance > least_variance && variance > least_signal * left;
    global float *block = blocks + 2 * ((by * get_global_size(1) + bx) * features + q);
    block[0] = origin + mean;
    block[1] = carries ? variance : -1.f;
    if (carries)
        atomic_inc(used + q);
}
#endif
