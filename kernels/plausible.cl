/* Where a filtered frame lies further from its input than noise can explain, the filter is wrong and not the input.
 *
 * Distances are counted in variances of the noisiest pixel around, channel by channel: the noise of few samples is
 * itself known badly, and a pixel that no light has reached yet seems to have none. Noise counts relative to the
 * brightness, as a light is no reason to change the dark wall beside it.
 */
#include "luminance.h"

/* What noise is relative to: the square of a channel, but not less than that of a faint part of the luminance. */
#define FAINT 0.03f
#define DARKEST2 1e-6f

#define RELATIVE_TO(value, light) ((value) * (value) + FAINT * FAINT * (light) * (light) + DARKEST2)

/* The largest relative variance in each block of BLOCK x BLOCK pixels, three planes of blocks. */
kernel void most_noise(CONST_PLANES(color), CONST_PLANES(variance), int height, int width, PLANES(out))
{
    const int first = get_global_id(0) * BLOCK, y = get_global_id(1);
    if (first >= width || y * BLOCK >= height)
        return;
    float most[3] = {0.f, 0.f, 0.f};
    for (int j = y * BLOCK; j < min((y + 1) * BLOCK, height); j++)
        for (int x = first; x < min(first + BLOCK, width); x++) {
            const float l = LUMINANCE(color, j, x);
            for (int c = 0; c < 3; c++) {
                const float own = AT(color, c, j, x);
                most[c] = fmax(most[c], AT(variance, c, j, x) / RELATIVE_TO(own, l));
            }
        }
    for (int c = 0; c < 3; c++)
        AT(out, c, y, get_global_id(0)) = most[c];
}

/* The largest value of each block and of the eight around it. */
kernel void most_around(CONST_PLANES(in), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    float most = 0.f;
    for (int j = max(y - 1, 0); j <= min(y + 1, height - 1); j++)
        for (int i = max(x - 1, 0); i <= min(x + 1, width - 1); i++)
            most = fmax(most, AT(in, c, j, i));
    AT(out, c, y, x) = most;
}

/* How far `filtered` lies from `input`, squared, in variances: the largest of the channels. noise: from most_around. */
kernel void distances(CONST_PLANES(filtered), CONST_PLANES(input), CONST_PLANES(noise), int height, int width,
                      PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    vec before[3], after[3], largest = (vec)(0.f);
    for (int c = 0; c < 3; c++) {
        before[c] = VECTOR_AT(input, c, y, x);
        after[c] = VECTOR_AT(filtered, c, y, x);
    }
    const vec light = luminance(before[0], before[1], before[2]), new_light = luminance(after[0], after[1], after[2]);
    for (int c = 0; c < 3; c++) {
        float line[WIDTH];
        for (int i = 0; i < WIDTH; i++)
            line[i] = AT(noise, c, y / BLOCK, min(x + i, width - 1) / BLOCK);
        const vec change = after[c] - before[c];
        const vec scale = fmax(RELATIVE_TO(before[c], light), RELATIVE_TO(after[c], new_light));
        largest = fmax(largest, change * change / (LOAD(line) * scale + 1e-30f));
    }
    STORE(largest, out + INDEX(out, 0, y, x));
}

/* In place: `filtered` goes back to `input` where the squared distances of the pixels within two exceed `likely` on
 * average, or one of them MOST times that; altogether from 1.5 times either on. `share` is the input's part in it. moved:
 * from distances, with a border of 2. */
#define MOST 5.f

kernel void keep_plausible(PLANES(filtered), CONST_PLANES(input), CONST_PLANES(moved), int height, int width,
                           float likely, PLANES(share))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    vec sum = (vec)(0.f), most = (vec)(0.f);
    for (int j = -2; j <= 2; j++)
        for (int i = -2; i <= 2; i++) {
            const vec here = VECTOR_AT(moved, 0, y + j, x + i);
            sum += here;
            most = fmax(most, here);
        }
    const vec worst = fmax(sum / 25.f, most / MOST) / likely;
    const vec kept = clamp(3.f - 2.f * worst, 0.f, 1.f);
    /* To the last bit where nothing changes, which is nearly everywhere. */
    for (int c = 0; c < 4; c++) {
        const vec before = VECTOR_AT(input, c, y, x), after = VECTOR_AT(filtered, c, y, x);
        STORE(kept < 1.f ? before + kept * (after - before) : after, filtered + INDEX(filtered, c, y, x));
    }
    const vec part = VECTOR_AT(share, 0, y, x);
    STORE(kept < 1.f ? 1.f - kept * (1.f - part) : part, share + INDEX(share, 0, y, x));
}
