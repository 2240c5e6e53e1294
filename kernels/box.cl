/* Sums over (2 radius + 1)-wide windows at a cost that does not depend on the radius.
 *
 * A work-item slides a window down WIDTH columns: add the row that enters, take away the row that leaves. What
 * leaves must leave whole, or a bright light would haunt the pixels behind it, so the sum is kept with its
 * rounding error (Knuth's two-sum). The result is written transposed: two calls give the sum in both directions
 * and the image back upright.
 */
#include "two_sum.h"

/* Columns of `in` and rows of `out` are readable and writable up to the next multiple of WIDTH. */
kernel void box_transposed(CONST_PLANES(in), int height, PLANES(out), int radius, int rows_each, float scale)
{
    const int x = get_global_id(0) * WIDTH, first = get_global_id(1) * rows_each, c = get_global_id(2);
    global const float *column = in + INDEX(in, c, 0, x);
    vec sum = (vec)(0.f), lost = (vec)(0.f);
    for (int k = -radius; k <= radius; k++)
        accumulate(&sum, &lost, LOAD(column + reflect(first + k, height) * in_row));
    const int end = min(first + rows_each, height);
    for (int y0 = first; y0 < end; y0 += WIDTH) {
        float block[WIDTH][WIDTH];
        for (int i = 0; i < WIDTH; i++) {
            STORE(mean_of_sum(sum, lost, 2 * radius + 1, scale), block[i]);
            const int y = min(y0 + i, height - 1); /* past the end the value goes unused */
            accumulate(&sum, &lost, LOAD(column + reflect(y + radius + 1, height) * in_row));
            accumulate(&sum, &lost, -LOAD(column + reflect(y - radius, height) * in_row));
        }
        for (int j = 0; j < WIDTH; j++) {
            float line[WIDTH];
            for (int i = 0; i < WIDTH; i++)
                line[i] = block[i][j];
            STORE(LOAD(line), out + INDEX(out, c, x + j, y0));
        }
    }
}
