/* A mirrored border on every side, so that the windows of later stages need no test for the edge.
 * out = scale * in + shift on the way, which also maps normals from [-1, 1] to [0, 1].
 */
#include "common.h"

kernel void pad(CONST_PLANES(in), int height, int width, PLANES(out), int border, int out_height, int out_width,
                float scale, float shift)
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= out_width || y >= out_height)
        return;
    const float value = AT(in, c, reflect(y - border, height), reflect(x - border, width));
    AT(out, c, y - border, x - border) = scale * value + shift;
}
