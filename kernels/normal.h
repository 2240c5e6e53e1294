/* Random numbers that a pixel of a frame always gets. */
#ifndef MCDENOISE_NORMAL_H
#define MCDENOISE_NORMAL_H

inline uint scrambled(uint v)
{
    v ^= v >> 16;
    v *= 0x7feb352dU;
    v ^= v >> 15;
    v *= 0x846ca68bU;
    return v ^ v >> 16;
}

/* Of a normal distribution of variance 1 (Box and Muller 1958); y and x are those of the frame. */
inline float normal_number(int y, int x)
{
    const uint one = scrambled(2 * (y * 65536 + x) + 1), two = scrambled(one + 0x9e3779b9U);
    const float radius = sqrt(-2.f * log(((one >> 8) + 0.5f) / 16777216.f));
    return radius * cospi(2.f * ((two >> 8) + 0.5f) / 16777216.f);
}

#endif
