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

/* Of the 24 other pixels in 5x5, the GROUP-th brightest. */
inline vec last_of_brightest(CONST_PLANES(bright), int y, int x)
{
    vec most[GROUP]; /* from the brightest */
    for (int i = 0; i < GROUP; i++)
        most[i] = (vec)(0.f);
    for (int v = -2; v <= 2; v++)
        for (int u = -2; u <= 2; u++) {
            vec next = u == 0 && v == 0 ? (vec)(0.f) : VECTOR_AT(bright, 0, y + v, x + u);
            for (int i = 0; i < GROUP; i++) {
                const vec less = smaller(most[i], next);
                most[i] = larger(most[i], next);
                next = less;
            }
        }
    return most[GROUP - 1];
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
    vec around = (vec)(0.f), usual = (vec)(0.f), sum = (vec)(0.f), part[GROUP];
    for (int i = 0; i < GROUP; i++)
        part[i] = (vec)(0.f);
#pragma unroll
    for (int v = -2; v <= 2; v++)
#pragma unroll
        for (int u = -2; u <= 2; u++) {
            const int near = abs(u) <= 1 && abs(v) <= 1, i = (5 * v + u + 12) % GROUP;
            if (near)
                usual += VECTOR_AT(bright, 1, y + v, x + u);
            if (u == 0 && v == 0)
                continue;
            const vec next = VECTOR_AT(bright, 0, y + v, x + u);
            if (near)
                around = larger(around, next);
            part[i] = larger(part[i], next);
        }
    for (int c = 0; c < 3; c++)
        sum += VECTOR_AT(variance, c, y, x);
    const vec own = VECTOR_AT(bright, 0, y, x), one = (vec)(1.f);
    /* The least of what GROUP parts of the 24 have for their brightest is no brighter than the last of a group. */
    vec others = part[0];
    for (int i = 1; i < GROUP; i++)
        others = smaller(others, part[i]);
    if (ANY(own > CONTRAST * limit * others))
        others = last_of_brightest(bright, bright_origin, bright_row, bright_plane, y, x);
    const vec deviation = sqrt(larger(sum, chance * chance * usual / 9.f * (own * own + DARKEST2)));
    const vec alone = own > limit * around && (own - around) / significant <= deviation ? limit * around / own : one;
    const vec grouped = own > CONTRAST * limit * others && own - others <= in_group * deviation ? limit * others / own : one;
    const vec f = smaller(alone, grouped);
    STORE(f, factor + INDEX(factor, 0, y, x));
    for (int c = 0; c < 3; c++) {
        const vec before = VECTOR_AT(color, c, y, x), after = f * before;
        STORE(after, color + INDEX(color, c, y, x));
        STREAM(before - after, removed + INDEX(removed, c, y, x));
        STORE(f * f * VECTOR_AT(variance, c, y, x), variance + INDEX(variance, c, y, x));
    }
}
