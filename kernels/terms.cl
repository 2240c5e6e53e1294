/* The terms of a regression: what the features tell in and around each block of pixels.
 *
 * They say much of the same: the channels of an albedo rise and fall together, and a wall has one normal. So a block
 * looks along the principal components of its features and leaves out those that carry nothing, which then cost its
 * fits nothing (Moon et al. 2014 do so for each pixel).
 */
#include "common.h"

#define SIZE FEATURES
#include "eigen.h"
#include "terms.h"

#define PAIR(a, b) ((a) * ((a) + 1) / 2 + (b)) /* b <= a */
#define PAIRS PAIR(FEATURES, 0)

inline float sum_of(vec v)
{
    float lane[WIDTH], sum = 0.f;
    STORE(v, lane);
    for (int i = 0; i < WIDTH; i++)
        sum += lane[i];
    return sum;
}

/* 1 for the columns that are there, of WIDTH from x on. */
inline vec within(int x, int columns)
{
    float inside[WIDTH];
    for (int i = 0; i < WIDTH; i++)
        inside[i] = x + i < columns ? 1.f : 0.f;
    return LOAD(inside);
}

/* The mean of a plane over a rectangle. */
inline float mean_of(global const float *corner, int row, int rows, int columns)
{
    vec sum = (vec)(0.f);
    for (int x = 0; x < columns; x += WIDTH) {
        const vec inside = within(x, columns);
        for (int y = 0; y < rows; y++)
            sum += inside > (vec)(0.f) ? LOAD(corner + y * row + x) : (vec)(0.f);
    }
    return sum_of(sum) / (rows * columns);
}

/* The means of the features over a rectangle and, about them, their covariances. */
inline void covariances(CONST_PLANES(feature), int top, int left, int rows, int columns, float mean[FEATURES],
                        float m[FEATURES][FEATURES])
{
    /* About the first value, so that a constant feature has no variance at all. */
    float origin[FEATURES];
    vec sum[FEATURES], products[PAIRS];
    for (int a = 0; a < FEATURES; a++) {
        origin[a] = AT(feature, a, top, left);
        sum[a] = (vec)(0.f);
    }
    for (int i = 0; i < PAIRS; i++)
        products[i] = (vec)(0.f);
    for (int x = 0; x < columns; x += WIDTH) {
        const vec inside = within(x, columns);
        /* A column has a sum of its own: one over all pixels rounds more than small components have. */
        vec column[PAIRS];
        for (int i = 0; i < PAIRS; i++)
            column[i] = (vec)(0.f);
        for (int y = 0; y < rows; y++) {
            vec d[FEATURES];
            /* Unrolled, which some compilers do with constant bounds only: one runtime ends a work-item's loops after
             * 65535 turns in all. */
#pragma unroll
            for (int a = 0; a < FEATURES; a++) {
                d[a] = (VECTOR_AT(feature, a, top + y, left + x) - origin[a]) * inside;
                sum[a] += d[a];
#pragma unroll
                for (int b = 0; b < FEATURES; b++)
                    if (b <= a)
                        column[PAIR(a, b)] += d[a] * d[b];
            }
        }
        for (int i = 0; i < PAIRS; i++)
            products[i] += column[i];
    }
    const float one = 1.f / (rows * columns);
    for (int a = 0; a < FEATURES; a++) {
        mean[a] = sum_of(sum[a]) * one;
        for (int b = 0; b <= a; b++)
            m[a][b] = m[b][a] = sum_of(products[PAIR(a, b)]) * one - mean[a] * mean[b];
    }
    for (int a = 0; a < FEATURES; a++)
        mean[a] += origin[a];
}

/* For each block what terms.h says, of the block and `reach` pixels around. A feature is left out whose variance is not
 * above least_variance, or not above least_signal times that of its noise; then likewise a component, with
 * least_direction, and one whose variance is not above least_part of that of all. used[a] counts the blocks that use
 * feature a, of those in the rows counted. */
kernel void choose_terms(CONST_PLANES(feature), CONST_PLANES(noise), int height, int width, int reach,
                         float least_variance, float least_signal, float least_direction, float least_part,
                         int counted_from, int counted_to, global float *restrict blocks, global int *restrict used)
{
    const int bx = get_global_id(0), by = get_global_id(1);
    const int x0 = bx * BLOCK_COLUMNS, y0 = by * BLOCK_ROWS;
    float mean[FEATURES], left[FEATURES], m[FEATURES][FEATURES], v[FEATURES][FEATURES];
    covariances(feature, feature_origin, feature_row, feature_plane, y0 - reach, x0 - reach, BLOCK_ROWS + 2 * reach,
                BLOCK_COLUMNS + 2 * reach, mean, m);
    const int right = min(x0 + BLOCK_COLUMNS, width), bottom = min(y0 + BLOCK_ROWS, height);
    for (int a = 0; a < FEATURES; a++) {
        left[a] = mean_of(noise + INDEX(noise, a, y0, x0), noise_row, bottom - y0, right - x0);
        if (m[a][a] > least_variance && m[a][a] > least_signal * left[a])
            atomic_add(used + a, y0 >= counted_from && y0 < counted_to);
        else
            for (int b = 0; b < FEATURES; b++)
                m[a][b] = m[b][a] = 0.f;
    }
    float all = 0.f;
    for (int a = 0; a < FEATURES; a++)
        all += m[a][a];
    const float least = larger(least_variance, least_part * all);
    eigenvectors(m, v);
    global float *block = blocks + BLOCK_FLOATS * (by * get_global_size(0) + bx);
    int count = 0;
    for (int a = 0; a < FEATURES; a++) {
        BLOCK_MEAN(block, a) = mean[a];
        float own = 0.f;
        for (int b = 0; b < FEATURES; b++)
            own += v[a][b] * v[a][b] * left[b];
        if (m[a][a] <= least || m[a][a] <= least_direction * own)
            continue;
        BLOCK_VARIANCE(block, count) = m[a][a];
        for (int b = 0; b < FEATURES; b++)
            BLOCK_DIRECTION(block, count, b) = v[a][b];
        count++;
    }
    BLOCK_COUNT(block) = count;
}
