/* The normal equations of a linear fit, for several pixels at once: Cholesky without pivots on the lower triangle, row by
 * row. */
#ifndef MCDENOISE_FIT_H
#define MCDENOISE_FIT_H
#include "common.h"
#include "inline.h"

#define LOWER(a, b) ((a) * ((a) + 1) / 2 + (b)) /* b <= a */

/* Each step waits for the one before, so a CPU fits two vectors of pixels at once: one's steps fill the gaps in the
 * other's. */
#ifndef FITS
#define FITS 1
#endif
#define EACH for (int i = 0; i < FITS; i++)
typedef struct {
    vec of[FITS];
} fits;

/* L with M = L L^T, in place; the diagonal holds 1 / L_aa. least[a] > 0 is what was added to M_aa: no pivot can be
 * smaller but by rounding. */
INLINE void cholesky(fits *m, int terms, const fits *least)
{
    for (int a = 0; a < terms; a++)
        for (int b = 0; b <= a; b++) {
            fits sum = m[LOWER(a, b)];
            for (int q = 0; q < b; q++)
                EACH sum.of[i] -= m[LOWER(a, q)].of[i] * m[LOWER(b, q)].of[i];
            if (a == b)
                EACH m[LOWER(a, a)].of[i] = 1.f / sqrt(larger(sum.of[i], least[a].of[i]));
            else
                EACH m[LOWER(a, b)].of[i] = sum.of[i] * m[LOWER(b, b)].of[i];
        }
}

/* z with L L^T z = e_0 */
INLINE void solve_for_constant(const fits *m, int terms, fits *z)
{
    for (int a = 0; a < terms; a++) {
        fits sum;
        EACH sum.of[i] = (vec)(a == 0 ? 1.f : 0.f);
        for (int q = 0; q < a; q++)
            EACH sum.of[i] -= m[LOWER(a, q)].of[i] * z[q].of[i];
        EACH z[a].of[i] = sum.of[i] * m[LOWER(a, a)].of[i];
    }
    for (int a = terms - 1; a >= 0; a--) {
        fits sum = z[a];
        for (int q = a + 1; q < terms; q++)
            EACH sum.of[i] -= m[LOWER(q, a)].of[i] * z[q].of[i];
        EACH z[a].of[i] = sum.of[i] * m[LOWER(a, a)].of[i];
    }
}

#endif
