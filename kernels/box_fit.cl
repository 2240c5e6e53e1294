/* Colours as a linear function of the features, fitted over uniform windows (He et al. 2010, with many guides).
 *
 * Around each block of BLOCK x BLOCK pixels, colour_k = z_k0 + sum_a z_ka f_a is fitted by weighted least squares. All
 * that a fit needs are means and covariances over its window, so they are taken over blocks once; box_fit_windows.cl
 * joins and solves them; the functions are brought up to every pixel and applied to its own features (He and Sun 2015).
 * Weights are those of relative errors: without them a window that holds something bright fits that alone, and is wrong
 * by its size in the dark.
 */
#include "fast_math.h"
#include "groups.h"

#define PIXELS (BLOCK * BLOCK)

/* In exposed units: below the one, errors count alike; the other keeps weights within float32. */
#define DARKEST 0.02f
#define BRIGHTEST 1e5f

/* 1 / (l + DARKEST)^relative */
inline vec relative_weight(vec light, float relative)
{
    return fast_exp(-relative * fast_log(BOUNDED(light, (vec)(0.f), (vec)(BRIGHTEST)) + DARKEST));
}

/* Every BLOCK-th value of a row of n, WIDTH of them from x on; past the end the last one again. */
inline vec every(global const float *row, int x, int n)
{
#if BLOCK == 2 && WIDTH == 4
    if (x + 8 <= n)
        return vload8(0, row + x).even;
#elif BLOCK == 2 && WIDTH == 8
    if (x + 16 <= n)
        return (float8)(vload8(0, row + x).even, vload8(0, row + x + 8).even);
#elif BLOCK == 2 && WIDTH == 16
    if (x + 32 <= n)
        return (float16)(LOAD(row + x).even, LOAD(row + x + 16).even);
#endif
    float line[WIDTH];
    for (int i = 0; i < WIDTH; i++)
        line[i] = row[min(x + i * BLOCK, n - 1)];
    return LOAD(line);
}
#define EVERY(p, c, y, x, n) every(p + INDEX(p, c, y, 0), x, n)

/* What a work-item needs of a set of planes, CHUNK blocks from x on, by pixel of a block. Plane by plane: all of them
 * at once are more streams than a processor can foresee. Past the bottom the last row again. */
inline void gather(CONST_PLANES(in), int planes, int y, int x, int height, int width, float out[][PIXELS][CHUNK])
{
    for (int c = 0; c < planes; c++)
        for (int i = 0; i < PIXELS; i++) {
            const int row = min(y * BLOCK + i / BLOCK, height - 1);
            for (int v = 0; v < CHUNK && (x + v) * BLOCK < width; v += WIDTH)
                STORE(EVERY(in, c, row, (x + v) * BLOCK + i % BLOCK, width), &out[c][i][v]);
        }
}
#define GATHER(p, planes, out) gather(p, p##_origin, p##_row, p##_plane, planes, y, x, height, width, out)

/* The opposite of BLOCK of them, those of phase i from x + i on: nothing past the end. */
inline void spread(const vec values[BLOCK], global float *row, int x, int n)
{
#if BLOCK == 2 && WIDTH > 1
    if (x + 2 * WIDTH <= n) {
        vec low, high;
        low.even = values[0].lo;
        low.odd = values[1].lo;
        high.even = values[0].hi;
        high.odd = values[1].hi;
        STORE(low, row + x);
        STORE(high, row + x + WIDTH);
        return;
    }
#endif
    for (int phase = 0; phase < BLOCK; phase++) {
        float line[WIDTH];
        STORE(values[phase], line);
        for (int i = 0; i < WIDTH && x + phase + i * BLOCK < n; i++)
            row[x + phase + i * BLOCK] = line[i];
    }
}
#define SPREAD(values, p, c, y, x, n) spread(values, p + INDEX(p, c, y, 0), x, n)

/* Where the pixels of phase i of their blocks lie between blocks: from `before` (in blocks, from their own), this far
 * to the next. */
inline float between(int i, int *before)
{
    const float at = (i + 0.5f) / BLOCK - 0.5f;
    *before = at < 0.f ? -1 : 0;
    return at - *before;
}

/* A plane of blocks between two rows, at the columns x - 1, x and x + 1: what `across` interpolates between. */
inline void between_rows(global const float *plane, int top, int bottom, float down, int x, int n, vec out[3])
{
    for (int i = 0; i < 3; i++) {
        const vec above = mirrored(plane + top, x + i - 1, n), below = mirrored(plane + bottom, x + i - 1, n);
        out[i] = BLEND(above, below, down);
    }
}

