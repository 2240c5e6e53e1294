/* Means over small windows, summed as they are: for these that is less work than to slide a window, and both directions
 * take one pass over memory. A work-item filters a tile. Values are summed as differences from the middle one, so the mean
 * of equal values is that value to the last bit.
 */
#include "common.h"

#define LINE (COLUMNS + 2 * RADIUS)

/* Columns of `in` are readable up to the next multiple of COLUMNS, those of `out` writable. */
kernel void box_direct(CONST_PLANES(in), int height, int width, PLANES(out), float scale)
{
    const int x = get_global_id(0) * COLUMNS, top = get_global_id(1) * ROWS, c = get_global_id(2);
    const int readable = (width + COLUMNS - 1) / COLUMNS * COLUMNS;
    const int first = max(x - RADIUS, 0), end = min(x + COLUMNS + RADIUS, width);
    for (int y = top; y < min(top + ROWS, height); y++) {
        /* Place 0 is column x - RADIUS. */
        float means[LINE + WIDTH];
        global const float *line[2 * RADIUS + 1];
#pragma unroll
        for (int k = 0; k <= 2 * RADIUS; k++)
            line[k] = in + INDEX(in, c, reflect(y + k - RADIUS, height), 0);
        for (int column = first; column < end; column += WIDTH) {
            const int from = min(column, readable - WIDTH);
            const vec middle = LOAD(line[RADIUS] + from);
            vec sum = (vec)(0.f);
#pragma unroll
            for (int k = 0; k <= 2 * RADIUS; k++)
                if (k != RADIUS)
                    sum += LOAD(line[k] + from) - middle;
            STORE(middle + sum * scale, means + from - x + RADIUS);
        }
        for (int column = x - RADIUS; column < 0; column++)
            means[column - x + RADIUS] = means[reflect(column, width) - x + RADIUS];
        for (int column = width; column < x + COLUMNS + RADIUS; column++)
            means[column - x + RADIUS] = means[max(reflect(column, width) - x + RADIUS, 0)];
        for (int i = 0; i < COLUMNS; i += WIDTH) {
            const vec middle = LOAD(means + i + RADIUS);
            vec sum = (vec)(0.f);
#pragma unroll
            for (int k = 0; k <= 2 * RADIUS; k++)
                if (k != RADIUS)
                    sum += LOAD(means + i + k) - middle;
            STREAM(middle + sum * scale, out + INDEX(out, c, y, x + i));
        }
    }
}
