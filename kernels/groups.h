/* Groups of samples, and windows of them.
 *
 * A group is so many planes: the sum of weights; the means of the VARIABLES, features first, colours after; and
 * sum w (v_a - mean_a) (f_b - mean_b) of every variable a and feature b, of features only b <= a. Groups are only ever
 * joined: weights span so many powers of ten that a sum from which a bright block was taken away again would be wrong.
 * Still no window costs more than three joins (van Herk 1992, Gil and Werman 1993): cut into stretches as long as a
 * window, each window is the end of one and the beginning of the next.
 */
#ifndef MCDENOISE_GROUPS_H
#define MCDENOISE_GROUPS_H
#include "bundles.h"

#define VARIABLES (FEATURES + 3)
#define TERMS (FEATURES + 1)
#define LOWER(a, b) ((a) * ((a) + 1) / 2 + (b)) /* b <= a */
#define PRODUCT(a, b) ((a) < FEATURES ? LOWER(a, b) : LOWER(FEATURES, 0) + ((a) - FEATURES) * FEATURES + (b))
#define PRODUCTS PRODUCT(VARIABLES, 0)
#define MEAN(a) (1 + (a))
#define COVARIANCE(i) (1 + VARIABLES + (i))
#if FEATURES > 0
#define ROOM PRODUCTS
#define SLOPES FEATURES
#else
#define ROOM 1 /* no array is empty */
#define SLOPES 1
#endif
#define QUANTITIES (1 + VARIABLES + PRODUCTS)
#define SIDE (2 * RADIUS + 1)

/* As planes, in this order. */
typedef struct {
    vec weight, mean[VARIABLES], product[ROOM];
} Group;

/* a and b as one (Chan et al. 1979), to either of them or to a third. */
inline void join(const Group *a, const Group *b, Group *both)
{
    const vec weight = a->weight + b->weight, part = b->weight / weight, common = a->weight * part;
    vec apart[VARIABLES];
#pragma unroll
    for (int v = 0; v < VARIABLES; v++) {
        apart[v] = b->mean[v] - a->mean[v];
        both->mean[v] = a->mean[v] + part * apart[v];
    }
#pragma unroll
    for (int v = 0; v < VARIABLES; v++) {
        const vec weighted = common * apart[v];
#pragma unroll
        for (int f = 0; f < FEATURES && f <= v; f++) {
            const int i = PRODUCT(v, f);
            both->product[i] = a->product[i] + b->product[i] + weighted * apart[f];
        }
    }
    both->weight = weight;
}

/* WIDTH values of a row of n from x on, mirrored. */
inline vec mirrored(global const float *row, int x, int n)
{
    if (x >= 0 && x + WIDTH <= n)
        return LOAD(row + x);
    float line[WIDTH];
    for (int i = 0; i < WIDTH; i++)
        line[i] = row[reflect(x + i, n)];
    return LOAD(line);
}

/* Those of row y, mirrored, and from column x on: mirrored as well or, in bundles, a multiple of WIDTH. */
#ifdef BUNDLED
#define QUANTITY(q) LOAD(row + x * QUANTITIES + (q) * WIDTH)
#else
#define QUANTITY(q) mirrored(row + (q) * group_plane, x, width)
#endif
inline void load_group(CONST_PLANES(group), int y, int x, int height, int width, Group *out)
{
    global const float *row = group + INDEX(group, 0, reflect(y, height), 0);
    out->weight = QUANTITY(0);
#pragma unroll
    for (int v = 0; v < VARIABLES; v++)
        out->mean[v] = QUANTITY(MEAN(v));
#pragma unroll
    for (int i = 0; i < PRODUCTS; i++)
        out->product[i] = QUANTITY(COVARIANCE(i));
}
#define LOAD_GROUP(y, out) load_group(group, group_origin, group_row, group_plane, y, x, height, width, out)

/* ends[i]: the groups of rows `first` + i to `first` + 2 RADIUS as one. */
inline void join_ends(CONST_PLANES(group), int first, int x, int height, int width, Group ends[SIDE])
{
    LOAD_GROUP(first + SIDE - 1, &ends[SIDE - 1]);
    for (int i = SIDE - 2; i >= 0; i--) {
        Group own;
        LOAD_GROUP(first + i, &own);
        join(&own, &ends[i + 1], &ends[i]);
    }
}
#define JOIN_ENDS(first, x, ends) join_ends(group, group_origin, group_row, group_plane, first, x, height, width, ends)

/* The window that begins at row `first` + i, of the end ends[i] and the beginning of the rows that follow, which grows
 * by one row with each i > 0. */
inline void next_window(CONST_PLANES(group), int first, int i, int x, int height, int width, const Group ends[SIDE],
                        Group *beginning, Group *window)
{
    if (i == 0) {
        *window = ends[0];
        return;
    }
    Group own;
    LOAD_GROUP(first + SIDE - 1 + i, &own);
    if (i == 1)
        *beginning = own;
    else
        join(beginning, &own, beginning);
    join(&ends[i], beginning, window);
}
#define NEXT_WINDOW(i, window) \
    next_window(group, group_origin, group_row, group_plane, first, i, x, height, width, ends, &beginning, window)

#endif
