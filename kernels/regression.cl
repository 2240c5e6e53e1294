/* First-order regression (Bitterli et al. 2016; Moon et al. 2014), weighted by NLM.
 *
 * Around each pixel i the colour is modelled as a linear function of terms t_j - t_i (features and position), fitted by
 * weighted least squares over the search window, and the constant of that function is the result: with M = sum w t t^T
 * and R = sum w t c^T it is z^T R, where M z = e_0, one solve for any number of colours.
 *
 * A work-item fits a whole tile. First the weights, offset by offset, as patches are shared between neighbours. Then
 * the moments, GROUP of them at a time: a product of two terms is the same for every pixel whose window holds it, so a
 * wide tile makes it once, and a moment is a plain weighted sum that stays in a register. Terms are taken about the
 * mean of the block (terms.cl), and the moments moved to the pixel at the end; what rounding then leaves is small
 * against the ridge, which grows with the distance between the two.
 */
#include "fit.h"
#include "patch.h"

#define SIDE (2 * SEARCH_RADIUS + 1)
#define INNER (SEARCH_RADIUS / 2)
#define REACH (SEARCH_RADIUS * STRIDE)
#define TERMS (1 + FEATURES + 2) /* at most */
#define GROUP 8
#define MOMENTS ((LOWER(TERMS, 0) + TERMS * COLORS + GROUP - 1) / GROUP * GROUP)
#define LINES (ROWS + 2 * REACH)
#define LINE (((COLUMNS + 2 * REACH + WIDTH - 1) / WIDTH) * WIDTH)

/* Rounding is about 1e-6 of a squared distance; what varies less than this part of it cannot be told apart. */
#define ROUNDING 5e-5f
#define LEAST_RIDGE 1e-9f

/* What is summed: terms, then colours, each about its mean. */
typedef struct {
    int plane; /* of the stack: 1, features, position, colours */
    float mean, variance;
} Term;

/* One moment: the product of two of them. */
typedef struct {
    global const float *a, *b;
    float mean_a, mean_b;
} Product;

#define PRODUCT_AT(p, i) ((LOAD((p).a + (i)) - (p).mean_a) * (LOAD((p).b + (i)) - (p).mean_b))

/* sum[i] += weights times products, over a rectangle of offsets counted from the window's corner. A tile reads its
 * products from `shared`, a single pixel makes them. */
inline void add_taps(const float weights[SIDE * SIDE][ROWS][COLUMNS],
#if COLUMNS > 1
                     const float shared[GROUP][LINES][LINE],
#else
                     const Product *products, int stack_row,
#endif
                     int r, int c, int top, int bottom, int left, int right, vec sum[GROUP])
{
    for (int dy = top; dy <= bottom; dy++)
        for (int dx = left; dx <= right; dx++) {
            const vec weight = LOAD(&weights[dy * SIDE + dx][r][c]);
#pragma unroll
            for (int i = 0; i < GROUP; i++)
#if COLUMNS > 1
                sum[i] += weight * LOAD(&shared[i][r + dy * STRIDE][c + dx * STRIDE]);
#else
                sum[i] += weight * PRODUCT_AT(products[i], (r + dy * STRIDE) * stack_row + c + dx * STRIDE);
#endif
        }
}

/* The fit of one vector of pixels from its moments. at: the terms there, about their means; ridges: what each adds to
 * its second moment, per unit of weight. */
inline void fit(const float moments[MOMENTS][ROWS][COLUMNS], int r, int c, int terms, const vec *at, const vec *ridges,
                float ridge, vec result[COLORS])
{
    vec m[LOWER(TERMS, 0)], z[TERMS], least[TERMS];
    for (int i = 0; i < LOWER(terms, 0); i++)
        m[i] = LOAD(&moments[i][r][c]);
    const vec total = m[0];
    least[0] = total;
    for (int a = 1; a < terms; a++)
        for (int b = 1; b <= a; b++)
            m[LOWER(a, b)] += at[a] * at[b] * total - at[a] * m[LOWER(b, 0)] - at[b] * m[LOWER(a, 0)];
    for (int a = 1; a < terms; a++) {
        least[a] = total * ridges[a];
        m[LOWER(a, 0)] -= at[a] * total;
        m[LOWER(a, a)] = fmax(m[LOWER(a, a)], (vec)(0.f)) * (1.f + ridge) + least[a];
    }
    cholesky(m, terms, least);
    solve_for_constant(m, terms, z);
    for (int a = 1; a < terms; a++)
        z[0] -= at[a] * z[a];
    for (int k = 0; k < COLORS; k++) {
        vec sum = (vec)(0.f);
        for (int a = 0; a < terms; a++)
            sum += z[a] * LOAD(&moments[LOWER(terms, 0) + k * terms + a][r][c]);
        result[k] = sum;
    }
}

/* A fit may overshoot below 0, where light cannot be; only a negative pixel may stay so. The fourth colour is a
 * difference of halves. */
inline void store_fit(const vec result[COLORS], CONST_PLANES(stack), int y, int x, PLANES(out))
{
    for (int k = 0; k < COLORS; k++) {
        const vec least = fmin(VECTOR_AT(stack, TERMS + k, y, x), (vec)(0.f));
        STORE(k < 3 ? fmax(result[k], least) : result[k], out + INDEX(out, k, y, x));
    }
}
#define STORE_FIT(y, x, out) store_fit(result, stack, stack_origin, stack_row, stack_plane, y, x, out, out##_origin, out##_row, out##_plane)

/* tone: three planes, variance: one (the sum of theirs), both with a border of REACH + patch radius. stack: 1, FEATURES
 * features, x, y and COLORS colours, border REACH. noise: variances of the features. blocks: from terms.cl. */
