/* Values that take turns in memory, and the same in vectors of their own: three channels, or any two vectors. */
#ifndef MCDENOISE_INTERLEAVE_H
#define MCDENOISE_INTERLEAVE_H
#include "common.h"

/* One vector a channel, from three as they lie in memory. */
INLINE void take_apart(vec a, vec b, vec c, vec channel[3])
{
#if WIDTH == 4
    channel[0] = (vec)(a.s0, a.s3, b.s2, c.s1);
    channel[1] = (vec)(a.s1, b.s0, b.s3, c.s2);
    channel[2] = (vec)(a.s2, b.s1, c.s0, c.s3);
#elif WIDTH == 8
    channel[0] = (vec)(a.s0, a.s3, a.s6, b.s1, b.s4, b.s7, c.s2, c.s5);
    channel[1] = (vec)(a.s1, a.s4, a.s7, b.s2, b.s5, c.s0, c.s3, c.s6);
    channel[2] = (vec)(a.s2, a.s5, b.s0, b.s3, b.s6, c.s1, c.s4, c.s7);
#elif WIDTH == 16
    channel[0] = (vec)(a.s0, a.s3, a.s6, a.s9, a.sc, a.sf, b.s2, b.s5, b.s8, b.sb, b.se, c.s1, c.s4, c.s7, c.sa, c.sd);
    channel[1] = (vec)(a.s1, a.s4, a.s7, a.sa, a.sd, b.s0, b.s3, b.s6, b.s9, b.sc, b.sf, c.s2, c.s5, c.s8, c.sb, c.se);
    channel[2] = (vec)(a.s2, a.s5, a.s8, a.sb, a.se, b.s1, b.s4, b.s7, b.sa, b.sd, c.s0, c.s3, c.s6, c.s9, c.sc, c.sf);
#endif
}

/* The opposite. */
INLINE void put_together(vec r, vec g, vec b, vec out[3])
{
#if WIDTH == 4
    out[0] = (vec)(r.s0, g.s0, b.s0, r.s1);
    out[1] = (vec)(g.s1, b.s1, r.s2, g.s2);
    out[2] = (vec)(b.s2, r.s3, g.s3, b.s3);
#elif WIDTH == 8
    out[0] = (vec)(r.s0, g.s0, b.s0, r.s1, g.s1, b.s1, r.s2, g.s2);
    out[1] = (vec)(b.s2, r.s3, g.s3, b.s3, r.s4, g.s4, b.s4, r.s5);
    out[2] = (vec)(g.s5, b.s5, r.s6, g.s6, b.s6, r.s7, g.s7, b.s7);
#elif WIDTH == 16
    out[0] = (vec)(r.s0, g.s0, b.s0, r.s1, g.s1, b.s1, r.s2, g.s2, b.s2, r.s3, g.s3, b.s3, r.s4, g.s4, b.s4, r.s5);
    out[1] = (vec)(g.s5, b.s5, r.s6, g.s6, b.s6, r.s7, g.s7, b.s7, r.s8, g.s8, b.s8, r.s9, g.s9, b.s9, r.sa, g.sa);
    out[2] = (vec)(b.sa, r.sb, g.sb, b.sb, r.sc, g.sc, b.sc, r.sd, g.sd, b.sd, r.se, g.se, b.se, r.sf, g.sf, b.sf);
#endif
}

#if WIDTH > 1
/* One of a, one of b, and so on: as many in each of two vectors. */
INLINE void weave(vec a, vec b, vec *first, vec *second)
{
    vec low, high;
    low.even = a.lo;
    low.odd = b.lo;
    high.even = a.hi;
    high.odd = b.hi;
    *first = low;
    *second = high;
}
#endif

#endif
