/* The pixels of another frame around the places to which those of a vector have moved.
 *
 * Pixels that move alike, as those of a block do, are read as vectors; others, and at the sides of the frame, one by one.
 * A vector is no wider than a block, and lies in one.
 */
#ifndef MCDENOISE_MOVED_H
#define MCDENOISE_MOVED_H
#include "common.h"

/* Rows y[0] and y[1], columns x[0] and x[1] of each pixel, or of the first one if they are `together`; and the weights of a
 * linear interpolation between the four: all 0 outside of the frame, or too far to be followed. */
typedef struct {
    bool together;
    int x[2][WIDTH], y[2][WIDTH];
    vec weight[4];
} Moved;

/* CONST_PLANES without `restrict`: of that, and of a struct that is returned, inlining makes what simulators do not know. */
#define PARTS(p) global const float *p, int p##_origin, int p##_row, int p##_plane

/* Whole pixels, and the part that is left. Of the motion, not of the place, whose digits depend on where a band of rows
 * begins. */
INLINE int whole_pixels(float d, float *part)
{
    const float down = floor(d);
    *part = d - down;
    return (int)BOUNDED(down, -1e6f, 1e6f);
}

INLINE int nearer(int place, float part)
{
    return part < 0.5f ? place : place + 1;
}

INLINE void share(vec right, vec below, vec inside, vec weight[4])
{
    const vec above = ((vec)(1.f) - below) * inside, under = below * inside;
    weight[0] = ((vec)(1.f) - right) * above;
    weight[1] = right * above;
    weight[2] = ((vec)(1.f) - right) * under;
    weight[3] = right * under;
}

/* Of the pixels from x on in row y. motion: of blocks of so many pixels, to the right and down; `block` may be 1. */
INLINE void moved_from(PARTS(motion), int block, int height, int width, int y, int x, Moved *m)
{
    float right, below;
    const float dx = AT(motion, 0, y / block, x / block), dy = AT(motion, 1, y / block, x / block);
    const int left = x + whole_pixels(dx, &right), top = y + whole_pixels(dy, &below);
    m->together = block > 1 && left >= 0 && left + WIDTH < width;
    if (m->together) {
        const int v = nearer(top, below);
        const bool inside = v >= 0 && v < height && fabs(dy) <= FARTHEST;
        for (int i = 0; i < 2; i++) {
            m->x[i][0] = left + i;
            m->y[i][0] = clamp(top + i, 0, height - 1);
        }
        share((vec)(right), (vec)(below), (vec)(inside ? 1.f : 0.f), m->weight);
        return;
    }
    float rights[WIDTH], belows[WIDTH], insides[WIDTH];
    m->together = true;
    for (int k = 0; k < WIDTH; k++) {
        const int here = min(x + k, width - 1); /* what is beyond the frame may be anything */
        const float dx = AT(motion, 0, y / block, here / block), dy = AT(motion, 1, y / block, here / block);
        const int left = here + whole_pixels(dx, rights + k), top = y + whole_pixels(dy, belows + k);
        const int u = nearer(left, rights[k]), v = nearer(top, belows[k]);
        const bool inside = x + k < width && u >= 0 && u < width && v >= 0 && v < height && fabs(dy) <= FARTHEST;
        insides[k] = inside ? 1.f : 0.f;
        for (int i = 0; i < 2; i++) {
            m->x[i][k] = clamp(left + i, 0, width - 1);
            m->y[i][k] = clamp(top + i, 0, height - 1);
            m->together = m->together && m->x[i][k] == m->x[i][0] + k && m->y[i][k] == m->y[i][0];
        }
    }
    share(LOAD(rights), LOAD(belows), LOAD(insides), m->weight);
}
#define MOVED(m) moved_from(motion, motion_origin, motion_row, motion_plane, block, height, width, y, x, &m)

/* Planes at each of the four: plane c at the i-th is to[i * planes + c]. */
INLINE void moved_to(const Moved *m, PARTS(in), int planes, vec *to)
{
    if (m->together) {
        for (int i = 0; i < 4; i++)
            for (int c = 0; c < planes; c++)
                to[i * planes + c] = VECTOR_AT(in, c, m->y[i / 2][0], m->x[i % 2][0]);
        return;
    }
    for (int i = 0; i < 4; i++)
        for (int c = 0; c < planes; c++) {
            float lanes[WIDTH];
            for (int k = 0; k < WIDTH; k++)
                lanes[k] = AT(in, c, m->y[i / 2][k], m->x[i % 2][k]);
            to[i * planes + c] = LOAD(lanes);
        }
}
#define MOVED_TO(in, first, planes, to) \
    moved_to(&m, in, in##_origin + (first) * in##_plane, in##_row, in##_plane, planes, to)

/* Whether the i-th is nearer than those before it: the nearest is the last of which this holds. */
INLINE void nearer_ones(const Moved *m, whole nearer[4])
{
    vec most = (vec)(-1.f);
    for (int i = 0; i < 4; i++) {
        nearer[i] = m->weight[i] > most;
        most = larger(most, m->weight[i]);
    }
}

#endif
