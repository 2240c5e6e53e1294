/* The mean of the absolute values of each plane, in two steps: rows, then planes. */
#include "common.h"

kernel void row_means(CONST_PLANES(image), int height, int width, global float *restrict rows)
{
    const int y = get_global_id(0), c = get_global_id(1);
    float sum = 0.f;
    for (int x = 0; x < width; x++)
        sum += fabs(AT(image, c, y, x));
    rows[c * height + y] = sum / width;
}

kernel void plane_means(global const float *restrict rows, int height, global float *restrict out)
{
    const int c = get_global_id(0);
    float sum = 0.f;
    for (int y = 0; y < height; y++)
        sum += rows[c * height + y];
    out[c] = sum / height;
}
