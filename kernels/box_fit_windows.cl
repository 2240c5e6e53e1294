/* The groups of blocks (box_fit.cl) joined to those of windows of 2 RADIUS + 1 blocks a side, and the function of each.
 *
 * box_fit_columns and box_fit_solve join along columns and along rows, each with at most three joins a window, however
 * large; between them the image lies on its side. box_fit_windows does both at once, along rows group by group: for
 * small windows that is less work than to write all groups out and read them again.
 */
#include "groups.h"

/* The coefficients of each colour, the constant first: (C + D)^-1 cov(f, c) by Cholesky's decomposition. The constant
 * is not regularised. The group is used up. */
inline void solve(Group *window, float ridge, float least, vec function[3 * TERMS])
{
    const vec scale = 1.f / window->weight;
#pragma unroll
    for (int q = 0; q < PRODUCTS; q++)
        window->product[q] *= scale;
    /* L L^T, in place; the diagonal holds 1 / L_aa */
#pragma unroll
    for (int a = 0; a < FEATURES; a++) {
        vec *row = window->product + LOWER(a, 0);
        row[a] = larger(row[a], (vec)(0.f)) * (1.f + ridge) + least;
#pragma unroll
        for (int b = 0; b <= a; b++) {
            vec sum = row[b];
#pragma unroll
            for (int q = 0; q < b; q++)
                sum -= row[q] * window->product[LOWER(b, q)];
            row[b] = a == b ? 1.f / sqrt(larger(sum, (vec)(0.5f * least))) : sum * window->product[LOWER(b, b)];
        }
    }
#pragma unroll
    for (int k = 0; k < 3; k++) {
        vec z[SLOPES], constant_ = window->mean[FEATURES + k];
#pragma unroll
        for (int a = 0; a < FEATURES; a++) {
            vec sum = window->product[PRODUCT(FEATURES + k, a)];
#pragma unroll
            for (int q = 0; q < a; q++)
                sum -= window->product[LOWER(a, q)] * z[q];
            z[a] = sum * window->product[LOWER(a, a)];
        }
#pragma unroll
        for (int a = FEATURES - 1; a >= 0; a--) {
            vec sum = z[a];
#pragma unroll
            for (int q = a + 1; q < FEATURES; q++)
                sum -= window->product[LOWER(q, a)] * z[q];
            z[a] = sum * window->product[LOWER(a, a)];
            constant_ -= z[a] * window->mean[a];
            function[k * TERMS + 1 + a] = z[a];
        }
        function[k * TERMS] = constant_;
    }
}

#ifdef BUNDLED
/* The groups of SIDE places of a row around one as one, all at once: about the mean of the middle one, then about their own. */
inline void join_along(const float (*row)[LINE], int place, Group *window)
{
    vec weight[SIDE], apart[VARIABLES][SIDE], weighted[SIDE];
    window->weight = (vec)(0.f);
#pragma unroll
    for (int k = 0; k < SIDE; k++) {
        weight[k] = LOAD(&row[0][place - RADIUS + k]);
        window->weight += weight[k];
    }
    const vec scale = 1.f / window->weight;
#pragma unroll
    for (int v = 0; v < VARIABLES; v++) {
        const vec middle = LOAD(&row[MEAN(v)][place]);
        vec sum = (vec)(0.f);
#pragma unroll
        for (int k = 0; k < SIDE; k++) {
            apart[v][k] = LOAD(&row[MEAN(v)][place - RADIUS + k]) - middle;
            sum += weight[k] * apart[v][k];
        }
        const vec mean = sum * scale;
        window->mean[v] = middle + mean;
#pragma unroll
        for (int k = 0; k < SIDE; k++)
            apart[v][k] -= mean;
    }
#pragma unroll
    for (int v = 0; v < VARIABLES; v++) {
#pragma unroll
        for (int k = 0; k < SIDE; k++)
            weighted[k] = weight[k] * apart[v][k];
#pragma unroll
        for (int f = 0; f < FEATURES && f <= v; f++) {
            const int i = PRODUCT(v, f);
            vec sum = (vec)(0.f);
#pragma unroll
            for (int k = 0; k < SIDE; k++)
                sum += LOAD(&row[COVARIANCE(i)][place - RADIUS + k]) + weighted[k] * apart[f][k];
            window->product[i] = sum;
        }
    }
}

