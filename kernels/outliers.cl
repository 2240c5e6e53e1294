/* Outliers, and the energy that is taken from them.
 *
 * A pixel brighter than `limit` times the brightest of its eight neighbours is scaled down to that, hue and all.
 * What was removed is kept as an image, to be spread over the surroundings afterwards: fireflies are rare samples of
 * light that is really there, and without it a picture of few samples is too dark.
 */
#include "common.h"

/* Added to squared brightness. */
#define DARKEST2 1e-6f

/* Two planes: the brightest channel, and the variance of the channels together relative to its square. */
kernel void brightest(CONST_PLANES(color), CONST_PLANES(variance), int height, int width, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const vec most = larger(larger(VECTOR_AT(color, 0, y, x), VECTOR_AT(color, 1, y, x)), VECTOR_AT(color, 2, y, x));
    const vec sum = VECTOR_AT(variance, 0, y, x) + VECTOR_AT(variance, 1, y, x) + VECTOR_AT(variance, 2, y, x);
    STORE(most, out + INDEX(out, 0, y, x));
    STORE(sum / (most * most + DARKEST2), out + INDEX(out, 1, y, x));
}

/* In place: color becomes factor * color, variance factor^2 * variance; removed is what color has lost, factor what each
 * pixel was multiplied by. bright: from brightest, with a border of 1. What stands out of its neighbours by more than
 * `significant` standard deviations, its own or, if larger, `chance` times those usual in the 3x3 pixels, is really
 * there: a firefly, one sample in many, stands out by about one. */
kernel void hold_back(CONST_PLANES(bright), PLANES(color), PLANES(variance), int height, int width, float limit,
                      float significant, float chance, PLANES(factor), PLANES(removed))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    vec around = (vec)(0.f), usual = (vec)(0.f), sum = (vec)(0.f);
    for (int v = -1; v <= 1; v++)
        for (int u = -1; u <= 1; u++) {
            if (u != 0 || v != 0)
                around = larger(around, VECTOR_AT(bright, 0, y + v, x + u));
            usual += VECTOR_AT(bright, 1, y + v, x + u);
        }
    for (int c = 0; c < 3; c++)
        sum += VECTOR_AT(variance, c, y, x);
    const vec own = VECTOR_AT(bright, 0, y, x), bound = limit * around;
    const vec deviation = sqrt(larger(sum, chance * chance * usual / 9.f * (own * own + DARKEST2)));
    const vec f = own > bound && (own - around) / significant <= deviation ? bound / own : (vec)(1.f);
    STORE(f, factor + INDEX(factor, 0, y, x));
    for (int c = 0; c < 3; c++) {
        const vec before = VECTOR_AT(color, c, y, x), after = f * before;
        STORE(after, color + INDEX(color, c, y, x));
        STORE(before - after, removed + INDEX(removed, c, y, x));
        STORE(f * f * VECTOR_AT(variance, c, y, x), variance + INDEX(variance, c, y, x));
    }
}
