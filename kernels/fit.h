/* The normal equations of a linear fit, for a vector of pixels: Cholesky without pivots on the lower triangle, row by
 * row. */
#ifndef MCDENOISE_FIT_H
#define MCDENOISE_FIT_H
#include "common.h"

#define LOWER(a, b) ((a) * ((a) + 1) / 2 + (b)) /* b <= a */

/* L with M = L L^T, in place; the diagonal holds 1 / L_aa. least[a] > 0 is what was added to M_aa: no pivot can be
 * smaller but by rounding. */
inline void cholesky(vec *m, int terms, const vec *least)
{
    for (int a = 0; a < terms; a++)
        for (int b = 0; b <= a; b++) {
            vec sum = m[LOWER(a, b)];
            for (int q = 0; q < b; q++)
                sum -= m[LOWER(a, q)] * m[LOWER(b, q)];
            m[LOWER(a, b)] = a == b ? 1.f / sqrt(fmax(sum, least[a])) : sum * m[LOWER(b, b)];
        }
}

/* z with L L^T z = e_0 */
inline void solve_for_constant(const vec *m, int terms, vec *z)
{
    for (int a = 0; a < terms; a++) {
        vec sum = (vec)(a == 0 ? 1.f : 0.f);
        for (int q = 0; q < a; q++)
            sum -= m[LOWER(a, q)] * z[q];
        z[a] = sum * m[LOWER(a, a)];
    }
    for (int a = terms - 1; a >= 0; a--) {
        vec sum = z[a];
        for (int q = a + 1; q < terms; q++)
            sum -= m[LOWER(q, a)] * z[q];
        z[a] = sum * m[LOWER(a, a)];
    }
}

#endif
