/* Pixels by blocks of BLOCK x BLOCK, WIDTH blocks at a time: what the kernels of box_fit share. */
#ifndef MCDENOISE_BLOCKS_H
#define MCDENOISE_BLOCKS_H
#include "fast_math.h"
#include "groups.h"
#include "interleave.h"

#define PIXELS (BLOCK * BLOCK)

/* Features come in up to three sets of planes, of so many each. */
#if THIRD > 0
#define SETS(p) , CONST_PLANES(p##1), CONST_PLANES(p##2), CONST_PLANES(p##3)
#elif SECOND > 0
#define SETS(p) , CONST_PLANES(p##1), CONST_PLANES(p##2)
#elif FIRST > 0
#define SETS(p) , CONST_PLANES(p##1)
#else
#define SETS(p)
#endif

/* In exposed units: below the one, errors count alike; the other keeps weights within float32. */
#define DARKEST 0.02f
#define BRIGHTEST 1e5f

/* 1 / (l + DARKEST)^relative */
inline vec relative_weight(vec light, float relative)
{
    return fast_exp(-relative * fast_log(BOUNDED(light, (vec)(0.f), (vec)(BRIGHTEST)) + DARKEST));
}

/* BLOCK times WIDTH values of a row of n from x on, by their place in a block; past the end the last one again. */
inline void take(global const float *row, int x, int n, vec out[BLOCK])
{
#if BLOCK == 2 && WIDTH > 1
    if (x + 2 * WIDTH <= n) {
        const vec low = LOAD(row + x), high = LOAD(row + x + WIDTH);
        out[0].lo = low.even;
        out[0].hi = high.even;
        out[1].lo = low.odd;
        out[1].hi = high.odd;
        return;
    }
#endif
    for (int phase = 0; phase < BLOCK; phase++) {
        float line[WIDTH];
        for (int i = 0; i < WIDTH; i++)
            line[i] = row[min(x + phase + i * BLOCK, n - 1)];
        out[phase] = LOAD(line);
    }
}
#define TAKE(p, c, y, x, n, out) take(p + INDEX(p, c, y, 0), x, n, out)

/* The opposite: nothing past the end. */
inline void give(const vec values[BLOCK], global float *row, int x, int n)
{
#if BLOCK == 2 && WIDTH > 1
    if (x + 2 * WIDTH <= n) {
        vec low, high;
        weave(values[0], values[1], &low, &high);
        STREAM(low, row + x);
        STREAM(high, row + x + WIDTH);
        return;
    }
#endif
    for (int phase = 0; phase < BLOCK; phase++) {
        float line[WIDTH];
        STORE(values[phase], line);
        for (int i = 0; i < WIDTH && x + phase + i * BLOCK < n; i++)
            row[x + phase + i * BLOCK] = line[i];
    }
}
#define GIVE(values, p, c, y, x, n) give(values, p + INDEX(p, c, y, 0), x, n)

/* What a work-item needs of a set of planes, CHUNK blocks from x on, by pixel of a block. Plane by plane: all of them
 * at once are more streams than a processor can foresee. Past the bottom the last row again. */
inline void gather(CONST_PLANES(in), int planes, int y, int x, int height, int width, float out[][PIXELS][CHUNK])
{
    for (int c = 0; c < planes; c++)
        for (int j = 0; j < BLOCK; j++)
            for (int v = 0; v < CHUNK && (x + v) * BLOCK < width; v += WIDTH) {
                vec values[BLOCK];
                TAKE(in, c, min(y * BLOCK + j, height - 1), (x + v) * BLOCK, width, values);
                for (int i = 0; i < BLOCK; i++)
                    STORE(values[i], &out[c][j * BLOCK + i][v]);
            }
}
#define GATHER(p, planes, out) gather(p, p##_origin, p##_row, p##_plane, planes, y, x, height, width, out)
#if THIRD > 0
#define GATHER_SETS(p, out) \
    GATHER(p##1, FIRST, out), GATHER(p##2, SECOND, out + FIRST), GATHER(p##3, THIRD, out + FIRST + SECOND)
#elif SECOND > 0
#define GATHER_SETS(p, out) GATHER(p##1, FIRST, out), GATHER(p##2, SECOND, out + FIRST)
#elif FIRST > 0
#define GATHER_SETS(p, out) GATHER(p##1, FIRST, out)
#else
#define GATHER_SETS(p, out)
#endif

/* Where the pixels of phase i of their blocks lie between blocks: from `before` (in blocks, from their own), this far
 * to the next. */
inline float between(int i, int *before)
{
    const float at = (i + 0.5f) / BLOCK - 0.5f;
    *before = at < 0.f ? -1 : 0;
    return at - *before;
}

/* A plane of blocks between two rows, at the columns x - 1, x and x + 1: what `across` interpolates between. */
inline void between_rows(global const float *plane, int top, int bottom, float down, int x, int n, vec out[3])
{
    for (int i = 0; i < 3; i++) {
        const vec above = mirrored(plane + top, x + i - 1, n), below = mirrored(plane + bottom, x + i - 1, n);
        out[i] = BLEND(above, below, down);
    }
}

inline vec across_columns(const vec v[3], int before, float across)
{
    return BLEND(v[1 + before], v[2 + before], across);
}

/* 1 for the pixels that are there, of WIDTH that are BLOCK apart. */
inline vec present(int x, int n)
{
    float line[WIDTH];
    for (int i = 0; i < WIDTH; i++)
        line[i] = x + i * BLOCK < n;
    return LOAD(line);
}

#endif
