/* First-order regression (Bitterli et al. 2016; Moon et al. 2014), weighted by NLM.
 *
 * Around each pixel i the colour is modelled as a linear function of terms t_j - t_i (features and position), fitted by
 * weighted least squares over the search window, and the constant of that function is the result: with M = sum w t t^T
 * and R = sum w t c^T it is z^T R, where M z = e_0, one solve for any number of colours.
 *
 * A work-item fits a whole tile. First the weights, offset by offset, as patches are shared between neighbours. Then
 * the moments, GROUP of them at a time: a product of two terms is the same for every pixel whose window holds it, so a
 * wide tile makes it once, and a moment is a plain weighted sum that stays in a register. Two rows, as far apart as the
 * rows of the window, are summed together: a product that is loaded serves both. Terms are taken about the mean of the
 * block (terms.cl), and the moments moved to the pixel at the end; what rounding then leaves is small against the
 * ridge, which grows with the distance between the two.
 */
#define FITS 2
#define CHANNELS 3
#include "first_order.h"
#include "patch.h"

#define GROUP 6 /* 12 sums, 2 weights and a product: 15 of 16 registers */
#define MOMENTS ((COLOR_MOMENT(TERMS, COLORS, 0) + GROUP - 1) / GROUP * GROUP)
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

/* The pixels of a pair's windows: where their products are, and their weights for both. */
typedef struct {
    vec weight[TAPS][2];
    int place[TAPS];
    int inner, count; /* taps of the inner windows come first */
} Taps;

/* The same for any pair, before taps of no weight are dropped; and which tap an offset has for the first row of a pair,
 * [0], and for the second. */
typedef struct {
    short tap[2][SIDE * SIDE];
    int place[TAPS];
    int inner, count;
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
    for (int part = 2; part > 0; part--) {
        for (int k = 0; k <= SIDE; k++)
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
        if (part == 2)
            order->inner = count;
    }
    order->count = count;
}

