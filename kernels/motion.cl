/* Where the pixels of a frame are in another one.
 *
 * Features tell: of every block of 8x8 pixels and those around it, the displacement at which they differ least beyond
 * their noise, to a part of a pixel; or motion vectors do, in blocks where they cost no more than that. All frames are
 * laid out alike, without borders but for those of match_costs.
 */
#include "mismatch.h"
#include "moved.h"

/* Offsets a side of the search window, and pixels a side of the blocks. */
#define SPAN (2 * SEARCH_RADIUS + 1)

/* A displacement costs so much a pixel: where nothing tells, nothing has moved. */
#define STAY 0.05f
/* Added to the curvature of the costs: noise bends them too. Parts of a pixel below SNAP are none: to move by them would
 * blur and gain nothing. */
#define BENT 0.1f
#define SNAP 0.15f
/* Motion vectors are kept where they cost no more than what is found, but for rounding. */
#define TIE 1e-3f

inline float total8(float8 v)
{
    const float4 four = v.lo + v.hi;
    return (four.x + four.y) + (four.z + four.w);
}

/* The sum of the mismatches of a block at the offsets of one row of the window: plane by plane for every offset, row by
 * row; and beside the blocks, as far as vectors reach, 0. Guides have a mirrored border of SEARCH_RADIUS. The rows of the
 * window come first, so that a block is in the caches for all of them. */
typedef float8 unaligned8 __attribute__((aligned(4))); /* vload8 is a call on some runtimes, as in common.h */
#define OWN(c) (*(global const unaligned8 *)(a + (c) * own_plane))
#define OTHER(c) (*(global const unaligned8 *)(b + (c) * other_plane))
kernel void match_costs(CONST_PLANES(own), CONST_PLANES(other), int height, int width, PLANES(out))
{
    const int row = get_global_id(0), left = get_global_id(1) * 8, top = get_global_id(2) * 8;
    if (left >= width || top >= height)
        return;
    const int8 inside = left + (int8)(0, 1, 2, 3, 4, 5, 6, 7) < width;
    float8 sum[SPAN];
    for (int i = 0; i < SPAN; i++)
        sum[i] = (float8)(0.f);
    for (int y = top; y < min(top + 8, height); y++) {
        global const float *a = own + INDEX(own, 0, y, left);
        for (int i = 0; i < SPAN; i++) {
            global const float *b = other + INDEX(other, 0, y + row - SEARCH_RADIUS, left + i - SEARCH_RADIUS);
            const float8 each = MISMATCH(OWN, OTHER);
            sum[i] += inside ? (each < MOST ? each : (float8)(MOST)) : (float8)(0.f);
        }
    }
    const int y = get_global_id(2), x = get_global_id(1);
    for (int i = 0; i < SPAN; i++) {
        AT(out, row * SPAN + i, y, x) = total8(sum[i]);
        if (left == 0)
            AT(out, row * SPAN + i, y, -1) = 0.f;
        if (left + 8 >= width)
            for (int k = x + 1; k <= x / WIDTH * WIDTH + WIDTH; k++)
                AT(out, row * SPAN + i, y, k) = 0.f;
    }
}

/* From a cost and those to both sides: where between them it is least. */
inline float part_of_pixel(float before, float here, float after)
{
    const float part = clamp(0.5f * (before - after) / (fmax(before + after - 2.f * here, 0.f) + BENT), -0.5f, 0.5f);
    return fabs(part) < SNAP ? 0.f : part;
}

/* Three planes of blocks: how far each has moved to the right, and down; and what that costs. The cost of an offset is the
 * mean over a block and those around, weighted 1 2 1 both ways; and of moving. */
