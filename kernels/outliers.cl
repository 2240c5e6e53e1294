/* Outliers, and the energy that is taken from them.
 *
 * A pixel brighter than `limit` times the brightest of its eight neighbours is scaled down to that, hue and all.
 * What was removed is kept as an image, to be spread over the surroundings afterwards: fireflies are rare samples of
 * light that is really there, and without it a picture of few samples is too dark.
 */
#include "common.h"

inline float brightest(CONST_PLANES(color), int y, int x)
{
    return fmax(fmax(AT(color, 0, y, x), AT(color, 1, y, x)), AT(color, 2, y, x));
}
#define BRIGHTEST(y, x) brightest(color, color_origin, color_row, color_plane, y, x)

/* factor: one plane, what each pixel is multiplied by. What stands out of its neighbours by more than `significant` of
 * its own standard deviations is really there: a firefly, one sample in many, stands out by about one. */
kernel void outlier_factor(CONST_PLANES(color), CONST_PLANES(variance), int height, int width, float limit,
                           float significant, PLANES(factor))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const int up = reflect(y - 1, height), down = reflect(y + 1, height);
    const int left = reflect(x - 1, width), right = reflect(x + 1, width);
    float most = fmax(fmax(BRIGHTEST(up, left), BRIGHTEST(up, x)), BRIGHTEST(up, right));
    most = fmax(most, fmax(BRIGHTEST(y, left), BRIGHTEST(y, right)));
    most = fmax(most, fmax(fmax(BRIGHTEST(down, left), BRIGHTEST(down, x)), BRIGHTEST(down, right)));
    const float own = BRIGHTEST(y, x), around = fmax(most, 0.f), bound = limit * around;
    const float deviation = sqrt(fmax(AT(variance, 0, y, x) + AT(variance, 1, y, x) + AT(variance, 2, y, x), 0.f));
    const bool outlier = own > bound && (own - around) / significant <= deviation;
    AT(factor, 0, y, x) = outlier ? bound / own : 1.f;
}

/* in place: color becomes factor * color, removed what is missing, variance factor^2 * variance */
kernel void apply_factor(CONST_PLANES(factor), PLANES(color), PLANES(variance), int height, int width, PLANES(removed))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float f = AT(factor, 0, y, x);
    for (int c = 0; c < 3; c++) {
        const float before = AT(color, c, y, x), after = f * before;
        AT(color, c, y, x) = after;
        AT(removed, c, y, x) = before - after;
        AT(variance, c, y, x) *= f * f;
    }
}

/* The removed energy, blurred, goes back: half of it evenly, half in proportion to the brightness. */
kernel void add_evenly(CONST_PLANES(image), CONST_PLANES(removed), int height, int width, PLANES(out), PLANES(gray))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    float sum = 0.f;
    for (int c = 0; c < 3; c++) {
        const float value = AT(image, c, y, x) + 0.5f * AT(removed, c, y, x);
        AT(out, c, y, x) = value;
        sum += value;
    }
    AT(gray, 0, y, x) = sum / 3.f;
}

kernel void add_in_proportion(CONST_PLANES(image), CONST_PLANES(removed), CONST_PLANES(gray), int height, int width,
                              PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float mean = (AT(removed, 0, y, x) + AT(removed, 1, y, x) + AT(removed, 2, y, x)) / 3.f;
    /* at most half as much again, whatever a fit has left of the surroundings */
    const float gain = 1.f + 0.5f * mean / fmax(fmax(AT(gray, 0, y, x), mean), 1e-9f);
    for (int c = 0; c < 3; c++)
        AT(out, c, y, x) = AT(image, c, y, x) * gain;
}