kernel void regress(CONST_PLANES(tone), CONST_PLANES(variance), CONST_PLANES(stack),
#if FEATURES > 0
                    CONST_PLANES(noise), global const float *restrict blocks, int blocks_across,
#endif
                    int height, int width, float bandwidth, float ridge, float noise_ridge, float position_ridge,
#ifdef WITH_INNER
                    PLANES(inner),
#endif
                    PLANES(out))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    float weights[SIDE * SIDE][ROWS][COLUMNS];
    global const float *t = tone + INDEX(tone, 0, y, x);
    global const float *s = variance + INDEX(variance, 0, y, x);
    for (int o = 0; o < SIDE * SIDE; o++) {
        const int dy = (o / SIDE - SEARCH_RADIUS) * STRIDE, dx = (o % SIDE - SEARCH_RADIUS) * STRIDE;
        vec weight[ROWS][VECTORS];
        patch_weights(t, t + dy * tone_row + dx, tone_row, tone_plane, s, s + dy * variance_row + dx, variance_row,
                      -0.25f / (bandwidth * bandwidth), weight);
        for (int r = 0; r < ROWS; r++)
            for (int v = 0; v < VECTORS; v++)
                STORE(weight[r][v], &weights[o][r][v * WIDTH]);
    }

    Term terms[TERMS + COLORS];
    int count = 0;
    terms[count++] = (Term){0, 0.f, 0.f};
#if FEATURES > 0
    global const float *block = blocks + 2 * FEATURES * (y / BLOCK_ROWS * blocks_across + x / BLOCK_COLUMNS);
    for (int q = 0; q < FEATURES; q++)
        if (block[2 * q + 1] > 0.f)
            terms[count++] = (Term){1 + q, block[2 * q], block[2 * q + 1]};
#endif
    const int features_end = count;
    terms[count++] = (Term){1 + FEATURES, x + COLUMNS / 2, 0.f};
    terms[count++] = (Term){2 + FEATURES, y + ROWS / 2, 0.f};
    for (int k = 0; k < COLORS; k++)
        terms[count + k] = (Term){TERMS + k, 0.f, 0.f};

    uchar first[MOMENTS], second[MOMENTS];
    int total = 0;
    for (int a = 0; a < count; a++)
        for (int b = 0; b <= a; b++)
            first[total] = a, second[total++] = b;
    for (int k = 0; k < COLORS; k++)
        for (int a = 0; a < count; a++)
            first[total] = a, second[total++] = count + k;
    for (; total % GROUP; total++)
        first[total] = second[total] = 0;

    float moments[MOMENTS][ROWS][COLUMNS];
#ifdef WITH_INNER
    float inside[MOMENTS][ROWS][COLUMNS];
#endif
    global const float *corner = stack + INDEX(stack, 0, y - REACH, x - REACH);
    for (int start = 0; start < total; start += GROUP) {
        Product products[GROUP];
        for (int i = 0; i < GROUP; i++) {
            const Term a = terms[first[start + i]], b = terms[second[start + i]];
            products[i] = (Product){corner + a.plane * stack_plane, corner + b.plane * stack_plane, a.mean, b.mean};
        }
#if COLUMNS > 1
        float shared[GROUP][LINES][LINE];
        for (int i = 0; i < GROUP; i++)
            for (int line = 0; line < LINES; line++)
                for (int c = 0; c < LINE; c += WIDTH)
                    STORE(PRODUCT_AT(products[i], line * stack_row + c), &shared[i][line][c]);
#define ADD_TAPS(top, bottom, left, right) add_taps(weights, shared, r, c, top, bottom, left, right, sum)
#else
#define ADD_TAPS(top, bottom, left, right) add_taps(weights, products, stack_row, r, c, top, bottom, left, right, sum)
#endif
        for (int r = 0; r < ROWS; r++)
            for (int c = 0; c < COLUMNS; c += WIDTH) {
                vec sum[GROUP];
#pragma unroll
                for (int i = 0; i < GROUP; i++)
                    sum[i] = (vec)(0.f);
#ifdef WITH_INNER
                const int low = SEARCH_RADIUS - INNER, high = SEARCH_RADIUS + INNER, last = SIDE - 1;
                ADD_TAPS(low, high, low, high);
                for (int i = 0; i < GROUP; i++)
                    STORE(sum[i], &inside[start + i][r][c]);
                ADD_TAPS(0, low - 1, 0, last);
                ADD_TAPS(low, high, 0, low - 1);
                ADD_TAPS(low, high, high + 1, last);
                ADD_TAPS(high + 1, last, 0, last);
#else
                ADD_TAPS(0, SIDE - 1, 0, SIDE - 1);
#endif
                for (int i = 0; i < GROUP; i++)
                    STORE(sum[i], &moments[start + i][r][c]);
            }
    }

    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int c = 0; c < COLUMNS; c += WIDTH) {
            vec at[TERMS], ridges[TERMS], result[COLORS];
            for (int a = 1; a < count; a++) {
                at[a] = VECTOR_AT(stack, terms[a].plane, y + r, x + c) - terms[a].mean;
                ridges[a] = (vec)((position_ridge + LEAST_RIDGE) * max(REACH, 1) * max(REACH, 1));
#if FEATURES > 0
                if (a < features_end)
                    ridges[a] = noise_ridge * VECTOR_AT(noise, terms[a].plane - 1, y + r, x + c) +
                                ROUNDING * (terms[a].variance + at[a] * at[a]) + LEAST_RIDGE;
#endif
            }
            fit(moments, r, c, count, at, ridges, ridge, result);
            STORE_FIT(y + r, x + c, out);
#ifdef WITH_INNER
            fit(inside, r, c, count, at, ridges, ridge, result);
            STORE_FIT(y + r, x + c, inner);
#endif
        }
}
