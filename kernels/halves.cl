/* Half the difference of two independent halves of a frame, in luminance: colour + difference and colour - difference
 * are then two noisy frames whose errors have nothing to do with each other. */
#include "luminance.h"
#include "normal.h"

/* The halves are there. factor: one plane, what outliers were scaled by. */
kernel void difference_of_halves(CONST_PLANES(a), CONST_PLANES(b), CONST_PLANES(factor), int height, int width,
                                 PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float red = AT(a, 0, y, x) - AT(b, 0, y, x), green = AT(a, 1, y, x) - AT(b, 1, y, x);
    const float blue = AT(a, 2, y, x) - AT(b, 2, y, x);
    AT(out, 0, y, x) = 0.5f * AT(factor, 0, y, x) * (0.2126f * red + 0.7152f * green + 0.0722f * blue);
}

/* They are not: a normal random number of the variance that the pixel has. c + n and c - n have twice the noise of c
 * and no covariance, since n has the variance of c (Oliveira et al. 2021). The channels share their noise, as those of
 * a path do. The planes begin with row `first` of the frame. */
kernel void difference_from_variance(CONST_PLANES(variance), int height, int width, int first, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    AT(out, 0, y, x) = normal_number(first + y, x) * DEVIATION(variance, y, x);
}