inline vec across_columns(const vec v[3], int before, float across)
{
    return BLEND(v[1 + before], v[2 + before], across);
}

/* 1 for the pixels that are there, of WIDTH that are BLOCK apart. */
inline vec present(int x, int n)
{
    float line[WIDTH];
    for (int i = 0; i < WIDTH; i++)
        line[i] = x + i * BLOCK < n;
    return LOAD(line);
}

kernel void box_fit_luminance(CONST_PLANES(color), int height, int width, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    STORE(luminance(VECTOR_AT(color, 0, y, x), VECTOR_AT(color, 1, y, x), VECTOR_AT(color, 2, y, x)),
          out + INDEX(out, 0, y, x));
}

/* light: luminance around each pixel. out: a group for each block; those at the far edges hold the pixels there are.
 * The noise of a feature counts as spread of its own. */
kernel void box_fit_blocks(CONST_PLANES(light), CONST_PLANES(color),
#if FEATURES > 0
                           CONST_PLANES(feature),
#endif
#ifdef NOISE
                           CONST_PLANES(noise),
#endif
                           int height, int width, float relative, float noise_ridge, PLANES(out))
{
    const int x = get_global_id(0) * CHUNK, y = get_global_id(1);
    if (x * BLOCK >= width || y * BLOCK >= height)
        return;
    float lights[1][PIXELS][CHUNK], values[VARIABLES][PIXELS][CHUNK];
    GATHER(light, 1, lights);
#if FEATURES > 0
    GATHER(feature, FEATURES, values);
#endif
    GATHER(color, 3, values + FEATURES);
#ifdef NOISE
    float noises[SLOPES][PIXELS][CHUNK];
    GATHER(noise, FEATURES, noises);
#endif
    for (int v = 0; v < CHUNK && (x + v) * BLOCK < width; v += WIDTH) {
        Group own;
        own.weight = (vec)(0.f);
        for (int i = 0; i < ROOM; i++)
            own.product[i] = (vec)(0.f);
        vec delta[VARIABLES][PIXELS], weight[PIXELS];
        for (int i = 0; i < PIXELS; i++) {
            const int column = (x + v) * BLOCK + i % BLOCK;
            weight[i] = relative_weight(LOAD(&lights[0][i][v]), relative);
            if (column + (WIDTH - 1) * BLOCK >= width)
                weight[i] *= present(column, width);
            if (y * BLOCK + i / BLOCK >= height)
                weight[i] = (vec)(0.f);
            own.weight += weight[i];
            for (int a = 0; a < VARIABLES; a++)
                delta[a][i] = LOAD(&values[a][i][v]);
#ifdef NOISE
            for (int a = 0; a < FEATURES; a++)
                own.product[PRODUCT(a, a)] += weight[i] * noise_ridge * LOAD(&noises[a][i][v]);
#endif
        }
        /* About the first pixel, then about the mean. */
        const vec scale = 1.f / own.weight;
        for (int a = 0; a < VARIABLES; a++) {
            vec sum = (vec)(0.f), reference = delta[a][0];
            for (int i = 0; i < PIXELS; i++) {
                delta[a][i] -= reference;
                sum += weight[i] * delta[a][i];
            }
            const vec mean = sum * scale;
            own.mean[a] = reference + mean;
            for (int i = 0; i < PIXELS; i++)
                delta[a][i] -= mean;
        }
        for (int a = 0; a < VARIABLES; a++) {
            vec weighted[PIXELS];
            for (int i = 0; i < PIXELS; i++)
                weighted[i] = weight[i] * delta[a][i];
            for (int b = 0; b < FEATURES && b <= a; b++)
                for (int i = 0; i < PIXELS; i++)
                    own.product[PRODUCT(a, b)] += weighted[i] * delta[b][i];
        }
        STORE(own.weight, out + INDEX(out, 0, y, x + v));
        for (int a = 0; a < VARIABLES; a++)
            STORE(own.mean[a], out + INDEX(out, MEAN(a), y, x + v));
        for (int i = 0; i < PRODUCTS; i++)
            STORE(own.product[i], out + INDEX(out, COVARIANCE(i), y, x + v));
    }
}

/* out: the functions, interpolated between blocks, of the pixel's own features. left: over each block, what sum w |c -
 * out|^2 is and what noise alone, of this variance, would make it. */
