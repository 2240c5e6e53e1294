/* From the distance and the SSIM of two patches to the weight of one in the other's mean (Yang 2022, eqs. 5, 7 and 8):
 * the arithmetic of a pair of patches, in any schedule. */
#ifndef MCDENOISE_SIMILARITY_H
#define MCDENOISE_SIMILARITY_H
#include "common.h"
#include "inline.h"

/* Patch statistics, as planes: STAT(c, kind) is the plane of channel c. */
#define MEAN 0
#define VARIANCE 1
#define STAT(c, kind) (3 * (kind) + (c))

/* Keeps SSIM away from 0, so that the logarithm of eq. 8 stays finite. */
#define LEAST_SSIM 1e-6f

/* The weight of i itself: 1 (d = 0), or the largest of the others, and then at least LEAST_WEIGHT: a pixel that
 * nothing resembles, such as a small lamp, stays as it is (from 1e-20 to 1e-2 the errors measured are the same). */
#define CENTER_ONE 0
#define LEAST_WEIGHT 1e-4f

INLINE vec center_weight(int center, vec most)
{
    return center == CENTER_ONE ? (vec)(1.f) : larger(most, (vec)(LEAST_WEIGHT));
}

/* What a squared difference summed over three channels is multiplied by in the exponent of eq. 5. */
INLINE float exponent_scale(float h_factor, float noise_level)
{
    const float h = larger(h_factor * noise_level, 1e-6f);
    return -1.f / (3.f * h * h);
}

/* 1 - SSIM of two patches of one channel (Wang et al. 2004; Yang 2022, eq. 7, with C3 = C2 / 2):
 *   luminance = 1 - (mu_x - mu_y)^2 / (mu_x^2 + mu_y^2 + C1)
 *   contrast * structure = 1 - var(x - y) / (var_x + var_y + C2)
 * Differences first: equal patches give exactly 0, where the textbook form leaves rounding noise for the
 * logarithm of eq. 8 to magnify.
 */
INLINE vec dissimilarity(vec mean_x, vec mean_y, vec variance_x, vec variance_y, vec spread, float c1, float c2)
{
    const vec step = mean_x - mean_y;
    const vec step2 = step * step;
    const vec luminance_scale = mean_x * mean_x + mean_y * mean_y + c1;
    const vec structure_scale = variance_x + variance_y + c2;
    return (step2 * (structure_scale - spread) + spread * luminance_scale) / (luminance_scale * structure_scale);
}

/* SSIM of two patches from the sum of `dissimilarity` over three channels. */
INLINE vec ssim_of_channels(vec sum)
{
    return BOUNDED((vec)(1.f) - sum * (1.f / 3.f), (vec)(LEAST_SSIM), (vec)(1.f));
}

#endif