inline void drop_zeros(Taps *taps, const Order *order)
{
    int count = 0;
    taps->inner = 0;
    for (int i = 0; i < order->count; i++) {
        const vec first = taps->weight[i][0], second = taps->weight[i][1];
        if (ANY(first + second > (vec)(0.f))) {
            taps->weight[count][0] = first;
            taps->weight[count][1] = second;
            taps->place[count++] = order->place[i];
        }
        if (i + 1 == order->inner)
            taps->inner = count;
    }
    taps->count = count;
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

/* z^T R, with M z = e_0, for the pixels where the terms are `at`. m: moments of terms and colours about the block's mean;
 * ridges: of components and positions, per unit of weight. */
INLINE void fit(fits *m, int terms, const fits *at, const fits *ridges, float ridge,
#if FEATURES > 0
                const float direction[FEATURES][FEATURES], const fits *noise,
#endif
                fits result[COLORS])
{
    fits z[TERMS], least[TERMS];
    least[0] = m[0];
    for (int a = 1; a < terms; a++) {
        EACH least[a].of[i] = m[0].of[i] * ridges[a].of[i];
        for (int b = 1; b <= a; b++)
            EACH m[LOWER(a, b)].of[i] += at[a].of[i] * at[b].of[i] * m[0].of[i] - at[a].of[i] * m[LOWER(b, 0)].of[i] -
                                         at[b].of[i] * m[LOWER(a, 0)].of[i];
    }
    for (int a = 1; a < terms; a++)
        EACH m[LOWER(a, 0)].of[i] -= at[a].of[i] * m[0].of[i];
#if FEATURES > 0
    add_ridges(m, terms, least, ridge, direction, noise);
#else
    add_ridges(m, terms, least, ridge);
#endif
    cholesky(m, terms, least);
    solve_for_constant(m, terms, z);
    for (int a = 1; a < terms; a++)
        EACH z[0].of[i] -= at[a].of[i] * z[a].of[i];
    for (int k = 0; k < COLORS; k++) {
        EACH result[k].of[i] = (vec)(0.f);
        for (int a = 0; a < terms; a++)
            EACH result[k].of[i] += z[a].of[i] * m[COLOR_MOMENT(terms, k, a)].of[i];
    }
}

/* tone: three planes, variance: one (the sum of theirs), both with a border of REACH + patch radius. stack: FEATURES
 * features and COLORS colours, border REACH. noise: variances of the features. blocks: from terms.cl. */
kernel void regress(CONST_PLANES(tone), CONST_PLANES(variance), CONST_PLANES(stack),
#if FEATURES > 0
                    CONST_PLANES(noise), global const float *restrict blocks, int blocks_across,
#endif
                    int height, int width, float bandwidth, float ridge, float noise_ridge, float position_ridge,
                    float darkest,
#ifdef WITH_INNER
                    PLANES(inner),
#endif
                    PLANES(out))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    Order order;
    put_in_order(&order);
    Taps taps[PAIRS][VECTORS];
    for (int pair = 0; pair < PAIRS; pair++)
        for (int v = 0; v < VECTORS; v++)
            for (int i = 0; i < order.count; i++)
                for (int which = 0; which < 2; which++)
                    taps[pair][v].weight[i][which] = (vec)(0.f);
    const float scale = -0.25f / (bandwidth * bandwidth);
    global const float *t = tone + INDEX(tone, 0, y, x);
    global const float *s = variance + INDEX(variance, 0, y, x);
    for (int dy = 0; dy < SIDE; dy++) {
        int first = 0;
        while (part_of_window(first, dy) == 0)
            first++;
        const int across = SIDE - 2 * first;
        const int x_move = (first - SEARCH_RADIUS) * STRIDE, y_move = (dy - SEARCH_RADIUS) * STRIDE;
        vec excess[SIDE][PATCH_ROWS][SPAN_VECTORS];
        excess_of_offsets(t, t + y_move * tone_row + x_move, tone_row, tone_plane, s, s + y_move * variance_row + x_move,
                          variance_row, STRIDE, across, excess);
        for (int n = 0; n < across; n++)
            for (int v = 0; v < VECTORS; v++) {
                vec weight[ROWS];
                weights_of_column(excess[n], v, scale, weight);
#pragma unroll
                for (int r = 0; r < ROWS; r++) {
                    const int which = PLACE_IN_PAIR(r), tap = order.tap[which][dy * SIDE + first + n];
                    taps[PAIR_OF(r)][v].weight[tap][which] = weight[r];
                }
            }
    }
    for (int pair = 0; pair < PAIRS; pair++)
        for (int v = 0; v < VECTORS; v++)
            drop_zeros(&taps[pair][v], &order);

    /* What colours are taken about: the tile's smallest, beside which the rounding of none is large. */
    float base[COLORS];
    for (int k = 0; k < COLORS; k++) {
        base[k] = AT(stack, FEATURES + k, y, x);
        for (int row = y; row < min(y + ROWS, height); row++)
            for (int column = x; column < min(x + COLUMNS, width); column++) {
                const float value = AT(stack, FEATURES + k, row, column);
                base[k] = fabs(value) < fabs(base[k]) ? value : base[k];
            }
    }

    /* What is multiplied: terms about the middle, then colours. */
    float factors[TERMS + COLORS][LINES][LINE];
    global const float *corner = stack + INDEX(stack, 0, y - REACH, x - REACH);
    int terms = COMPONENT;
#if FEATURES > 0
    global const float *block = blocks + BLOCK_FLOATS * (y / BLOCK_ROWS * blocks_across + x / BLOCK_COLUMNS);
    float direction[FEATURES][FEATURES];
    terms += (int)BLOCK_COUNT(block);
    for (int k = 0; k < terms - COMPONENT; k++)
        for (int q = 0; q < FEATURES; q++)
            direction[k][q] = BLOCK_DIRECTION(block, k, q);
#endif
    for (int line = 0; line < LINES; line++)
        for (int c = 0; c < LINE; c += WIDTH) {
            global const float *here = corner + line * stack_row + c;
            STORE((vec)(1.f), &factors[0][line][c]);
            for (int i = 0; i < WIDTH; i++)
                factors[1][line][c + i] = c + i - REACH - COLUMNS / 2;
            STORE((vec)(line - REACH - ROWS / 2), &factors[2][line][c]);
#if FEATURES > 0
            vec feature[FEATURES];
            for (int q = 0; q < FEATURES; q++)
                feature[q] = LOAD(here + q * stack_plane) - BLOCK_MEAN(block, q);
            for (int k = 0; k < terms - COMPONENT; k++) {
                vec sum = direction[k][0] * feature[0];
                for (int q = 1; q < FEATURES; q++)
                    sum += direction[k][q] * feature[q];
                STORE(sum, &factors[COMPONENT + k][line][c]);
            }
#endif
            for (int k = 0; k < COLORS; k++)
                STORE(LOAD(here + (FEATURES + k) * stack_plane) - base[k], &factors[terms + k][line][c]);
        }

    /* By place, not by a counter, whose loops one runtime's compiler gets wrong. */
    uchar first[MOMENTS], second[MOMENTS];
    const int total = COLOR_MOMENT(terms, COLORS, 0);
    for (int a = 0; a < terms; a++)
        for (int b = 0; b <= a; b++)
            first[LOWER(a, b)] = a, second[LOWER(a, b)] = b;
    for (int k = 0; k < COLORS; k++)
        for (int a = 0; a < terms; a++)
            first[COLOR_MOMENT(terms, k, a)] = a, second[COLOR_MOMENT(terms, k, a)] = terms + k;
    for (int i = total; i < MOMENTS; i++)
        first[i] = second[i] = 0;

    vec moments[PAIRS][VECTORS][MOMENTS][2];
#ifdef WITH_INNER
    vec inside[PAIRS][VECTORS][MOMENTS][2];
#endif
    for (int start = 0; start < total; start += GROUP) {
        float products[GROUP][LINES][LINE];
        for (int i = 0; i < GROUP; i++) {
            const float *a = &factors[first[start + i]][0][0], *b = &factors[second[start + i]][0][0];
            for (int at = 0; at < LINES * LINE; at += WIDTH)
                STORE(LOAD(a + at) * LOAD(b + at), &products[i][0][0] + at);
        }
        for (int pair = 0; pair < PAIRS; pair++)
            for (int v = 0; v < VECTORS; v++) {
                const float *here = &products[0][FIRST_ROW(pair)][v * WIDTH];
                vec sum[2][GROUP];
#pragma unroll
                for (int i = 0; i < GROUP; i++)
                    sum[0][i] = sum[1][i] = (vec)(0.f);
                add_taps(&taps[pair][v], 0, taps[pair][v].inner, here, sum);
#ifdef WITH_INNER
                for (int i = 0; i < GROUP; i++) {
                    inside[pair][v][start + i][0] = sum[0][i];
                    inside[pair][v][start + i][1] = sum[1][i];
                }
#endif
                add_taps(&taps[pair][v], taps[pair][v].inner, taps[pair][v].count, here, sum);
                for (int i = 0; i < GROUP; i++) {
                    moments[pair][v][start + i][0] = sum[0][i];
                    moments[pair][v][start + i][1] = sum[1][i];
                }
            }
    }

    for (int pair = 0; pair < PAIRS; pair++)
        for (int v = 0; v < VECTORS; v++) {
            fits at[TERMS], ridges[TERMS], m[MOMENTS], result[COLORS];
            int row[2];
            EACH row[i] = min(FIRST_ROW(pair) + i * STRIDE, ROWS - 1);
            for (int a = 1; a < terms; a++)
                EACH {
                    at[a].of[i] = LOAD(&factors[a][row[i] + REACH][v * WIDTH + REACH]);
                    ridges[a].of[i] = (vec)(ridge_of_position(position_ridge));
#if FEATURES > 0
                    if (a >= COMPONENT)
                        ridges[a].of[i] = ridge_of_component(BLOCK_VARIANCE(block, a - COMPONENT), at[a].of[i]);
#endif
                }
#if FEATURES > 0
            fits noises[FEATURES];
            for (int q = 0; q < FEATURES; q++)
                EACH noises[q].of[i] = noise_ridge * VECTOR_AT(noise, q, y + row[i], x + v * WIDTH);
#define FIT fit(m, terms, at, ridges, ridge, direction, noises, result)
#else
#define FIT fit(m, terms, at, ridges, ridge, result)
#endif
#define FIT_AND_STORE(from, out)                                                                                       \
    for (int j = 0; j < total; j++)                                                                                    \
        EACH m[j].of[i] = from[pair][v][j][i];                                                                         \
    FIT;                                                                                                               \
    for (int i = 0; i < FITS; i++) {                                                                                   \
        const int r = FIRST_ROW(pair) + i * STRIDE;                                                                    \
        if (r < ROWS && y + r < height) {                                                                              \
            vec one[COLORS];                                                                                           \
            for (int k = 0; k < COLORS; k++)                                                                           \
                one[k] = result[k].of[i];                                                                              \
            STORE_FIT(one, base, y + r, x + v * WIDTH, out);                                                           \
        }                                                                                                              \
    }
            FIT_AND_STORE(moments, out)
#ifdef WITH_INNER
            FIT_AND_STORE(inside, inner)
#endif
        }
}
