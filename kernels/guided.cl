/* Guided filter with a one-channel guide (He et al. 2010; Yang 2022, eqs. 1-3), as three steps between box means.
 *
 * All planes are shifted by a constant of their own first (`references`: of the guide, then of each channel), so that
 * mean(xy) - mean(x) mean(y) does not cancel when a feature is a small ripple on a large offset.
 */
#include "common.h"

/* The values of the middle pixel. */
kernel void guided_references(CONST_PLANES(guide), CONST_PLANES(image), int channels, int height, int width,
                              global float *restrict references)
{
    references[0] = AT(guide, 0, height / 2, width / 2);
    for (int c = 0; c < channels; c++)
        references[1 + c] = AT(image, c, height / 2, width / 2);
}

#define GUIDE_SHIFTED (AT(guide, 0, y, x) - references[0])

/* out: I, I^2, then F_c and I F_c of every channel c */
kernel void guided_products(CONST_PLANES(guide), CONST_PLANES(image), int channels, int height, int width,
                            global const float *restrict references, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float g = GUIDE_SHIFTED;
    AT(out, 0, y, x) = g;
    AT(out, 1, y, x) = g * g;
    for (int c = 0; c < channels; c++) {
        const float f = AT(image, c, y, x) - references[1 + c];
        AT(out, 2 + 2 * c, y, x) = f;
        AT(out, 3 + 2 * c, y, x) = g * f;
    }
}

/* eqs. 2 and 3; out: a_c and b_c of every channel c */
kernel void guided_coefficients(CONST_PLANES(means), int channels, int height, int width, float epsilon,
                                PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float mean = AT(means, 0, y, x);
    const float variance = larger(AT(means, 1, y, x) - mean * mean, 0.f);
    for (int c = 0; c < channels; c++) {
        const float mean_f = AT(means, 2 + 2 * c, y, x);
        const float a = (AT(means, 3 + 2 * c, y, x) - mean * mean_f) / (variance + epsilon);
        AT(out, 2 * c, y, x) = a;
        AT(out, 2 * c + 1, y, x) = mean_f - a * mean;
    }
}

/* eq. 1, with the means of a and b over every window that a pixel lies in */
kernel void guided_apply(CONST_PLANES(coefficients), CONST_PLANES(guide), CONST_PLANES(image), int channels,
                         int height, int width, global const float *restrict references, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float g = GUIDE_SHIFTED;
    for (int c = 0; c < channels; c++)
        AT(out, c, y, x) = AT(coefficients, 2 * c, y, x) * g + AT(coefficients, 2 * c + 1, y, x) +
                           references[1 + c];
}
