/* From the moments of a window to the value of its first-order fit, in any schedule.
 *
 * Terms are 1, x, y and the principal components of the features that the block of the pixel uses (terms.h).
 */
#ifndef MCDENOISE_FIRST_ORDER_H
#define MCDENOISE_FIRST_ORDER_H
#include "fit.h"
#include "terms.h"

#define SIDE (2 * SEARCH_RADIUS + 1)
#define INNER (SEARCH_RADIUS / 2)
#define REACH (SEARCH_RADIUS * STRIDE)
#define COMPONENT 3 /* the first */
#define TERMS (COMPONENT + FEATURES) /* at most */
#define COLOR_MOMENT(terms, k, a) (LOWER(terms, 0) + (k) * (terms) + (a))

/* The window is a disc: of offsets (dx, dy), in strides, those of a circle half a pixel wider than its radius. */
#define IN_DISC(dx, dy, radius) ((dx) * (dx) + (dy) * (dy) <= (radius) * ((radius) + 1))

/* Rounding is about 1e-6 of a squared distance; what varies less than this part of it cannot be told apart. */
#define ROUNDING 5e-5f
#define LEAST_RIDGE 1e-9f

/* What a component and a position add to their second moment, per unit of weight. variance: the component's in the
 * block; at: its value at the pixel, about the block's mean. Positions are in pixels, their ridge in spans of the
 * window. */
INLINE vec ridge_of_component(float variance, vec at)
{
    return ROUNDING * (variance + at * at) + LEAST_RIDGE;
}

INLINE float ridge_of_position(float position_ridge)
{
    return (position_ridge + LEAST_RIDGE) * max(REACH, 1) * max(REACH, 1);
}

/* M of the terms about the pixel, in place, gets its ridges: `least` (as above, times the sum of weights) and `ridge` of
 * a term's own second moment; of a feature's, though, and not of a component's: a direction in which features differ
 * little is to be damped as much as the features are. noise: what each feature adds besides, per unit of weight. */
INLINE void add_ridges(fits *m, int terms, const fits *least, float ridge
#if FEATURES > 0
                       , const float direction[FEATURES][FEATURES], const fits *noise
#endif
)
{
#if FEATURES > 0
    fits damping[FEATURES];
    for (int q = 0; q < FEATURES; q++) {
        fits moment;
        EACH moment.of[i] = (vec)(0.f);
        for (int a = COMPONENT; a < terms; a++) {
            fits row;
            EACH row.of[i] = 0.5f * direction[a - COMPONENT][q] * m[LOWER(a, a)].of[i];
            for (int b = COMPONENT; b < a; b++)
                EACH row.of[i] += direction[b - COMPONENT][q] * m[LOWER(a, b)].of[i];
            EACH moment.of[i] += direction[a - COMPONENT][q] * row.of[i];
        }
        EACH damping[q].of[i] = 2.f * ridge * larger(moment.of[i], (vec)(0.f)) + m[0].of[i] * noise[q].of[i];
    }
#endif
    for (int a = 1; a < terms; a++) {
        const float factor = a < COMPONENT ? 1.f + ridge : 1.f;
        EACH m[LOWER(a, a)].of[i] = larger(m[LOWER(a, a)].of[i], (vec)(0.f)) * factor + least[a].of[i];
    }
#if FEATURES > 0
    for (int q = 0; q < FEATURES; q++)
        for (int a = COMPONENT; a < terms; a++) {
            fits row;
            EACH row.of[i] = direction[a - COMPONENT][q] * damping[q].of[i];
            for (int b = COMPONENT; b <= a; b++)
                EACH m[LOWER(a, b)].of[i] += direction[b - COMPONENT][q] * row.of[i];
        }
#endif
}

/* Colours are fitted as differences from `base`, which is added again here: a fit reproduces a constant, and this way to
 * the last bit. A fit may overshoot below `darkest`, 0, where light cannot be; only a negative pixel may stay so. The
 * fourth colour is a difference of halves. color and out point at the pixel in the first plane of each. (No `restrict`
 * here: inlined, it becomes an intrinsic that some simulators lack.) */
INLINE void store_fit(const vec result[COLORS], const float base[COLORS], float darkest, global const float *color,
                      int color_plane, global float *out, int out_plane)
{
    for (int k = 0; k < COLORS; k++) {
        const vec value = base[k] + result[k], least = smaller(LOAD(color + k * color_plane), (vec)(darkest));
        STORE(k < 3 ? larger(value, least) : value, out + k * out_plane);
    }
}
#define STORE_FIT(result, base, y, x, out) \
    store_fit(result, base, darkest, stack + INDEX(stack, FEATURES, y, x), stack_plane, out + INDEX(out, 0, y, x), out##_plane)

#endif
