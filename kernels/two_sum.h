/* A sum that keeps its rounding error beside it (Knuth's two-sum), so that what is taken away again leaves nothing
 * behind. The value is sum + lost. Must not be compiled with relaxed floating point. */
#ifndef MCDENOISE_TWO_SUM_H
#define MCDENOISE_TWO_SUM_H
#include "common.h"
#include "inline.h"

INLINE void accumulate(vec *sum, vec *lost, vec term)
{
    const vec next = *sum + term;
    const vec part = next - *sum;
    *lost += (*sum - (next - part)) + (term - part);
    *sum = next;
}

/* The sum over `count`, `scale` being 1 / count rounded: with one step of Newton's, so that the mean of equal values is
 * that value to the last bit. */
INLINE vec mean_of_sum(vec sum, vec lost, float count, float scale)
{
    const vec mean = (sum + lost) * scale;
    return mean + (fma((vec)(-count), mean, sum) + lost) * scale;
}

#endif
