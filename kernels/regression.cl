/* First-order regression (Bitterli et al. 2016; Moon et al. 2014), weighted by NLM.
 *
 * Around each pixel i the colour is modelled as a linear function of terms t_j - t_i (features and position), fitted by
 * weighted least squares over the search window, and the constant of that function is the result: with M = sum w t t^T
 * and R = sum w t c^T it is z^T R, where M z = e_0, one solve for any number of colours.
 *
 * A work-item fits a whole tile. First the weights, a row of offsets at once, as patches are shared between neighbours.
 * Then the moments, GROUP of them at a time: a product of two terms is the same for every pixel whose window holds it,
 * so a wide tile makes it once, and a moment is a plain weighted sum that stays in a register. Two rows, as far apart
 * as the rows of the window, are summed together: a product that is loaded serves both. What y is a factor of is no sum
 * of its own: y is the same along a row of the window. Terms are taken about the mean of the block (terms.cl), and the
 * moments moved to the pixel at the end; what rounding then leaves is small against the ridge, which grows with the
 * distance between the two.
 */
#define FITS 2
#define CHANNELS 3
#include "patch.h"
#include "taps.h"

#define MOMENTS ((COLOR_MOMENT(TERMS, COLORS, 0) + GROUP - 1) / GROUP * GROUP)

#define Y 2 /* the term */
#define REST(a) max((a) - 2, 0) /* place of x or of a component among them */
#define MOMENT(a, b) ((a) < terms ? LOWER(a, b) : COLOR_MOMENT(terms, (a) - terms, b)) /* colours come after the terms */

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

    /* Which products are summed, and which moments these sums are: first those of the constant with all but y, which give
     * those of y as well; then those of y with itself and of all other terms. By place, not by a counter, whose loops one
     * runtime's compiler gets wrong. */
    uchar first[MOMENTS], second[MOMENTS], moment[MOMENTS], moment_of_y[TERMS + COLORS];
    const int total = COLOR_MOMENT(terms, COLORS, 0), with_y = terms + COLORS - 1;
    const int sums = with_y + 1 + COLOR_MOMENT(terms - 2, COLORS, 0);
    for (int i = 0; i < MOMENTS; i++)
        first[i] = second[i] = 0;
    for (int a = 0; a < terms + COLORS; a++) {
        if (a == Y)
            continue;
        const int place = a < Y ? a : a - 1;
        second[place] = a, moment[place] = MOMENT(a, 0);
        moment_of_y[place] = a < Y ? LOWER(Y, a) : MOMENT(a, Y);
        for (int b = 1; b <= min(a, terms - 1); b++)
            if (b != Y) {
                const int among = a < terms ? LOWER(REST(a), REST(b)) : COLOR_MOMENT(terms - 2, a - terms, REST(b));
                first[with_y + 1 + among] = b, second[with_y + 1 + among] = a;
                moment[with_y + 1 + among] = MOMENT(a, b);
            }
    }
    first[with_y] = second[with_y] = Y, moment[with_y] = LOWER(Y, Y);

    vec moments[PAIRS][VECTORS][MOMENTS][2];
#ifdef WITH_INNER
    vec inside[PAIRS][VECTORS][MOMENTS][2];
#endif
    for (int start = 0; start < sums; start += GROUP) {
        float products[GROUP][LINES][LINE];
        for (int i = 0; i < GROUP; i++) {
            const float *a = &factors[first[start + i]][0][0], *b = &factors[second[start + i]][0][0];
            for (int at = 0; at < LINES * LINE; at += WIDTH)
                STORE(LOAD(a + at) * LOAD(b + at), &products[i][0][0] + at);
        }
        for (int pair = 0; pair < PAIRS; pair++)
            for (int v = 0; v < VECTORS; v++) {
                const float *here = &products[0][FIRST_ROW(pair)][v * WIDTH];
                const float last_y = FIRST_ROW(pair) + SIDE * STRIDE - REACH - ROWS / 2;
                vec sum[2][GROUP], below[2][GROUP];
#pragma unroll
                for (int i = 0; i < GROUP; i++)
                    sum[0][i] = sum[1][i] = below[0][i] = below[1][i] = (vec)(0.f);
#define ADD_PART(part, to)                                                                                             \
    if (start < with_y) {                                                                                              \
        add_part_by_rows(&taps[pair][v], part, here, sum, below);                                                      \
        for (int i = 0; i < GROUP && start + i < with_y; i++)                                                          \
            for (int which = 0; which < 2; which++)                                                                    \
                to[pair][v][moment_of_y[start + i]][which] = last_y * sum[which][i] - (float)STRIDE * below[which][i]; \
    } else                                                                                                             \
        add_part(&taps[pair][v], part, here, sum);                                                                     \
    for (int i = 0; i < GROUP && start + i < sums; i++)                                                                \
        for (int which = 0; which < 2; which++)                                                                        \
            to[pair][v][moment[start + i]][which] = sum[which][i];
#ifdef WITH_INNER
                ADD_PART(0, inside)
#endif
                ADD_PART(1, moments)
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