kernel void find_motion(CONST_PLANES(costs), int height, int width, PLANES(out))
{
    const int x = get_global_id(0) * WIDTH, y = get_global_id(1);
    const int down = (height + 7) / 8, across = (width + 7) / 8, centre = SEARCH_RADIUS * SPAN + SEARCH_RADIUS;
    if (x >= across || y >= down)
        return;
    /* Blocks at the lower and right sides have fewer pixels. */
    const int first = max(y - 1, 0), last = min(y + 1, down - 1);
    float rows = 0.f, columns[WIDTH], cost[SPAN * SPAN][WIDTH];
    for (int k = 0; k < WIDTH; k++) {
        const int rest = width - 8 * (x + k);
        columns[k] = (x + k > 0 ? 8 : 0) + 2 * min(8, rest) + clamp(rest - 8, 0, 8);
    }
    for (int j = first; j <= last; j++)
        rows += (j == y ? 2.f : 1.f) * min(8, height - 8 * j);
    const vec scale = 1.f / (rows * LOAD(columns));
    for (int o = 0; o < SPAN * SPAN; o++) {
        const float dy = o / SPAN - SEARCH_RADIUS, dx = o % SPAN - SEARCH_RADIUS;
        vec sum = (vec)(0.f);
        for (int j = first; j <= last; j++) {
            const vec beside = VECTOR_AT(costs, o, j, x - 1) + VECTOR_AT(costs, o, j, x + 1);
            sum += (j == y ? 2.f : 1.f) * (beside + 2.f * VECTOR_AT(costs, o, j, x));
        }
        STORE(sum * scale + STAY * sqrt(dx * dx + dy * dy), cost[o]);
    }
    for (int k = 0; k < WIDTH && x + k < across; k++) {
        int o = centre;
        for (int i = 0; i < SPAN * SPAN; i++)
            o = cost[i][k] < cost[o][k] ? i : o;
        const int below = o / SPAN - SEARCH_RADIUS, right = o % SPAN - SEARCH_RADIUS;
        float u = right, v = below;
        if (abs(right) < SEARCH_RADIUS)
            u += part_of_pixel(cost[o - 1][k], cost[o][k], cost[o + 1][k]);
        if (abs(below) < SEARCH_RADIUS)
            v += part_of_pixel(cost[o - SPAN][k], cost[o][k], cost[o + SPAN][k]);
        AT(out, 0, y, x + k) = u;
        AT(out, 1, y, x + k) = v;
        AT(out, 2, y, x + k) = cost[o][k];
    }
}

#define HERE(c) VECTOR_AT(own, c, y, x)
#define THERE(c) there[c]

/* Two planes of blocks: the sum of the mismatches where motion vectors lead, each to the nearest pixel, and how many of
 * the vectors stay in the picture. */
kernel void vector_costs(CONST_PLANES(own), CONST_PLANES(other), CONST_PLANES(motion), int height, int width,
                         PLANES(out))
{
    const int across = get_global_id(0), down = get_global_id(1), block = 1;
    if (8 * across >= width || 8 * down >= height)
        return;
    const vec zero = (vec)(0.f), one = (vec)(1.f);
    vec sums = zero, counts = zero;
    for (int y = 8 * down; y < min(8 * down + 8, height); y++)
        for (int x = 8 * across; x < min(8 * across + 8, width); x += WIDTH) {
            Moved m;
            MOVED(m);
            whole nearer[4];
            nearer_ones(&m, nearer);
            vec four[4 * GUIDE], there[GUIDE];
            MOVED_TO(other, 0, GUIDE, four);
            for (int c = 0; c < GUIDE; c++) {
                there[c] = four[c];
                for (int i = 1; i < 4; i++)
                    there[c] = nearer[i] ? four[i * GUIDE + c] : there[c];
            }
            const vec all = m.weight[0] + m.weight[1] + m.weight[2] + m.weight[3];
            sums += all > zero ? smaller(MISMATCH(HERE, THERE), (vec)(MOST)) : zero;
            counts += all > zero ? one : zero;
        }
    float sum = 0.f, count = 0.f, of_lanes[WIDTH], in_lanes[WIDTH];
    STORE(sums, of_lanes);
    STORE(counts, in_lanes);
    for (int k = 0; k < WIDTH; k++) {
        sum += of_lanes[k];
        count += in_lanes[k];
    }
    AT(out, 0, down, across) = sum;
    AT(out, 1, down, across) = count;
}

/* Two planes of pixels: the motion vectors, or in blocks where these cost more what was found. Vectors may be wrong, and
 * many renderers have none, or 0, where a ray leaves the scene. */
kernel void choose_motion(CONST_PLANES(found), CONST_PLANES(costs), CONST_PLANES(motion), int height, int width,
                          PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const int across = x / 8, down = y / 8;
    float sum = 0.f, weights = 0.f;
    for (int j = max(down - 1, 0); j <= min(down + 1, (height - 1) / 8); j++)
        for (int i = max(across - 1, 0); i <= min(across + 1, (width - 1) / 8); i++) {
            const float weight = (j == down ? 2.f : 1.f) * (i == across ? 2.f : 1.f);
            sum += weight * AT(costs, 0, j, i);
            weights += weight * AT(costs, 1, j, i);
        }
    const bool kept_as_given = sum <= (AT(found, 2, down, across) + TIE) * weights;
    for (int c = 0; c < 2; c++)
        AT(out, c, y, x) = kept_as_given ? AT(motion, c, y, x) : AT(found, c, down, across);
}
