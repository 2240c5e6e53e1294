/* Outliers, and the energy that is taken from them.
 *
 * A pixel brighter than `limit` times the brightest of its eight neighbours is scaled down to that, hue and all. So is
 * one of a small group of fireflies, which hide each other: GROUP pixels that are CONTRAST times as bright as what else
 * there is in 5x5 pixels. What was removed is kept as an image, to be spread over the surroundings afterwards: fireflies
 * are rare samples of light that is really there, and without it a picture of few samples is too dark.
 */
#include "common.h"

/* A wire through 5x5 pixels, a corner or any other edge has more than four pixels. */
#define GROUP 4
#define CONTRAST 16.f

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
 * pixel was multiplied by. bright: from brightest, with a border of 2. What stands out of its neighbours by more than
 * `significant` standard deviations, its own or, if larger, `chance` times those usual in the 3x3 pixels, is really
 * there: a firefly, one sample in many, stands out by about one. Those of a group may stand out by `in_group`. */
kernel void hold_back(CONST_PLANES(bright), PLANES(color), PLANES(variance), int height, int width, float limit,
                      float significant, float in_group, float chance, PLANES(factor), PLANES(removed))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    vec around = (vec)(0.f), usual = (vec)(0.f), sum = (vec)(0.f);
    vec most[GROUP]; /* of the other 24 pixels, from the brightest */
    for (int i = 0; i < GROUP; i++)
        most[i] = (vec)(0.f);
    for (int v = -2; v <= 2; v++)
        for (int u = -2; u <= 2; u++) {
            const int near = abs(u) <= 1 && abs(v) <= 1;
            if (near)
                usual += VECTOR_AT(bright, 1, y + v, x + u);
            if (u == 0 && v == 0)
                continue;
            vec next = VECTOR_AT(bright, 0, y + v, x + u);
            if (near)
                around = larger(around, next);
            for (int i = 0; i < GROUP; i++) {
                const vec less = smaller(most[i], next);
                most[i] = larger(most[i], next);
                next = less;
            }
        }
    for (int c = 0; c < 3; c++)
        sum += VECTOR_AT(variance, c, y, x);
    const vec own = VECTOR_AT(bright, 0, y, x), others = most[GROUP - 1], one = (vec)(1.f);
    const vec deviation = sqrt(larger(sum, chance * chance * usual / 9.f * (own * own + DARKEST2)));
    const vec alone = own > limit * around && (own - around) / significant <= deviation ? limit * around / own : one;
    const vec grouped = own > CONTRAST * limit * others && own - others <= in_group * deviation ? limit * others / own : one;
    const vec f = smaller(alone, grouped);
    STORE(f, factor + INDEX(factor, 0, y, x));
    for (int c = 0; c < 3; c++) {
        const vec before = VECTOR_AT(color, c, y, x), after = f * before;
        STORE(after, color + INDEX(color, c, y, x));
        STORE(before - after, removed + INDEX(removed, c, y, x));
        STORE(f * f * VECTOR_AT(variance, c, y, x), variance + INDEX(variance, c, y, x));
    }
}
