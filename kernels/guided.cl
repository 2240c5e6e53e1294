/* Guided filter with a one-channel guide (He et al. 2010; Yang 2022, eqs. 1-3), as three steps between box means.
 *
 * All planes are shifted by a constant of their own first (`reference`, the value of the middle pixel), so that
 * mean(xy) - mean(x) mean(y) does not cancel when a feature is a small ripple on a large offset.
 */
#include "common.h"

inline float shifted(CONST_PLANES(p), int c, int y, int x, int height, int width)
{
    return AT(p, c, y, x) - AT(p, c, height / 2, width / 2);
}
#define SHIFTED(p, c) shifted(p, p##_origin, p##_row, p##_plane, c, y, x, height, width)

/* out: I, I^2, then F_c and I F_c of every channel c */
kernel void guided_products(CONST_PLANES(guide), CONST_PLANES(image), int channels, int height, int width,
                            PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float g = SHIFTED(guide, 0);
    AT(out, 0, y, x) = g;
    AT(out, 1, y, x) = g * g;
    for (int c = 0; c < channels; c++) {
        const float f = SHIFTED(image, c);
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
    const float variance = fmax(AT(means, 1, y, x) - mean * mean, 0.f);
    for (int c = 0; c < channels; c++) {
        const float mean_f = AT(means, 2 + 2 * c, y, x);
        const float a = (AT(means, 3 + 2 * c, y, x) - mean * mean_f) / (variance + epsilon);
        AT(out, 2 * c, y, x) = a;
        AT(out, 2 * c + 1, y, x) = mean_f - a * mean;
    }
}

/* eq. 1, with the means of a and b over every window that a pixel lies in */
kernel void guided_apply(CONST_PLANES(coefficients), CONST_PLANES(guide), CONST_PLANES(image), int channels,
                         int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float g = SHIFTED(guide, 0);
    for (int c = 0; c < channels; c++)
        AT(out, c, y, x) = AT(coefficients, 2 * c, y, x) * g + AT(coefficients, 2 * c + 1, y, x) +
                           AT(image, c, height / 2, width / 2);
}