/* A work-item does CHUNK columns of 2 RADIUS + 1 rows; out: the TERMS coefficients of each colour. */
kernel void box_fit_windows(CONST_PLANES(group), int height, int width, int phase, float ridge, float least,
                            PLANES(out))
{
    const int left = get_global_id(0) * CHUNK, first = (int)get_global_id(1) * SIDE - phase - RADIUS;
    if (left >= width || first + RADIUS >= height)
        return;
    const int rows = min(SIDE, height - first - RADIUS), outside = max(-first - RADIUS, 0);
    /* Of each row the windows of columns; place 0 is column left - WIDTH. */
    float line[SIDE][QUANTITIES][LINE];
    for (int place = 0; place < LINE; place += WIDTH) {
        const int x = min(max(left - WIDTH + place, 0), (width - 1) / WIDTH * WIDTH);
        Group ends[SIDE], beginning, window;
        JOIN_ENDS(first, x, ends);
        for (int i = 0; i < rows; i++) {
            NEXT_WINDOW(i, &window);
            for (int q = 0; q < QUANTITIES; q++)
                STORE(((const vec *)&window)[q], line[i][q] + place);
        }
    }
    mirror_ends(line[0][0], rows * QUANTITIES, left - WIDTH, RADIUS, width);
    for (int i = outside; i < rows; i++)
        for (int place = 0; place < CHUNK && left + place < width; place += WIDTH) {
            Group window;
            join_along(line[i], WIDTH + place, &window);
            vec function[3 * TERMS];
            solve(&window, ridge, least, function);
            for (int a = 0; a < 3 * TERMS; a++)
                STREAM(function[a], out + INDEX(out, a, first + RADIUS + i, PLACE(left + place, 3 * TERMS)));
        }
}
#else
/* `count` planes of `rows` rows of WIDTH values become pieces of columns; `stride` vectors lie between rows. Plane by
 * plane, as a row of memory is written to then but once. (Not INLINE: inlined, `restrict` becomes an intrinsic that
 * some simulators lack.) */
inline void store_transposed(const vec *values, int stride, int count, int rows, PLANES(out), int y, int x, int width)
{
    const float *value = (const float *)values;
    for (int p = 0; p < count; p++)
        for (int i = 0; i < WIDTH && x + i < width; i++)
            for (int r = 0; r < rows; r++)
                AT(out, p, x + i, y + r) = value[(r * stride + p) * WIDTH + i];
}
#define STORE_TRANSPOSED(values, stride, count, rows, p, y, x, width) \
    store_transposed(values, stride, count, rows, p, p##_origin, p##_row, p##_plane, y, x, width)


/* The groups of the 2 RADIUS + 1 blocks around each block of a column as one; transposed, so that the next step, along
 * rows, goes along columns too. A work-item makes 2 RADIUS + 1 windows of WIDTH columns; the next one those below,
 * whose results go to the same lines of a cache. */
kernel void box_fit_columns(CONST_PLANES(group), int height, int width, int phase, PLANES(out))
{
    const int x = get_global_id(1) * WIDTH, first = (int)get_global_id(0) * SIDE - phase - RADIUS;
    if (x >= width || first + RADIUS >= height)
        return;
    Group ends[SIDE], beginning, window[SIDE];
    JOIN_ENDS(first, x, ends);
    const int rows = min(SIDE, height - first - RADIUS), outside = max(-first - RADIUS, 0);
    for (int i = 0; i < rows; i++)
        NEXT_WINDOW(i, &window[i]);
    STORE_TRANSPOSED(&window[outside].weight, sizeof(Group) / sizeof(vec), QUANTITIES, rows - outside, out,
                     first + RADIUS + outside, x, width);
}

/* group: windows of columns, transposed. out, upright again: the TERMS coefficients of each colour. */
kernel void box_fit_solve(CONST_PLANES(group), int height, int width, float ridge, float least, PLANES(out))
{
    const int x = get_global_id(1) * WIDTH, first = (int)get_global_id(0) * SIDE - RADIUS;
    if (x >= width || first + RADIUS >= height)
        return;
    Group ends[SIDE], beginning, window;
    JOIN_ENDS(first, x, ends);
    const int rows = min(SIDE, height - first - RADIUS);
    vec function[SIDE][3 * TERMS];
    for (int i = 0; i < rows; i++) {
        NEXT_WINDOW(i, &window);
        solve(&window, ridge, least, function[i]);
    }
    STORE_TRANSPOSED(function[0], 3 * TERMS, 3 * TERMS, rows, out, first + RADIUS, x, width);
}
#endif
