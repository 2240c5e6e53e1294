/* How far two guides differ: the planes of their features, and after them for each feature the sum of its channels'
 * variances.
 */
#ifndef MCDENOISE_MISMATCH_H
#define MCDENOISE_MISMATCH_H
#include "common.h"

#define GUIDE (CHANNELS + GROUPS)

/* What a difference is relative to besides its noise, squared: of albedo, of normals, of depth and of colour relative to
 * their own size. */
#define ALBEDO2 (0.05f * 0.05f)
#define NORMAL2 (0.1f * 0.1f)
#define DEPTH2 (0.05f * 0.05f)
#define COLOR2 (0.1f * 0.1f)

/* No difference counts for more. */
#define MOST 8.f

/* How far two guides differ beyond their noise, in units of noise and tolerance. A(c), B(c): plane c of either. */
#define SQUARE(x) ((x) * (x))
#define SQUARES3(A, B, c) (SQUARE(A(c) - B(c)) + SQUARE(A((c) + 1) - B((c) + 1)) + SQUARE(A((c) + 2) - B((c) + 2)))
#define EXCESS(squares, noise, tolerance) (((squares) - (noise)) / ((noise) + (tolerance)))
#define NOISE(A, B, g) (A(CHANNELS + (g)) + B(CHANNELS + (g)))
#ifdef ALBEDO
#define WITH_ALBEDO(A, B) +EXCESS(SQUARES3(A, B, ALBEDO), NOISE(A, B, ALBEDO_NOISE), ALBEDO2)
#else
#define WITH_ALBEDO(A, B)
#endif
#ifdef NORMAL
#define WITH_NORMAL(A, B) +EXCESS(SQUARES3(A, B, NORMAL), NOISE(A, B, NORMAL_NOISE), NORMAL2)
#else
#define WITH_NORMAL(A, B)
#endif
#ifdef DEPTH
#define DEPTHS(A, B) (fabs(A(DEPTH)) + fabs(B(DEPTH)))
#define WITH_DEPTH(A, B)                                                                                               \
    +EXCESS(SQUARE(A(DEPTH) - B(DEPTH)), NOISE(A, B, DEPTH_NOISE), DEPTH2 *SQUARE(DEPTHS(A, B)) + 1e-30f)
#else
#define WITH_DEPTH(A, B)
#endif
#ifdef COLOR
#define SIZE2(A) (A(COLOR) * A(COLOR) + A(COLOR + 1) * A(COLOR + 1) + A(COLOR + 2) * A(COLOR + 2))
#define WITH_COLOR(A, B)                                                                                               \
    +EXCESS(SQUARES3(A, B, COLOR), NOISE(A, B, COLOR_NOISE), COLOR2 *(SIZE2(A) + SIZE2(B)) + 1e-12f)
#else
#define WITH_COLOR(A, B)
#endif
#define MISMATCH(A, B) (0.f WITH_ALBEDO(A, B) WITH_NORMAL(A, B) WITH_DEPTH(A, B) WITH_COLOR(A, B))

#endif
