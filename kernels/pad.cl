/* A mirrored border on every side, so that the windows of later stages need no test for the edge.
 * out = scale * in + shift on the way, which also maps normals from [-1, 1] to [0, 1].
 */
#include "common.h"

kernel void pad(CONST_PLANES(in), int height, int width, PLANES(out), int border, int out_height, int out_width,
                float scale, float shift)
{
    const int place = get_global_id(0) * WIDTH, y = get_global_id(1), c = get_global_id(2);
    if (place >= out_width || y >= out_height)
        return;
    const int x = place - border, row = reflect(y - border, height);
    if (x >= 0 && x + WIDTH <= width) {
        STORE(scale * VECTOR_AT(in, c, row, x) + shift, out + INDEX(out, c, y - border, x));
        return;
    }
    for (int i = 0; i < WIDTH && place + i < out_width; i++)
        AT(out, c, y - border, x + i) = scale * AT(in, c, row, reflect(x + i, width)) + shift;
}
