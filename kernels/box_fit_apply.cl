/* Functions of blocks (box_fit_windows.cl), averaged over windows and interpolated, of each pixel's own features. In
 * bundles the averages are taken here, row by row as the pixels need them; else box_mean has taken them before.
 */
#include "blocks.h"

#define COEFFICIENTS (3 * TERMS)

#ifdef BUNDLED
/* The means over the windows of a row of blocks, CHUNK columns from `left` on and one to each side; differences from the
 * middle are summed, down columns first, as box_direct.cl does. Place 0 is column left - WIDTH. */
inline void window_means(CONST_PLANES(fit), int y, int left, int height, int width, float out[COEFFICIENTS][LINE])
{
    float line[COEFFICIENTS][LINE];
    const float scale = 1.f / SIDE;
    for (int place = 0; place < LINE; place += WIDTH) {
        const int x = min(max(left - WIDTH + place, 0), (width - 1) / WIDTH * WIDTH);
        global const float *row[SIDE];
        for (int k = 0; k < SIDE; k++)
            row[k] = fit + INDEX(fit, 0, reflect(y + k - RADIUS, height), PLACE(x, COEFFICIENTS));
        for (int a = 0; a < COEFFICIENTS; a++) {
            const vec middle = LOAD(row[RADIUS] + a * WIDTH);
            vec sum = (vec)(0.f);
#pragma unroll
            for (int k = 0; k < SIDE; k++)
                if (k != RADIUS)
                    sum += LOAD(row[k] + a * WIDTH) - middle;
            STORE(middle + sum * scale, line[a] + place);
        }
    }
    mirror_ends(line[0], COEFFICIENTS, left - WIDTH, RADIUS, width);
    for (int a = 0; a < COEFFICIENTS; a++)
        for (int wanted = WIDTH - 1; wanted <= WIDTH + CHUNK; wanted += WIDTH) {
            const int place = min(wanted, LINE - WIDTH - RADIUS);
            const vec middle = LOAD(line[a] + place);
            vec sum = (vec)(0.f);
#pragma unroll
            for (int k = -RADIUS; k <= RADIUS; k++)
                if (k != 0)
                    sum += LOAD(line[a] + place + k) - middle;
            STORE(middle + sum * scale, out[a] + place);
        }
    mirror_ends(out[0], COEFFICIENTS, left - WIDTH, 1, width);
}

/* `between_rows` of blocks.h, of rows that are here. */
inline void between_lines(const float *above, const float *below, float down, vec out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = BLEND(LOAD(above + i - 1), LOAD(below + i - 1), down);
}
#endif

/* A work-item does CHUNK columns of ROWS rows of blocks. left: over each block, what sum w |c - out|^2 is and what noise
 * alone, of this variance, would make it. */
kernel void box_fit_apply(CONST_PLANES(fit), CONST_PLANES(light), CONST_PLANES(color), CONST_PLANES(variance)
                          SETS(feature), int height, int width, float relative, PLANES(out), PLANES(left))
{
    const int x = get_global_id(0) * CHUNK, top = get_global_id(1) * ROWS;
    const int high = (height + BLOCK - 1) / BLOCK, wide = (width + BLOCK - 1) / BLOCK;
    if (x >= wide || top >= high)
        return;
#ifdef BUNDLED
    float means[3][COEFFICIENTS][LINE]; /* of rows y - 1, y and y + 1, each in place of the one three before */
    window_means(fit, fit_origin, fit_row, fit_plane, reflect(top - 1, high), x, high, wide, means[0]);
    window_means(fit, fit_origin, fit_row, fit_plane, top, x, high, wide, means[1]);
#endif
    for (int y = top; y < min(top + ROWS, high); y++) {
#ifdef BUNDLED
        window_means(fit, fit_origin, fit_row, fit_plane, reflect(y + 1, high), x, high, wide, means[(y - top + 2) % 3]);
#endif
        float lights[1][PIXELS][CHUNK], colors[3][PIXELS][CHUNK], variances[3][PIXELS][CHUNK];
        GATHER(light, 1, lights);
        GATHER(color, 3, colors);
        GATHER(variance, 3, variances);
        float features[SLOPES][PIXELS][CHUNK];
        GATHER_SETS(feature, features);
        for (int v = 0; v < CHUNK && x + v < wide; v += WIDTH) {
            vec squares = (vec)(0.f), expected = (vec)(0.f);
#pragma unroll
            for (int j = 0; j < BLOCK; j++) {
                const int row = y * BLOCK + j;
                if (j > 0 && row >= height) /* the first one is there, in blocks of one row for compilers to see */
                    break;
                int above, before;
                const float down = between(j, &above);
#ifdef BUNDLED
                const float *upper = means[(y - top + 1 + above) % 3][0] + WIDTH + v;
                const float *lower = means[(y - top + 2 + above) % 3][0] + WIDTH + v;
#else
                const int upper = reflect(y + above, high) * fit_row, lower = reflect(y + above + 1, high) * fit_row;
#endif
                vec values[3][BLOCK];
                for (int k = 0; k < 3; k++)
                    for (int a = 0; a < TERMS; a++) {
                        const int q = k * TERMS + a;
                        vec function[3];
#ifdef BUNDLED
                        between_lines(upper + q * LINE, lower + q * LINE, down, function);
#else
                        between_rows(fit + INDEX(fit, q, 0, 0), upper, lower, down, x + v, wide, function);
#endif
#pragma unroll
                        for (int i = 0; i < BLOCK; i++) {
                            const float across = between(i, &before);
                            const vec factor = across_columns(function, before, across);
                            if (a == 0)
                                values[k][i] = factor;
                            else
                                values[k][i] += LOAD(&features[a - 1][j * BLOCK + i][v]) * factor;
                        }
                    }
                for (int i = 0; i < BLOCK; i++) {
                    const int column = (x + v) * BLOCK + i;
                    vec weight = relative_weight(LOAD(&lights[0][j * BLOCK + i][v]), relative);
                    if (column + (WIDTH - 1) * BLOCK >= width)
                        weight *= present(column, width);
                    for (int k = 0; k < 3; k++) {
                        const vec rest = LOAD(&colors[k][j * BLOCK + i][v]) - values[k][i];
                        squares += weight * rest * rest;
                        expected += weight * LOAD(&variances[k][j * BLOCK + i][v]);
                    }
                }
                for (int k = 0; k < 3; k++)
                    GIVE(values[k], out, k, row, (x + v) * BLOCK, width);
            }
            STORE(squares, left + INDEX(left, 0, y, x + v));
            STORE(expected, left + INDEX(left, 1, y, x + v));
        }
    }
}
