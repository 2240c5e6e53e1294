/* The noise level of an image, from itself: Immerkaer, Fast Noise Variance Estimation, 1996.
 *
 * sigma of a channel = sqrt(pi/2) / 6 * mean |image * M|, where M, the difference of two Laplacians, is blind
 * to constants and slopes; channels are joined as the root of the mean square.
 */
#include "kahan.h"

/* What counts of a pixel's response at most: sums over any frame stay finite, of light that does not as well. */
#define MOST_RESPONSE 1e30f

/* Rows from `first` on, which are rows from `to` on of a frame of `rows`; one work-item each. */
kernel void laplacian_rows(CONST_PLANES(in), int height, int width, int first, int to, int rows,
                           global float *restrict row_sum)
{
    const int y = first + get_global_id(0), c = get_global_id(1);
    if (y >= height)
        return;
    const int up = reflect(y - 1, height), down = reflect(y + 1, height);
    /* A row's ends have a mirrored neighbour; between them a vector at a time. */
    vec sum = (vec)(0.f), lost = (vec)(0.f);
    float row = 0.f, lost_of_row = 0.f;
    for (int x = 0; x < width;) {
        const bool inside = x > 0 && x + WIDTH < width;
        if (inside) {
            vec corners = (vec)(0.f), sides = (vec)(0.f);
            const vec centre = VECTOR_AT(in, c, y, x);
            for (int side = -1; side <= 1; side += 2) {
                corners += (VECTOR_AT(in, c, up, x + side) - centre) + (VECTOR_AT(in, c, down, x + side) - centre);
                sides += VECTOR_AT(in, c, y, x + side) - centre;
            }
            sides += (VECTOR_AT(in, c, up, x) - centre) + (VECTOR_AT(in, c, down, x) - centre);
            add_vector_to(&sum, &lost, smaller(fabs(corners - 2.f * sides), (vec)(MOST_RESPONSE)));
        } else {
            const int left = reflect(x - 1, width), right = reflect(x + 1, width);
            const float centre = AT(in, c, y, x);
            const float corners = (AT(in, c, up, left) - centre) + (AT(in, c, up, right) - centre) +
                                  (AT(in, c, down, left) - centre) + (AT(in, c, down, right) - centre);
            const float sides = (AT(in, c, up, x) - centre) + (AT(in, c, down, x) - centre) +
                                (AT(in, c, y, left) - centre) + (AT(in, c, y, right) - centre);
            add_to(&row, &lost_of_row, smaller(fabs(corners - 2.f * sides), MOST_RESPONSE));
        }
        x += inside ? WIDTH : 1;
    }
    float lanes[WIDTH];
    STORE(sum, lanes);
    for (int i = 0; i < WIDTH; i++)
        add_to(&row, &lost_of_row, lanes[i]);
    row_sum[c * rows + to + get_global_id(0)] = row;
}

kernel void noise_from_rows(global const float *restrict row_sum, int channels, int height, int width,
                            global float *restrict level)
{
    float squares = 0.f, largest = 0.f; /* squares relative to the largest, which alone might be infinite */
    for (int c = 0; c < channels; c++) {
        float sum = 0.f, lost = 0.f;
        for (int y = 0; y < height; y++)
            add_to(&sum, &lost, row_sum[c * height + y]);
        const float sigma = 0.20888568955f * sum / ((float)height * width); /* sqrt(pi / 2) / 6 */
        const float before = largest;
        largest = fmax(largest, sigma);
        if (largest > 0.f) {
            const float shrunk = before / largest, own = sigma / largest;
            squares = squares * shrunk * shrunk + own * own;
        }
    }
    level[0] = largest * sqrt(squares / channels);
}
