/* Half the difference of two independent halves of a frame, in luminance: colour + difference and colour - difference
 * are then two noisy frames whose errors have nothing to do with each other. */
#include "common.h"

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

inline uint scrambled(uint v)
{
    v ^= v >> 16;
    v *= 0x7feb352dU;
    v ^= v >> 15;
    v *= 0x846ca68bU;
    return v ^ v >> 16;
}

/* They are not: a normal random number of the variance that the pixel has. c + n and c - n have twice the noise of c
 * and no covariance, since n has the variance of c (Oliveira et al. 2021). The channels share their noise, as those of
 * a path do. The same pixel of a frame, of which
 * these planes begin with row `first`, always gets the same number. */
kernel void difference_from_variance(CONST_PLANES(variance), int height, int width, int first, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const uint one = scrambled(2 * ((first + y) * 65536 + x) + 1), two = scrambled(one + 0x9e3779b9U);
    const float radius = sqrt(-2.f * log(((one >> 8) + 0.5f) / 16777216.f));
    const float normal = radius * cospi(2.f * ((two >> 8) + 0.5f) / 16777216.f);
    const float deviation = 0.2126f * sqrt(larger(AT(variance, 0, y, x), 0.f)) + 0.7152f * sqrt(larger(AT(variance, 1, y, x), 0.f)) +
                            0.0722f * sqrt(larger(AT(variance, 2, y, x), 0.f));
    AT(out, 0, y, x) = normal * deviation;
}
