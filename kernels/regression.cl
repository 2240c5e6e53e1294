/* First-order regression on the features (Bitterli et al. 2016; Moon et al. 2014), weighted by NLM.
 *
 * Around each pixel i the colour is modelled as a linear function of t = (1, f_j - f_i, position), fitted by weighted
 * least squares over the search window, and the value of that function at i is the result. Terms are taken about the
 * centre, so it is the constant of the fit: with M = sum w t t^T and R = sum w t c^T it is z^T R, where M z = e_0, one
 * solve for any number of colours.
 *
 * A work-item first finds the weights of a whole tile, offset by offset, as patches are shared between neighbours;
 * then it adds up the normal equations vector by vector, where the moments stay in registers or next to them.
 */
#include "patch.h"

#define SIDE (2 * SEARCH_RADIUS + 1)
#define TERMS (1 + FEATURES + 2)
#define LOWER(a, b) ((a) * ((a) + 1) / 2 + (b)) /* b <= a */
#define MOMENTS LOWER(TERMS, 0)

/* L with M = L L^T, in place; the diagonal holds 1 / L_aa. */
inline void cholesky(vec m[MOMENTS])
{
    for (int a = 0; a < TERMS; a++)
        for (int b = 0; b <= a; b++) {
            vec sum = m[LOWER(a, b)];
            for (int q = 0; q < b; q++)
                sum -= m[LOWER(a, q)] * m[LOWER(b, q)];
            m[LOWER(a, b)] = a == b ? 1.f / sqrt(fmax(sum, (vec)(1e-20f))) : sum * m[LOWER(b, b)];
        }
}

/* z with L L^T z = e_0 */
inline void solve_for_constant(const vec m[MOMENTS], vec z[TERMS])
{
    for (int a = 0; a < TERMS; a++) {
        vec sum = (vec)(a == 0 ? 1.f : 0.f);
        for (int q = 0; q < a; q++)
            sum -= m[LOWER(a, q)] * z[q];
        z[a] = sum * m[LOWER(a, a)];
    }
    for (int a = TERMS - 1; a >= 0; a--) {
        vec sum = z[a];
        for (int q = a + 1; q < TERMS; q++)
            sum -= m[LOWER(q, a)] * z[q];
        z[a] = sum * m[LOWER(a, a)];
    }
}

/* tone and variance (3 planes each): where patches are compared, borders of search radius + patch radius.
 * feature and color: border of search radius. noise: variance of the features. */
kernel void regress(CONST_PLANES(tone), CONST_PLANES(variance),
#if FEATURES > 0
                    CONST_PLANES(feature), CONST_PLANES(noise),
#endif
                    CONST_PLANES(color), int height, int width, float bandwidth, float ridge, float noise_ridge,
                    float position_ridge, PLANES(out))
{
    const int x = get_global_id(0) * COLUMNS, y = get_global_id(1) * ROWS;
    float weights[SIDE * SIDE][ROWS][COLUMNS];
    global const float *t = tone + INDEX(tone, 0, y, x);
    global const float *s = variance + INDEX(variance, 0, y, x);
    const float scale = -1.f / (bandwidth * bandwidth);
    for (int o = 0; o < SIDE * SIDE; o++) {
        const int dy = o / SIDE - SEARCH_RADIUS, dx = o % SIDE - SEARCH_RADIUS;
        vec weight[ROWS][VECTORS];
        patch_weights(t, t + dy * tone_row + dx, tone_row, tone_plane, s, s + dy * variance_row + dx, variance_row,
                      variance_plane, scale, weight);
        for (int r = 0; r < ROWS; r++)
            for (int v = 0; v < VECTORS; v++)
                STORE(weight[r][v], &weights[o][r][v * WIDTH]);
    }
    const float step = 1.f / max(SEARCH_RADIUS, 1);
    for (int r = 0; r < ROWS && y + r < height; r++)
        for (int v = 0; v < VECTORS; v++) {
            vec m[MOMENTS], rhs[TERMS][3], term[TERMS], z[TERMS];
            for (int i = 0; i < MOMENTS; i++)
                m[i] = (vec)(0.f);
            for (int a = 0; a < TERMS; a++)
                rhs[a][0] = rhs[a][1] = rhs[a][2] = (vec)(0.f);
            global const float *c = color + INDEX(color, 0, y + r, x + v * WIDTH);
#if FEATURES > 0
            global const float *f = feature + INDEX(feature, 0, y + r, x + v * WIDTH);
#endif
            for (int o = 0; o < SIDE * SIDE; o++) {
                const int dy = o / SIDE - SEARCH_RADIUS, dx = o % SIDE - SEARCH_RADIUS;
                const vec weight = LOAD(&weights[o][r][v * WIDTH]);
                term[0] = (vec)(1.f);
#if FEATURES > 0
                for (int q = 0; q < FEATURES; q++)
                    term[1 + q] = LOAD(f + q * feature_plane + dy * feature_row + dx) - LOAD(f + q * feature_plane);
#endif
                term[1 + FEATURES] = (vec)(dx * step);
                term[2 + FEATURES] = (vec)(dy * step);
#pragma unroll
                for (int a = 0; a < TERMS; a++) {
                    const vec weighted = weight * term[a];
#pragma unroll
                    for (int b = 0; b <= a; b++)
                        m[LOWER(a, b)] += weighted * term[b];
#pragma unroll
                    for (int k = 0; k < 3; k++)
                        rhs[a][k] += weighted * LOAD(c + k * color_plane + dy * color_row + dx);
                }
            }
            /* A ridge in proportion to a term's own spread, and to the noise that its feature still has. */
            for (int a = 1; a < TERMS; a++) {
                vec floor_ = (vec)(position_ridge);
#if FEATURES > 0
                if (a <= FEATURES)
                    floor_ = noise_ridge * LOAD(noise + INDEX(noise, a - 1, y + r, x + v * WIDTH));
#endif
                m[LOWER(a, a)] += ridge * m[LOWER(a, a)] + m[0] * (floor_ + 1e-8f);
            }
            cholesky(m);
            solve_for_constant(m, z);
            for (int k = 0; k < 3; k++) {
                vec sum = (vec)(0.f);
                for (int a = 0; a < TERMS; a++)
                    sum += z[a] * rhs[a][k];
                /* A fit may overshoot below 0, where light cannot be; only a negative pixel may stay so. */
                const vec least = fmin(LOAD(c + k * color_plane), (vec)(0.f));
                STORE(fmax(sum, least), out + INDEX(out, k, y + r, x + v * WIDTH));
            }
        }
}
