/* Shared by every kernel: vectors of the device's width, mirrored borders, plane access.
 *
 * A set of planes is passed as four arguments, made by PLANES(p): the buffer, the offset of pixel (0, 0) of
 * the first plane, the floats from row to row and the floats from plane to plane. AT(p, c, y, x) reads or
 * writes one value.
 */
#ifndef MCDENOISE_COMMON_H
#define MCDENOISE_COMMON_H
#include "inline.h"

#define PLANES(p) global float *restrict p, int p##_origin, int p##_row, int p##_plane
#define CONST_PLANES(p) global const float *restrict p, int p##_origin, int p##_row, int p##_plane
#define INDEX(p, c, y, x) (p##_origin + (c) * p##_plane + (y) * p##_row + (x))
#define AT(p, c, y, x) p[INDEX(p, c, y, x)]
#define VECTOR_AT(p, c, y, x) LOAD(p + INDEX(p, c, y, x))

/* WIDTH floats at a time: 1 where the compiler makes vectors of work-items, more where it does not. */
#ifndef WIDTH
#define WIDTH 1
#endif
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#if WIDTH == 1
typedef float vec;
typedef int whole;
#define AS_WHOLE(v) as_int(v)
#define LOAD(p) (*(p))
#define STORE(v, p) (*(p) = (v))
#define ALL(condition) (condition)
#define ANY(condition) (condition)
#define least_lane(v) (v)
#define most_lane(v) (v)
#define larger fmax
#define smaller fmin
#else
typedef JOIN(float, WIDTH) vec;
typedef JOIN(int, WIDTH) whole;
#define AS_WHOLE(v) JOIN(as_int, WIDTH)(v)
#define LOAD(p) load(p)
#define STORE(v, p) store(v, p)
#define ALL(condition) (lanes_and(condition) < 0)
#define ANY(condition) (lanes_or(condition) < 0)

/* Some runtimes (PoCL 3.0) call what others have as one instruction, vload, fmax and the like, and then spend most of the
 * time there. Of a NaN and a number, `larger` and `smaller` give the second. */
#define OVERLOADED INLINE __attribute__((overloadable))
typedef vec unaligned __attribute__((aligned(4)));

OVERLOADED vec load(global const float *p)
{
    return *(global const unaligned *)p;
}

OVERLOADED vec load(const float *p)
{
    return *(const unaligned *)p;
}

OVERLOADED void store(vec v, global float *p)
{
    *(global unaligned *)p = v;
}

OVERLOADED void store(vec v, float *p)
{
    *(unaligned *)p = v;
}

OVERLOADED vec larger(vec a, vec b)
{
    return a > b ? a : b;
}

OVERLOADED float larger(float a, float b)
{
    return a > b ? a : b;
}

OVERLOADED vec smaller(vec a, vec b)
{
    return a < b ? a : b;
}

OVERLOADED float smaller(float a, float b)
{
    return a < b ? a : b;
}

/* Of the lanes of a vector, in a few steps; `all` and `any` ask one after the other. */
#define LANES(name, OF) \
    OVERLOADED int name(int4 v) { const int2 two = OF(v.lo, v.hi); return OF(two.x, two.y); } \
    OVERLOADED int name(int8 v) { return name(OF(v.lo, v.hi)); } \
    OVERLOADED int name(int16 v) { return name(OF(v.lo, v.hi)); }
#define BOTH(a, b) ((a) & (b))
#define EITHER(a, b) ((a) | (b))
#define LESS(a, b) ((a) < (b) ? (a) : (b))
#define MORE(a, b) ((a) > (b) ? (a) : (b))
LANES(lanes_and, BOTH)
LANES(lanes_or, EITHER)
LANES(least_lane, LESS)
LANES(most_lane, MORE)

/* STORE to a multiple of WIDTH floats from the start of a buffer, of what is not read again while the caches hold it: past
 * them, if the compiler can, or a processor would first read what it is to overwrite. */
#ifdef __has_builtin
#if __has_builtin(__builtin_nontemporal_store)
#define STREAM(v, p) __builtin_nontemporal_store(v, (global vec *)(p))
#endif
#endif
#endif
#ifndef STREAM
#define STREAM STORE
#endif
#define BOUNDED(x, low, high) smaller(larger(x, low), high)

/* Mirror without repeating the edge pixel (OpenCV's REFLECT_101), for any distance from the image. */
inline int reflect(int i, int n)
{
    if (i >= 0 && i < n)
        return i;
    if (n == 1)
        return 0;
    const int period = 2 * (n - 1);
    i %= period;
    if (i < 0)
        i += period;
    return i < n ? i : period - i;
}

/* From a to b; a itself where both are equal, which the built-in mix does not promise, and each end as exact as it is,
 * however large the other. Vectors or scalars. */
#define BLEND(a, b, t) ((t) < 0.5f ? (a) + (t) * ((b) - (a)) : (b) + (1.f - (t)) * ((a) - (b)))

/* Rec. 709 */
inline vec luminance(vec r, vec g, vec b)
{
    return 0.2126f * r + 0.7152f * g + 0.0722f * b;
}

#endif
