/* exp and log for vectors on CPUs, whose runtimes take several times as long for the last bits; the runtime's own where
 * work-items are scalar. Minimax polynomials; relative errors below 3e-7, of exp(x) 8e-8 |x| more
 * (tests/test_fast_math.py). */
#ifndef MCDENOISE_FAST_MATH_H
#define MCDENOISE_FAST_MATH_H
#include "common.h"
#include "inline.h"

#if WIDTH == 1
INLINE vec fast_exp(vec x)
{
    return exp(x);
}

INLINE vec fast_log(vec x)
{
    return log(x);
}
#else
/* For x <= 88; 1 at 0; below -87 as there, 1.6e-38. Adding 1.5 * 2^23 rounds to whole numbers, kept in the lowest bits. */
INLINE vec fast_exp(vec x)
{
    const float rounding = 12582912.f;
    const vec power = larger(x, (vec)(-87.f)) * 1.44269504f, rounded = power + rounding;
    const vec f = power - (rounded - rounding);
    vec p = 1.32647271e-3f * f + 9.67151265e-3f;
    p = p * f + 5.55073374e-2f;
    p = p * f + 2.40222421e-1f;
    p = p * f + 6.93146978e-1f;
    p = p * f + 1.f;
    return JOIN(as_float, WIDTH)(AS_WHOLE(p) + (AS_WHOLE(rounded) << 23));
}

/* For normal x > 0; 0 at 1. x = m * 2^k with m from sqrt(1/2) to sqrt(2), 0x3f3504f3 being the bits of sqrt(1/2). */
INLINE vec fast_log(vec x)
{
    const whole bits = AS_WHOLE(x) - 0x3f3504f3, k = bits >> 23;
    const vec r = JOIN(as_float, WIDTH)((bits & 0x7fffff) + 0x3f3504f3) - 1.f;
    vec p = -1.00823773e-1f * r + 1.61805009e-1f;
    p = p * r - 1.72432249e-1f;
    p = p * r + 1.99068832e-1f;
    p = p * r - 2.49712285e-1f;
    p = p * r + 3.33347149e-1f;
    p = p * r - 5.00003234e-1f;
    return JOIN(convert_float, WIDTH)(k) * 6.93147181e-1f + (p * r * r + r);
}
#endif

/* x^e for x from 0 on and e > 0 */
INLINE vec fast_power(vec x, float e)
{
    return x > (vec)(0.f) ? fast_exp(e * fast_log(x)) : (vec)(0.f);
}

#endif