kernel void box_fit_apply(CONST_PLANES(fit), CONST_PLANES(light), CONST_PLANES(color), CONST_PLANES(variance),
#if FEATURES > 0
                          CONST_PLANES(feature),
#endif
                          int height, int width, float relative, PLANES(out), PLANES(left))
{
    const int x = get_global_id(0) * CHUNK, y = get_global_id(1);
    if (x * BLOCK >= width || y * BLOCK >= height)
        return;
    float lights[1][PIXELS][CHUNK], colors[3][PIXELS][CHUNK], variances[3][PIXELS][CHUNK];
    GATHER(light, 1, lights);
    GATHER(color, 3, colors);
    GATHER(variance, 3, variances);
#if FEATURES > 0
    float features[FEATURES][PIXELS][CHUNK];
    GATHER(feature, FEATURES, features);
#endif
    const int high = (height + BLOCK - 1) / BLOCK, wide = (width + BLOCK - 1) / BLOCK;
    for (int v = 0; v < CHUNK && (x + v) * BLOCK < width; v += WIDTH) {
        vec squares = (vec)(0.f), expected = (vec)(0.f);
        for (int j = 0; j < BLOCK && y * BLOCK + j < height; j++) {
            int above, before;
            const float down = between(j, &above);
            const int row = y * BLOCK + j;
            const int top = reflect(y + above, high) * fit_row, bottom = reflect(y + above + 1, high) * fit_row;
            vec functions[3 * TERMS][3];
            for (int a = 0; a < 3 * TERMS; a++)
                between_rows(fit + INDEX(fit, a, 0, 0), top, bottom, down, x + v, wide, functions[a]);
            vec values[3][BLOCK];
            for (int i = 0; i < BLOCK; i++) {
                const float across = between(i, &before);
                const int column = (x + v) * BLOCK + i;
                vec weight = relative_weight(LOAD(&lights[0][j * BLOCK + i][v]), relative);
                if (column + (WIDTH - 1) * BLOCK >= width)
                    weight *= present(column, width);
                vec term[TERMS];
#if FEATURES > 0
                for (int a = 1; a < TERMS; a++)
                    term[a] = LOAD(&features[a - 1][j * BLOCK + i][v]);
#endif
                for (int k = 0; k < 3; k++) {
                    vec value = across_columns(functions[k * TERMS], before, across);
                    for (int a = 1; a < TERMS; a++)
                        value += term[a] * across_columns(functions[k * TERMS + a], before, across);
                    values[k][i] = value;
                    const vec rest = LOAD(&colors[k][j * BLOCK + i][v]) - value;
                    squares += weight * rest * rest;
                    expected += weight * LOAD(&variances[k][j * BLOCK + i][v]);
                }
            }
            for (int k = 0; k < 3; k++)
                SPREAD(values[k], out, k, row, (x + v) * BLOCK, width);
        }
        STORE(squares, left + INDEX(left, 0, y, x + v));
        STORE(expected, left + INDEX(left, 1, y, x + v));
    }
}

/* The share of the residual that noise explains; left: as above, over windows. */
kernel void box_fit_share(CONST_PLANES(left), int height, int width, float noise, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const vec squares = VECTOR_AT(left, 0, y, x), expected = VECTOR_AT(left, 1, y, x);
    STORE(smaller(noise * expected / larger(squares, (vec)(1e-30f)), (vec)(1.f)), out + INDEX(out, 0, y, x));
}

/* Of the residual only that share is removed. A fit may overshoot below `darkest`, 0, where light cannot be; only a
 * negative pixel may stay so. */
kernel void box_fit_restore(CONST_PLANES(share), CONST_PLANES(color), CONST_PLANES(fitted), int height, int width,
                            float darkest, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x * BLOCK >= width || y * BLOCK >= height)
        return;
    const int high = (height + BLOCK - 1) / BLOCK, wide = (width + BLOCK - 1) / BLOCK;
    for (int j = 0; j < BLOCK && y * BLOCK + j < height; j++) {
        int above, before;
        const float down = between(j, &above);
        const int row = y * BLOCK + j;
        const int top = reflect(y + above, high) * share_row, bottom = reflect(y + above + 1, high) * share_row;
        vec shares[3];
        between_rows(share + INDEX(share, 0, 0, 0), top, bottom, down, x, wide, shares);
        vec noise[BLOCK], values[BLOCK];
        for (int i = 0; i < BLOCK; i++) {
            const float across = between(i, &before);
            noise[i] = across_columns(shares, before, across);
        }
        for (int k = 0; k < 3; k++) {
            for (int i = 0; i < BLOCK; i++) {
                const int column = x * BLOCK + i;
                const vec c = EVERY(color, k, row, column, width), value = EVERY(fitted, k, row, column, width);
                values[i] = larger(BLEND(c, value, noise[i]), smaller(c, (vec)(darkest)));
            }
            SPREAD(values, out, k, row, x * BLOCK, width);
        }
    }
}
