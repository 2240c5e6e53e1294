/* Canny's edges of the albedo (Yang 2022, section 2.2), without a round trip to the host.
 *
 * Hysteresis is a connected-component question: which weak edges touch a strong one? Each weak pixel starts as
 * its own root; `link` unites neighbours by atomic minimum (union-find, so no number of passes to guess);
 * `mark` flags the roots that have a strong member; `edges` keeps the members of flagged roots.
 */
#include "common.h"
#include "fast_math.h"

#define NO_EDGE (-1)
#define TAN_22_5 0.41421356237f

kernel void albedo_luminance(CONST_PLANES(albedo), int height, int width, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const vec l = luminance(VECTOR_AT(albedo, 0, y, x), VECTOR_AT(albedo, 1, y, x), VECTOR_AT(albedo, 2, y, x));
    const vec v = clamp(l, (vec)(0.f), (vec)(1.f));
    const vec encoded = 1.055f * fast_power(v, 1.f / 2.4f) - 0.055f; /* sRGB */
    STORE(v <= 0.0031308f ? 12.92f * v : encoded, out + INDEX(out, 0, y, x));
}

/* One direction of a separable filter with 2 radius + 1 taps; (dx, dy) is (1, 0) or (0, 1). `in` has a mirrored border of
 * at least the radius. */
kernel void convolve(CONST_PLANES(in), int height, int width, PLANES(out), global const float *restrict taps,
                     int radius, int dx, int dy)
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    vec sum = (vec)(0.f);
    for (int k = -radius; k <= radius; k++)
        sum += taps[k + radius] * VECTOR_AT(in, 0, y + k * dy, x + k * dx);
    STORE(sum, out + INDEX(out, 0, y, x));
}

kernel void sobel(CONST_PLANES(in), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const int up = reflect(y - 1, height), down = reflect(y + 1, height);
    const int left = reflect(x - 1, width), right = reflect(x + 1, width);
    AT(out, 0, y, x) = (AT(in, 0, up, right) - AT(in, 0, up, left)) +
                       2.f * (AT(in, 0, y, right) - AT(in, 0, y, left)) +
                       (AT(in, 0, down, right) - AT(in, 0, down, left));
    AT(out, 1, y, x) = (AT(in, 0, down, left) - AT(in, 0, up, left)) +
                       2.f * (AT(in, 0, down, x) - AT(in, 0, up, x)) +
                       (AT(in, 0, down, right) - AT(in, 0, up, right));
}

#define BINS 256

/* A histogram of the image in [0, 1], a row a work-item; integer counts, so that the order of the rows does not
 * matter. */
kernel void histogram(CONST_PLANES(in), int height, int width, volatile global int *restrict bins)
{
    const int y = get_global_id(0);
    if (y >= height)
        return;
    int count[BINS];
    for (int i = 0; i < BINS; i++)
        count[i] = 0;
    for (int x = 0; x < width; x++)
        count[min((int)(clamp(AT(in, 0, y, x), 0.f, 1.f) * BINS), BINS - 1)]++;
    for (int i = 0; i < BINS; i++)
        if (count[i] > 0)
            atomic_add(bins + i, count[i]);
}

/* The rule of thumb of one third below and above the median, for each threshold that is negative: not given. */
kernel void thresholds_from_median(global const int *restrict bins, int pixels, float low, float high,
                                   global float *restrict thresholds)
{
    int bin = 0, below = bins[0];
    while (bin < BINS - 1 && 2l * below < pixels)
        below += bins[++bin];
    const float median = (bin + 0.5f) / BINS;
    thresholds[0] = low < 0.f ? 0.67f * median : low;
    thresholds[1] = high < 0.f ? 1.33f * median : high;
}

/* Squared gradient magnitude; outside the image there is none. */
inline float strength(CONST_PLANES(gradient), int y, int x, int height, int width)
{
    if (x < 0 || y < 0 || x >= width || y >= height)
        return 0.f;
    const float gx = AT(gradient, 0, y, x), gy = AT(gradient, 1, y, x);
    return gx * gx + gy * gy;
}
#define STRENGTH(y, x) strength(gradient, gradient_origin, gradient_row, gradient_plane, y, x, height, width)

/* Non-maximum suppression in four sectors and the two thresholds: flag = 0 for a weak or strong edge, else NO_EDGE;
 * every pixel its own root. */
kernel void suppress(CONST_PLANES(gradient), int height, int width, global const float *restrict thresholds,
                     global int *restrict root, global int *restrict strong, global int *restrict flag)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float gx = AT(gradient, 0, y, x), gy = AT(gradient, 1, y, x);
    const float ax = fabs(gx), ay = fabs(gy), m = gx * gx + gy * gy;
    bool peak;
    if (ay < TAN_22_5 * ax)
        peak = m > STRENGTH(y, x - 1) && m >= STRENGTH(y, x + 1);
    else if (ay > (TAN_22_5 + 2.f) * ax)
        peak = m > STRENGTH(y - 1, x) && m >= STRENGTH(y + 1, x);
    else {
        const int s = gx * gy < 0.f ? -1 : 1;
        peak = m > STRENGTH(y - 1, x - s) && m > STRENGTH(y + 1, x + s);
    }
    const int i = y * width + x;
    root[i] = i;
    flag[i] = peak && m > thresholds[0] * thresholds[0] ? 0 : NO_EDGE;
    strong[i] = peak && m > thresholds[1] * thresholds[1];
}

/* Reads are atomic because other work-items write the same words. */
inline int find_root(volatile global int *root, int i)
{
    int parent = atomic_add(root + i, 0);
    while (parent != i) {
        i = parent;
        parent = atomic_add(root + i, 0);
    }
    return i;
}

inline void unite(volatile global int *root, int a, int b)
{
    while (true) {
        a = find_root(root, a);
        b = find_root(root, b);
        if (a == b)
            return;
        const int high = max(a, b), low = min(a, b);
        const int before = atomic_min(root + high, low);
        if (before == high)
            return;
        a = low;
        b = before; /* somebody else moved `high` meanwhile: unite with where it went */
    }
}

kernel void link(int height, int width, volatile global int *restrict root, global const int *restrict flag)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const int i = y * width + x;
    if (flag[i] == NO_EDGE)
        return;
    /* the four neighbours that come before; the other four do the same for this one */
    const int before[4][2] = {{-1, 0}, {-1, -1}, {0, -1}, {1, -1}};
    for (int k = 0; k < 4; k++) {
        const int u = x + before[k][0], v = y + before[k][1];
        if (u < 0 || u >= width || v < 0)
            continue;
        if (flag[v * width + u] != NO_EDGE)
            unite(root, i, v * width + u);
    }
}

kernel void mark(int height, int width, volatile global int *restrict root, global const int *restrict strong,
                 volatile global int *restrict flag)
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const int i = y * width + x;
    if (strong[i])
        atomic_or(flag + find_root(root, i), 1);
}

kernel void edges(int height, int width, global const int *restrict root, global const int *restrict flag, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    int i = y * width + x;
    while (root[i] != i)
        i = root[i];
    AT(out, 0, y, x) = flag[i] == 1 ? 1.f : 0.f;
}
