/* How alike two patches are, given how noisy they are: the arithmetic of a pixel and of a patch, in any schedule. */
#ifndef MCDENOISE_WEIGHT_H
#define MCDENOISE_WEIGHT_H
#include "common.h"
#include "inline.h"

#define PATCH (2 * PATCH_RADIUS + 1)
#define INNER_RADIUS (PATCH_RADIUS / 2)
#define INNER_PATCH (2 * INNER_RADIUS + 1)
#define LEAST_VARIANCE 1e-12f

/* How far two pixels differ beyond what their noise explains, in units of that noise (Rousselle et al. 2012, with the
 * channels taken together: one division). squares: sum over the channels of the squared differences; here, there: sums
 * of their variances. */
INLINE vec excess_of_noise(vec squares, vec here, vec there)
{
    return (squares - (here + smaller(here, there))) / (here + there + LEAST_VARIANCE);
}

/* (1 - d / 4)^4 where exp(-d) would do as well: it ends, and costs four operations. -d / 4 is scale * distance. */
INLINE vec falloff(vec distance, float scale)
{
    const vec t = BOUNDED(scale * distance + (vec)(1.f), (vec)(0.f), (vec)(1.f)), t2 = t * t;
    return t2 * t2;
}

/* Mean of falloff(scale * distance) for the distances of a patch and of its inner half, the means of the excess over
 * each: a wide patch tells noise from structure, a narrow one follows edges, and their errors differ. */
INLINE vec weight_of_sums(vec wide, vec narrow, float scale)
{
    const float norm = scale / (PATCH * PATCH), inner_norm = scale / (INNER_PATCH * INNER_PATCH);
    return 0.5f * (falloff(wide, norm) + falloff(narrow, inner_norm));
}

#endif
