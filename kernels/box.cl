/* Sums over (2 radius + 1)-wide windows at a cost that does not depend on the radius.
 *
 * A work-item slides a window down WIDTH columns: add the row that enters, take away the row that leaves. What
 * leaves must leave whole, or a bright light would haunt the pixels behind it, so the sum is kept with its
 * rounding error (Knuth's two-sum). The result is written transposed: two calls give the sum in both directions
 * and the image back upright.
 */
#include "two_sum.h"

/* The window's sum around row `first` of a column of a mirrored image. */
inline void fill(global const float *column, int row, int height, int first, int radius, vec *sum, vec *lost)
{
    *sum = *lost = (vec)(0.f);
    for (int k = -radius; k <= radius; k++)
        accumulate(sum, lost, LOAD(column + reflect(first + k, height) * row));
}

/* From the one around row y to the one below. */
inline void step(global const float *column, int row, int height, int y, int radius, vec *sum, vec *lost)
{
    accumulate(sum, lost, LOAD(column + reflect(y + radius + 1, height) * row));
    accumulate(sum, lost, -LOAD(column + reflect(y - radius, height) * row));
}

/* Rows `first` to `end`, to columns `first` to `end` of `out`. */
inline void transposed(global const float *column, int row, int height, int first, int end, int radius, float scale,
                       global float *out, int out_row)
{
    vec sum, lost;
    fill(column, row, height, first, radius, &sum, &lost);
    for (int y0 = first; y0 < end; y0 += WIDTH) {
        float block[WIDTH][WIDTH];
        for (int i = 0; i < WIDTH; i++) {
            STORE(mean_of_sum(sum, lost, 2 * radius + 1, scale), block[i]);
            step(column, row, height, min(y0 + i, height - 1), radius, &sum, &lost); /* past the end all goes unused */
        }
        for (int j = 0; j < WIDTH; j++) {
            float line[WIDTH];
            for (int i = 0; i < WIDTH; i++)
                line[i] = block[i][j];
            STORE(LOAD(line), out + j * out_row + y0);
        }
    }
}

/* Columns of `in` and rows of `out` are readable and writable up to the next multiple of WIDTH. */
kernel void box_transposed(CONST_PLANES(in), int height, PLANES(out), int radius, int rows_each, float scale)
{
    const int x = get_global_id(0) * WIDTH, first = get_global_id(1) * rows_each, c = get_global_id(2);
    transposed(in + INDEX(in, c, 0, x), in_row, height, first, min(first + rows_each, height), radius, scale,
               out + INDEX(out, c, x, 0), out_row);
}

/* Three times, for images so small that a work-item takes columns as a whole. */
kernel void box_thrice_transposed(CONST_PLANES(in), int height, PLANES(once), PLANES(twice), PLANES(out), int radius,
                                  float scale)
{
    const int x = get_global_id(0) * WIDTH, c = get_global_id(1);
    global const float *from = in + INDEX(in, c, 0, x);
    int row = in_row;
    for (int i = 0; i < 2; i++) {
        global float *to = i == 0 ? once + INDEX(once, c, 0, x) : twice + INDEX(twice, c, 0, x);
        const int to_row = i == 0 ? once_row : twice_row;
        vec sum, lost;
        fill(from, row, height, 0, radius, &sum, &lost);
        for (int y = 0; y < height; y++) {
            STORE(mean_of_sum(sum, lost, 2 * radius + 1, scale), to + y * to_row);
            step(from, row, height, y, radius, &sum, &lost);
        }
        from = to;
        row = to_row;
    }
    transposed(from, row, height, 0, height, radius, scale, out + INDEX(out, c, x, 0), out_row);
}
