/* Eigenvectors of a small symmetric matrix of SIZE rows, by Jacobi rotations. They are orthonormal to rounding however
 * early the rotations end; what is left of the correlations between them is then at most about NEGLIGIBLE. */
#ifndef MCDENOISE_EIGEN_H
#define MCDENOISE_EIGEN_H

#define SWEEPS 6 /* what is off the diagonal shrinks quadratically */
#define NEGLIGIBLE 1e-3f

/* Rows p and q of a matrix become a rotated pair: c times the one less s times the other, and the reverse. */
inline void rotate_rows(float m[SIZE][SIZE], int p, int q, float c, float s)
{
    for (int k = 0; k < SIZE; k++) {
        const float x = m[p][k], y = m[q][k];
        m[p][k] = c * x - s * y;
        m[q][k] = s * x + c * y;
    }
}

inline void rotate_columns(float m[SIZE][SIZE], int p, int q, float c, float s)
{
    for (int k = 0; k < SIZE; k++) {
        const float x = m[k][p], y = m[k][q];
        m[k][p] = c * x - s * y;
        m[k][q] = s * x + c * y;
    }
}

/* m becomes diagonal, in place: the eigenvalues. The rows of v are the vectors. */
inline void eigenvectors(float m[SIZE][SIZE], float v[SIZE][SIZE])
{
    for (int a = 0; a < SIZE; a++)
        for (int b = 0; b < SIZE; b++)
            v[a][b] = a == b ? 1.f : 0.f;
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int p = 0; p < SIZE; p++)
            for (int q = p + 1; q < SIZE; q++) {
                if (fabs(m[p][q]) <= NEGLIGIBLE * sqrt(fabs(m[p][p] * m[q][q])))
                    continue;
                const float cotangent = (m[q][q] - m[p][p]) / (2.f * m[p][q]); /* of twice the angle */
                const float size = 1.f / (fabs(cotangent) + sqrt(cotangent * cotangent + 1.f));
                const float t = cotangent < 0.f ? -size : size, c = 1.f / sqrt(t * t + 1.f);
                rotate_columns(m, p, q, c, t * c);
                rotate_rows(m, p, q, c, t * c);
                rotate_rows(v, p, q, c, t * c);
            }
}

#endif
