/* The luminance of a pixel, and values relative to that of its surroundings. */
#ifndef MCDENOISE_LUMINANCE_H
#define MCDENOISE_LUMINANCE_H
#include "common.h"

#define LUMINANCE(p, y, x) luminance_at(p + INDEX(p, 0, y, x), p##_plane)
inline float luminance_at(global const float *p, int plane)
{
    return 0.2126f * p[0] + 0.7152f * p[plane] + 0.0722f * p[2 * plane];
}

/* The standard deviation of the luminance of noise that the channels share, from their variances. */
#define DEVIATION(p, y, x) deviation_at(p + INDEX(p, 0, y, x), p##_plane)
inline float deviation_at(global const float *p, int plane)
{
    return 0.2126f * sqrt(larger(p[0], 0.f)) + 0.7152f * sqrt(larger(p[plane], 0.f)) +
           0.0722f * sqrt(larger(p[2 * plane], 0.f));
}

#define VECTOR_LUMINANCE(p, y, x) luminance(VECTOR_AT(p, 0, y, x), VECTOR_AT(p, 1, y, x), VECTOR_AT(p, 2, y, x))

/* Noise and errors go with the square of the luminance, in exposed units, where the frame's log-average is 0.18. */
#define LEAST_LUMINANCE2 1e-3f

inline float square_of(float surroundings)
{
    return surroundings * surroundings + LEAST_LUMINANCE2;
}

inline float relative(float value, float surroundings)
{
    return value / square_of(surroundings);
}

#endif
