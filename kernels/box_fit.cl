/* Colours as a linear function of the features, fitted over uniform windows (He et al. 2010, with many guides).
 *
 * Around each block of BLOCK x BLOCK pixels, colour_k = z_k0 + sum_a z_ka f_a is fitted by weighted least squares. All
 * that a fit needs are means and covariances over its window, so they are taken over blocks once; box_fit_windows.cl
 * joins and solves them; box_fit_apply.cl brings the functions up to every pixel (He and Sun 2015).
 * Weights are those of relative errors: without them a window that holds something bright fits that alone, and is wrong
 * by its size in the dark.
 */
#include "blocks.h"

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
kernel void box_fit_blocks(CONST_PLANES(light), CONST_PLANES(color) SETS(feature)
#ifdef NOISE
                           SETS(noise)
#endif
                           , int height, int width, float relative, float noise_ridge, PLANES(out))
{
    const int x = get_global_id(0) * CHUNK, y = get_global_id(1);
    if (x * BLOCK >= width || y * BLOCK >= height)
        return;
    float lights[1][PIXELS][CHUNK], values[VARIABLES][PIXELS][CHUNK];
    GATHER(light, 1, lights);
    GATHER_SETS(feature, values);
    GATHER(color, 3, values + FEATURES);
#ifdef NOISE
    float noises[SLOPES][PIXELS][CHUNK];
    GATHER_SETS(noise, noises);
#endif
    for (int v = 0; v < CHUNK && (x + v) * BLOCK < width; v += WIDTH) {
        Group own;
        own.weight = (vec)(0.f);
#pragma unroll
        for (int i = 0; i < ROOM; i++)
            own.product[i] = (vec)(0.f);
        vec delta[VARIABLES][PIXELS], weight[PIXELS];
#pragma unroll
        for (int i = 0; i < PIXELS; i++) {
            const int column = (x + v) * BLOCK + i % BLOCK;
            weight[i] = relative_weight(LOAD(&lights[0][i][v]), relative);
            if (column + (WIDTH - 1) * BLOCK >= width)
                weight[i] *= present(column, width);
            if (y * BLOCK + i / BLOCK >= height)
                weight[i] = (vec)(0.f);
            own.weight += weight[i];
#pragma unroll
            for (int a = 0; a < VARIABLES; a++)
                delta[a][i] = LOAD(&values[a][i][v]);
#ifdef NOISE
#pragma unroll
            for (int a = 0; a < FEATURES; a++)
                own.product[PRODUCT(a, a)] += weight[i] * noise_ridge * LOAD(&noises[a][i][v]);
#endif
        }
        /* About the first pixel, then about the mean. */
        const vec scale = 1.f / own.weight;
#pragma unroll
        for (int a = 0; a < VARIABLES; a++) {
            vec sum = (vec)(0.f), reference = delta[a][0];
#pragma unroll
            for (int i = 0; i < PIXELS; i++) {
                delta[a][i] -= reference;
                sum += weight[i] * delta[a][i];
            }
            const vec mean = sum * scale;
            own.mean[a] = reference + mean;
#pragma unroll
            for (int i = 0; i < PIXELS; i++)
                delta[a][i] -= mean;
        }
#pragma unroll
        for (int a = 0; a < VARIABLES; a++) {
            vec weighted[PIXELS];
#pragma unroll
            for (int i = 0; i < PIXELS; i++)
                weighted[i] = weight[i] * delta[a][i];
#pragma unroll
            for (int b = 0; b < FEATURES && b <= a; b++)
#pragma unroll
                for (int i = 0; i < PIXELS; i++)
                    own.product[PRODUCT(a, b)] += weighted[i] * delta[b][i];
        }
        /* By name: as an array, some compilers (Mesa 22.3) find the first member in every place. */
        const int place = PLACE(x + v, QUANTITIES);
        STREAM(own.weight, out + INDEX(out, 0, y, place));
#pragma unroll
        for (int a = 0; a < VARIABLES; a++)
            STREAM(own.mean[a], out + INDEX(out, MEAN(a), y, place));
#pragma unroll
        for (int i = 0; i < PRODUCTS; i++)
            STREAM(own.product[i], out + INDEX(out, COVARIANCE(i), y, place));
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
            vec c[BLOCK], fit[BLOCK];
            TAKE(color, k, row, x * BLOCK, width, c);
            TAKE(fitted, k, row, x * BLOCK, width, fit);
            for (int i = 0; i < BLOCK; i++)
                values[i] = larger(BLEND(c[i], fit[i], noise[i]), smaller(c[i], (vec)(darkest)));
            GIVE(values, out, k, row, x * BLOCK, width);
        }
    }
}
