/* Luminance, and variances on its scale. */
#include "luminance.h"

kernel void luminance_plane(CONST_PLANES(image), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    AT(out, 0, y, x) = LUMINANCE(image, y, x);
}

/* out = variance over the squared luminance around (up = 0), or the other way (up = 1). */
kernel void scale_by_luminance(CONST_PLANES(variance), CONST_PLANES(surroundings), int height, int width, int up,
                               PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const float square = square_of(AT(surroundings, 0, y, x)), v = AT(variance, c, y, x);
    AT(out, c, y, x) = up ? v * square : v / square;
}
