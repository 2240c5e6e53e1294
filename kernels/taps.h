/* The pixels of the search window, as the moments of two rows of a tile take them. */
#ifndef MCDENOISE_TAPS_H
#define MCDENOISE_TAPS_H
#include "first_order.h"

#define GROUP 6 /* 12 sums, 2 weights and a product: 15 of 16 registers */
#define LINES (ROWS + 2 * REACH)
#define LINE (((COLUMNS + 2 * REACH + WIDTH - 1) / WIDTH) * WIDTH)

/* Rows r and r + STRIDE are a pair; the last ones may lack a partner. */
#define ROWS_LEFT (ROWS % (2 * STRIDE))
#define PAIRS (ROWS / (2 * STRIDE) * STRIDE + (ROWS_LEFT < STRIDE ? ROWS_LEFT : STRIDE))
#define FIRST_ROW(pair) ((pair) / STRIDE * 2 * STRIDE + (pair) % STRIDE)
#define PAIR_OF(row) ((row) / (2 * STRIDE) * STRIDE + (row) % STRIDE)
#define PLACE_IN_PAIR(row) ((row) / STRIDE % 2)

/* Where a pair's windows together have pixels: a row more than one has; those at the edge of the inner window, which
 * one of the two counts to it and the other does not, twice. */
#define TAPS ((SIDE + 1) * SIDE + 2 * (2 * INNER + 1))

/* The pixels of a pair's windows: where their products are, and their weights for both. Those of the inner windows, [0],
 * come first, then the others, [1], both row by row: `end` is how many there are up to the end of a row. */
typedef struct {
    vec weight[TAPS][2];
    int place[TAPS];
    int end[2][SIDE + 1];
} Taps;

/* The same for any pair, before taps of no weight are dropped; and which tap an offset has for the first row of a pair,
 * [0], and for the second. */
typedef struct {
    short tap[2][SIDE * SIDE];
    int place[TAPS];
    int end[2][SIDE + 1], count;
} Order;

/* 0 out of the window, else 1, or 2 in the inner window; counted from the window's corner. */
inline int part_of_window(int dx, int dy)
{
    dx -= SEARCH_RADIUS;
    dy -= SEARCH_RADIUS;
#ifdef WITH_INNER
    if (IN_DISC(dx, dy, INNER))
        return 2;
#endif
    return IN_DISC(dx, dy, SEARCH_RADIUS);
}

inline void put_in_order(Order *order)
{
    int count = 0;
    for (int part = 2; part > 0; part--)
        for (int k = 0; k <= SIDE; k++) {
            for (int dx = 0; dx < SIDE; dx++) {
                const bool first = k < SIDE && part_of_window(dx, k) == part;
                const bool second = k > 0 && part_of_window(dx, k - 1) == part;
                if (first)
                    order->tap[0][k * SIDE + dx] = count;
                if (second)
                    order->tap[1][(k - 1) * SIDE + dx] = count;
                if (first || second)
                    order->place[count++] = (k * LINE + dx) * STRIDE;
            }
            order->end[2 - part][k] = count;
        }
    order->count = count;
}

inline void drop_zeros(Taps *taps, const Order *order)
{
    int count = 0, i = 0;
    for (int part = 0; part < 2; part++)
        for (int k = 0; k <= SIDE; k++) {
            for (; i < order->end[part][k]; i++) {
                const vec first = taps->weight[i][0], second = taps->weight[i][1];
                if (ANY(first + second > (vec)(0.f))) {
                    taps->weight[count][0] = first;
                    taps->weight[count][1] = second;
                    taps->place[count++] = order->place[i];
                }
            }
            taps->end[part][k] = count;
        }
}

/* sums += weights times products, over some of the taps. */
inline void add_taps(const Taps *taps, int from, int to, const float *products, vec sum[2][GROUP])
{
    for (int t = from; t < to; t++) {
        const vec first = taps->weight[t][0], second = taps->weight[t][1];
        const float *product = products + taps->place[t];
#pragma unroll
        for (int i = 0; i < GROUP; i++) {
            const vec value = LOAD(product + i * LINES * LINE);
            sum[0][i] += first * value;
            sum[1][i] += second * value;
        }
    }
}

/* The same for all taps of a part of the window. */
inline void add_part(const Taps *taps, int part, const float *products, vec sum[2][GROUP])
{
    add_taps(taps, part == 0 ? 0 : taps->end[0][SIDE], taps->end[part][SIDE], products, sum);
}

/* The same, to the last bit, and `below` += the products, each tap's times how many rows of the window come after its own:
 * what the sums have grown by at the end of each row but the last. */
inline void add_part_by_rows(const Taps *taps, int part, const float *products, vec sum[2][GROUP], vec below[2][GROUP])
{
#pragma unroll
    for (int i = 0; i < GROUP; i++) {
        below[0][i] -= (float)SIDE * sum[0][i];
        below[1][i] -= (float)SIDE * sum[1][i];
    }
    int from = part == 0 ? 0 : taps->end[0][SIDE];
    for (int k = 0; k < SIDE; k++) {
        add_taps(taps, from, taps->end[part][k], products, sum);
        from = taps->end[part][k];
#pragma unroll
        for (int i = 0; i < GROUP; i++) {
            below[0][i] += sum[0][i];
            below[1][i] += sum[1][i];
        }
    }
    add_taps(taps, from, taps->end[part][SIDE], products, sum);
}

#endif
