/* Sums of many numbers, in which rounding does not add up. */
#ifndef MCDENOISE_KAHAN_H
#define MCDENOISE_KAHAN_H
#include "common.h"

/* Kahan's sum: `lost` is what rounding has added too much. */
inline void add_to(float *sum, float *lost, float value)
{
    const float term = value - *lost;
    const float next = *sum + term;
    *lost = (next - *sum) - term;
    *sum = next;
}

/* The same, a sum in each lane. */
inline void add_vector_to(vec *sum, vec *lost, vec value)
{
    const vec term = value - *lost;
    const vec next = *sum + term;
    *lost = (next - *sum) - term;
    *sum = next;
}

#endif
