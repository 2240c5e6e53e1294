/* The variance of the pixel mean, from what there is to tell it; and planes brought to a common scale. */
#include "common.h"

/* Two independent halves a, b: the variance of their mean is (a - b)^2 / 4, one sample of it a pixel. */
kernel void variance_from_halves(CONST_PLANES(a), CONST_PLANES(b), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const float d = AT(a, c, y, x) - AT(b, c, y, x);
    AT(out, c, y, x) = 0.25f * d * d;
}

/* The image alone: the response to Immerkaer's mask, which is blind to slopes, squared, over the mask's 36. */
inline float variance_in_image(CONST_PLANES(in), int height, int width, int c, int y, int x)
{
    const int up = reflect(y - 1, height), down = reflect(y + 1, height);
    const int left = reflect(x - 1, width), right = reflect(x + 1, width);
    const float m = AT(in, c, y, x);
    const float corners = (AT(in, c, up, left) - m) + (AT(in, c, up, right) - m) + (AT(in, c, down, left) - m) +
                          (AT(in, c, down, right) - m);
    const float sides = (AT(in, c, up, x) - m) + (AT(in, c, down, x) - m) + (AT(in, c, y, left) - m) +
                        (AT(in, c, y, right) - m);
    const float response = corners - 2.f * sides;
    return response * response / 36.f;
}
#define VARIANCE_IN_IMAGE(in) variance_in_image(in, in##_origin, in##_row, in##_plane, height, width, c, y, x)

kernel void variance_from_image(CONST_PLANES(in), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    AT(out, c, y, x) = VARIANCE_IN_IMAGE(in);
}

/* As it is given, in exposed units; from the image, which is in them, where it is below 0: not known. */
kernel void known_variance(CONST_PLANES(known), CONST_PLANES(image), int height, int width,
                           global const float *restrict factor, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const float variance = AT(known, c, y, x) * factor[0] * factor[0];
    AT(out, c, y, x) = variance >= 0.f ? variance : VARIANCE_IN_IMAGE(image);
}

kernel void channel_sum(CONST_PLANES(in), int channels, int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    float sum = 0.f;
    for (int c = 0; c < channels; c++)
        sum += AT(in, c, y, x);
    AT(out, 0, y, x) = sum;
}

/* out = in * factor: colours and half buffers in exposed units. */
kernel void scale(CONST_PLANES(in), int height, int width, global const float *restrict factor, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    AT(out, c, y, x) = AT(in, c, y, x) * factor[0];
}

/* out = in / factor, or `before` where nothing happened to it: x * f / f is not always x. */
kernel void scale_back(CONST_PLANES(in), CONST_PLANES(before), int height, int width,
                       global const float *restrict factor, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const float f = factor[0], own = AT(before, c, y, x), value = AT(in, c, y, x);
    AT(out, c, y, x) = value == own * f ? own : value / f;
}

kernel void clip(CONST_PLANES(in), int height, int width, float low, float high, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    AT(out, c, y, x) = BOUNDED(AT(in, c, y, x), low, high);
}

/* The first pixel of each plane. */
kernel void first_pixel(CONST_PLANES(in), int channels, global float *restrict out)
{
    for (int c = 0; c < channels; c++)
        out[c] = AT(in, c, 0, 0);
}

/* About a pixel, so that what varies little on a large offset keeps its digits. */
kernel void about(CONST_PLANES(in), int height, int width, global const float *restrict pixel, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    AT(out, c, y, x) = AT(in, c, y, x) - pixel[c];
}

/* Depth as a feature in [-1/2, 1/2): z / (z + s) - 1/2 = (z - s) / (z + s) / 2, s the geometric mean; the second form
 * keeps the digits of depths that differ little. Its variance by the derivative. */
kernel void depth_feature(CONST_PLANES(depth), int height, int width, global const float *restrict inverse_scale,
                          PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float s = 1.f / inverse_scale[0], z = larger(AT(depth, 0, y, x), 0.f);
    AT(out, 0, y, x) = 0.5f * (z - s) / (z + s);
}

kernel void depth_feature_variance(CONST_PLANES(depth), CONST_PLANES(variance), int height, int width,
                                   global const float *restrict inverse_scale, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float s = inverse_scale[0], z = larger(AT(depth, 0, y, x), 0.f) * s;
    const float slope = s / ((z + 1.f) * (z + 1.f)); /* d/dz of z s / (z s + 1) */
    AT(out, 0, y, x) = AT(variance, 0, y, x) * slope * slope;
}
