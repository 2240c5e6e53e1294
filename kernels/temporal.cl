/* Neighbouring frames of a sequence merged into a frame, before any method sees it.
 *
 *   c'(p) = (c(p) + sum_k w_k(p) sum_i t_i c_k(q_i)) / (1 + sum_k w_k(p)),   v'(p) = (v(p) + sum w^2 t^2 v) / (...)^2
 *
 * q_i are the four pixels of neighbour k around the place to which p has moved. Features tell where that is: of every
 * block of 8x8 pixels and those around it, the displacement at which they differ least beyond their noise, to a part of
 * a pixel; or motion vectors do, in blocks where they cost no more than that. Then each of the four, each pixel and its
 * surroundings are tested: what differs in its features is left out. What differs in light by more than its noise V gets
 * the weight of least error, V / (V + B), B the squared difference that noise does not explain. All frames are laid out
 * alike, without borders but for those of match_costs.
 *
 * A guide holds the planes of the features, then for each feature the sum of its channels' variances. Light is three
 * planes of colour, outliers held back, and the sum of their variances.
 */
#include "common.h"

/* Offsets a side of the search window, and pixels a side of the blocks. */
#define SPAN (2 * SEARCH_RADIUS + 1)

/* What a difference is relative to besides its noise, squared: of albedo, of normals, of depth and of colour relative to
 * their own size. */
#define ALBEDO2 (0.05f * 0.05f)
#define NORMAL2 (0.1f * 0.1f)
#define DEPTH2 (0.05f * 0.05f)
#define COLOR2 (0.1f * 0.1f)

/* No difference counts for more. */
#define MOST 8.f

/* A displacement costs so much a pixel: where nothing tells, nothing has moved. */
#define STAY 0.05f
/* Added to the curvature of the costs: noise bends them too. Parts of a pixel below SNAP are none: to move by them would
 * blur and gain nothing. */
#define BENT 0.1f
#define SNAP 0.15f
/* Motion vectors are kept where they cost no more than what is found, but for rounding. */
#define TIE 1e-3f

/* Each of the four pixels: kept up to FIRST, left out from LAST on, with a smooth step between; the pixel with all of
 * them, as a mean over 3x3. */
#define TAP_FIRST 1.f
#define TAP_LAST 4.f
#define PIXEL_FIRST 1.f
#define PIXEL_LAST 3.f
/* Each of the four with a doubt that shrinks by STAKE times what it would cost to take the one for the other: a pixel of
 * wall, and one that a lamp a hundred times as bright has a part in. */
#define EDGE_FIRST 4.f
#define EDGE_LAST 12.f
#define STAKE 0.1f
/* Its light alone: squared difference over noise. */
#define SPIKE_FIRST 16.f
#define SPIKE_LAST 36.f
/* Light is relative to the darker of two pixels, as errors are, but not to less than this, squared. */
#define DARK2 0.01f
/* A mean that differs by two standard deviations may do so by chance. */
#define CHANCE 4.f

inline float kept(float x, float first, float last)
{
    const float t = clamp((last - x) / (last - first), 0.f, 1.f);
    return t * t * (3.f - 2.f * t);
}

/* How far two guides differ beyond their noise, in units of noise and tolerance. A(c), B(c): plane c of either. */
#define SQUARE(x) ((x) * (x))
#define SQUARES3(A, B, c) (SQUARE(A(c) - B(c)) + SQUARE(A((c) + 1) - B((c) + 1)) + SQUARE(A((c) + 2) - B((c) + 2)))
#define EXCESS(squares, noise, tolerance) (((squares) - (noise)) / ((noise) + (tolerance)))
#define NOISE(A, B, g) (A(CHANNELS + (g)) + B(CHANNELS + (g)))
#ifdef ALBEDO
#define WITH_ALBEDO(A, B) +EXCESS(SQUARES3(A, B, ALBEDO), NOISE(A, B, ALBEDO_NOISE), ALBEDO2)
#else
#define WITH_ALBEDO(A, B)
#endif
#ifdef NORMAL
#define WITH_NORMAL(A, B) +EXCESS(SQUARES3(A, B, NORMAL), NOISE(A, B, NORMAL_NOISE), NORMAL2)
#else
#define WITH_NORMAL(A, B)
#endif
#ifdef DEPTH
#define BOTH(A, B) (fabs(A(DEPTH)) + fabs(B(DEPTH)))
#define WITH_DEPTH(A, B)                                                                                               \
    +EXCESS(SQUARE(A(DEPTH) - B(DEPTH)), NOISE(A, B, DEPTH_NOISE), DEPTH2 *SQUARE(BOTH(A, B)) + 1e-30f)
#else
#define WITH_DEPTH(A, B)
#endif
#ifdef COLOR
#define SIZE2(A) (A(COLOR) * A(COLOR) + A(COLOR + 1) * A(COLOR + 1) + A(COLOR + 2) * A(COLOR + 2))
#define WITH_COLOR(A, B)                                                                                               \
    +EXCESS(SQUARES3(A, B, COLOR), NOISE(A, B, COLOR_NOISE), COLOR2 *(SIZE2(A) + SIZE2(B)) + 1e-12f)
#else
#define WITH_COLOR(A, B)
#endif
#define MISMATCH(A, B) (0.f WITH_ALBEDO(A, B) WITH_NORMAL(A, B) WITH_DEPTH(A, B) WITH_COLOR(A, B))

inline float total8(float8 v)
{
    const float4 four = v.lo + v.hi;
    return (four.x + four.y) + (four.z + four.w);
}

/* The sum of the mismatches of a block at the offsets of one row of the window: plane by plane for every offset, row by
 * row. Guides have a mirrored border of SEARCH_RADIUS. */
typedef float8 unaligned8 __attribute__((aligned(4))); /* vload8 is a call on some runtimes, as in common.h */
#define OWN(c) (*(global const unaligned8 *)(a + (c) * own_plane))
#define OTHER(c) (*(global const unaligned8 *)(b + (c) * other_plane))
kernel void match_costs(CONST_PLANES(own), CONST_PLANES(other), int height, int width, PLANES(out))
{
    const int left = get_global_id(0) * 8, top = get_global_id(1) * 8, row = get_global_id(2);
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
    for (int i = 0; i < SPAN; i++)
        AT(out, row * SPAN + i, get_global_id(1), get_global_id(0)) = total8(sum[i]);
}

/* The cost of an offset for a block: the mean over it and those around, weighted 1 2 1 both ways; and of moving. */
inline float cost_of(CONST_PLANES(costs), int down, int across, int height, int width, int y, int x, int dy, int dx)
{
    const int offset = (dy + SEARCH_RADIUS) * SPAN + dx + SEARCH_RADIUS;
    float sum = 0.f, weights = 0.f;
    for (int j = max(y - 1, 0); j <= min(y + 1, down - 1); j++)
        for (int i = max(x - 1, 0); i <= min(x + 1, across - 1); i++) {
            const float weight = (j == y ? 2.f : 1.f) * (i == x ? 2.f : 1.f);
            const int pixels = min(8, height - 8 * j) * min(8, width - 8 * i);
            sum += weight * AT(costs, offset, j, i);
            weights += weight * pixels;
        }
    return sum / weights + STAY * sqrt((float)(dx * dx + dy * dy));
}
#define COST(dy, dx) cost_of(costs, costs_origin, costs_row, costs_plane, down, across, height, width, y, x, dy, dx)

/* From a cost and those to both sides: where between them it is least. */
inline float part_of_pixel(float before, float here, float after)
{
    const float part = clamp(0.5f * (before - after) / (fmax(before + after - 2.f * here, 0.f) + BENT), -0.5f, 0.5f);
    return fabs(part) < SNAP ? 0.f : part;
}

/* Three planes of blocks: how far each has moved to the right, and down; and what that costs. */
kernel void find_motion(CONST_PLANES(costs), int height, int width, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1);
    const int down = (height + 7) / 8, across = (width + 7) / 8;
    if (x >= across || y >= down)
        return;
    int right = 0, below = 0;
    float least = COST(0, 0);
    for (int dy = -SEARCH_RADIUS; dy <= SEARCH_RADIUS; dy++)
        for (int dx = -SEARCH_RADIUS; dx <= SEARCH_RADIUS; dx++) {
            const float cost = COST(dy, dx);
            if (cost < least) {
                least = cost;
                right = dx;
                below = dy;
            }
        }
    float u = right, v = below;
    if (abs(right) < SEARCH_RADIUS)
        u += part_of_pixel(COST(below, right - 1), least, COST(below, right + 1));
    if (abs(below) < SEARCH_RADIUS)
        v += part_of_pixel(COST(below - 1, right), least, COST(below + 1, right));
    AT(out, 0, y, x) = u;
    AT(out, 1, y, x) = v;
    AT(out, 2, y, x) = least;
}

/* The four pixels around the place to which a pixel has moved: rows y[0] and y[1], columns x[0] and x[1], and the
 * weights of a linear interpolation; all 0 outside of the frame, or too far to be followed. */
typedef struct {
    int x[2], y[2];
    float weight[4];
} taps;

inline taps taps_of(CONST_PLANES(motion), int block, int height, int width, int y, int x)
{
    taps t;
    const float dx = AT(motion, 0, y / block, x / block), dy = AT(motion, 1, y / block, x / block);
    /* Parts of the motion, not of the place, whose digits depend on where a band of rows begins. */
    const float right = dx - floor(dx), below = dy - floor(dy);
    const int left = x + (int)clamp(floor(dx), -1e6f, 1e6f), top = y + (int)clamp(floor(dy), -1e6f, 1e6f);
    const int u = right < 0.5f ? left : left + 1, v = below < 0.5f ? top : top + 1;
    const bool inside = u >= 0 && u < width && v >= 0 && v < height && fabs(dy) <= FARTHEST;
    for (int i = 0; i < 2; i++) {
        t.x[i] = clamp(left + i, 0, width - 1);
        t.y[i] = clamp(top + i, 0, height - 1);
    }
    for (int i = 0; i < 4; i++)
        t.weight[i] = inside ? (i % 2 ? right : 1.f - right) * (i / 2 ? below : 1.f - below) : 0.f;
    return t;
}
#define TAPS taps_of(motion, motion_origin, motion_row, motion_plane, block, height, width, y, x)

#define GUIDE (CHANNELS + GROUPS)
#define HERE(c) here[c]
#define THERE(c) there[c]
#define MOVED(c) moved[c]
#define STRICT(c) strict[c]
#define LIGHT(c) AT(light, c, y, x)
#define LIGHT_THERE(c) light_there[c]
#define COLORS(c) colors[c]

/* What squared differences of light are relative to: 1 over the square of the darker of two. */
#define MEAN3(A) ((A(0) + A(1) + A(2)) / 3.f)
#define RELATIVE(A, B) (1.f / (SQUARE(fmin(fabs(MEAN3(A)), fabs(MEAN3(B)))) + DARK2))

/* Two planes of blocks: the sum of the mismatches where motion vectors lead, each to the nearest pixel, and how many of
 * the vectors stay in the picture. */
kernel void vector_costs(CONST_PLANES(own), CONST_PLANES(other), CONST_PLANES(motion), int height, int width,
                         PLANES(out))
{
    const int across = get_global_id(0), down = get_global_id(1), block = 1;
    if (8 * across >= width || 8 * down >= height)
        return;
    float sum = 0.f, count = 0.f;
    for (int y = 8 * down; y < min(8 * down + 8, height); y++)
        for (int x = 8 * across; x < min(8 * across + 8, width); x++) {
            const taps t = TAPS;
            int nearest = 0;
            for (int i = 1; i < 4; i++)
                nearest = t.weight[i] > t.weight[nearest] ? i : nearest;
            if (t.weight[nearest] == 0.f)
                continue;
            float here[GUIDE], there[GUIDE];
            for (int c = 0; c < GUIDE; c++) {
                here[c] = AT(own, c, y, x);
                there[c] = AT(other, c, t.y[nearest / 2], t.x[nearest % 2]);
            }
            sum += fmin(MISMATCH(HERE, THERE), MOST);
            count += 1.f;
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

/* Eight planes of tests: the mismatch of a pixel and what has become of it; their squared difference in light and its
 * variance, relative to the darker of the two, and as they are; the relative difference of each channel. And the weights
 * of the four pixels: their sum is 1, or less. */
kernel void compare(CONST_PLANES(own), CONST_PLANES(other), CONST_PLANES(light), CONST_PLANES(other_light),
                    CONST_PLANES(motion), int block, int height, int width, PLANES(tests), PLANES(weights))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const taps t = TAPS;
    float here[GUIDE], moved[GUIDE], colors[4] = {0.f, 0.f, 0.f, 0.f}, weight[4], sum = 0.f, same = 0.f;
    for (int c = 0; c < GUIDE; c++) {
        here[c] = AT(own, c, y, x);
        moved[c] = 0.f;
    }
    for (int i = 0; i < 4; i++) {
        float there[GUIDE], strict[GUIDE], light_there[3];
        for (int c = 0; c < GUIDE; c++)
            there[c] = AT(other, c, t.y[i / 2], t.x[i % 2]);
        weight[i] = kept(MISMATCH(HERE, THERE), TAP_FIRST, TAP_LAST);
        for (int c = 0; c < 3; c++)
            light_there[c] = AT(other_light, c, t.y[i / 2], t.x[i % 2]);
        /* Where the one is all of a piece and the other is not, the doubt is between the variances of both. */
        const float doubt = 1.f / (1.f + STAKE * SQUARES3(LIGHT, LIGHT_THERE, 0) * RELATIVE(LIGHT, LIGHT_THERE));
        for (int c = 0; c < CHANNELS; c++)
            strict[c] = here[c];
        for (int c = CHANNELS; c < GUIDE; c++) {
            const float least = fmin(here[c], there[c]);
            strict[c] = BLEND(least, here[c], doubt);
            there[c] = BLEND(least, there[c], doubt);
        }
        const float same_thing = kept(MISMATCH(STRICT, THERE), EDGE_FIRST, EDGE_LAST);
        same += t.weight[i] * same_thing;
        weight[i] = t.weight[i] * (1e-3f + weight[i] * same_thing);
        sum += weight[i];
    }
    const bool found = sum > 0.f;
    for (int i = 0; i < 4; i++) {
        const float w = found ? weight[i] / sum : 0.f;
        for (int c = 0; c < GUIDE; c++)
            moved[c] += (c < CHANNELS ? w : w * w) * AT(other, c, t.y[i / 2], t.x[i % 2]);
        for (int c = 0; c < 4; c++)
            colors[c] += (c < 3 ? w : w * w) * AT(other_light, c, t.y[i / 2], t.x[i % 2]);
    }
    const float squares = SQUARES3(LIGHT, COLORS, 0), noise = AT(light, 3, y, x) + colors[3];
    const float relative = RELATIVE(LIGHT, COLORS);
    same *= kept(squares / (noise + 1e-9f), SPIKE_FIRST, SPIKE_LAST);
    for (int i = 0; i < 4; i++)
        AT(weights, i, y, x) = found ? same * weight[i] / sum : 0.f;
    AT(tests, 0, y, x) = found ? fmin(MISMATCH(HERE, MOVED), MOST) : MOST;
    AT(tests, 1, y, x) = found ? relative * squares : 0.f;
    AT(tests, 2, y, x) = found ? relative * noise : 0.f;
    AT(tests, 3, y, x) = found ? squares : 0.f;
    AT(tests, 4, y, x) = found ? noise : 0.f;
    for (int c = 0; c < 3; c++)
        AT(tests, 5 + c, y, x) = found ? sqrt(relative) * (AT(light, c, y, x) - colors[c]) : 0.f;
}

/* In place: the weights of the four pixels times that of what they make. The sum of the weights of all frames grows by
 * it. The mismatch comes as its mean over 3x3, the tests of light over PIXELS.
 *
 * noise = 2 V, so excess over noise is B / 2V. Noise averages out further on, in whatever filter comes next, but a
 * difference that the whole surroundings share does not, so it counts as often as there are pixels. */
kernel void weigh(CONST_PLANES(mismatch), CONST_PLANES(light), int height, int width, PLANES(weights), PLANES(total))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const float noise = AT(light, 1, y, x) + 1e-9f, plain_noise = AT(light, 3, y, x) + 1e-9f;
    const float excess = fmax(AT(light, 0, y, x) / noise, AT(light, 2, y, x) / plain_noise) - 1.f;
    float shared = 0.f;
    for (int c = 4; c < 7; c++)
        shared += SQUARE(AT(light, c, y, x)) * (PIXELS / noise);
    const float w = kept(AT(mismatch, 0, y, x), PIXEL_FIRST, PIXEL_LAST) /
                    (1.f + 2.f * (fmax(excess, 0.f) + fmax(shared - CHANCE, 0.f)));
    float sum = 0.f;
    for (int i = 0; i < 4; i++) {
        const float weight = w * AT(weights, i, y, x);
        AT(weights, i, y, x) = weight;
        sum += weight;
    }
    AT(total, 0, y, x) += sum;
}

/* In place: sum grows by a plane of the other frame, with these weights or, of variances, their squares. Of light,
 * what was held back of an outlier (factor: what was left of each pixel) is not spread over four pixels but stays one,
 * so that it can be told from light. A variance below 0 is not known, and neither is its sum. */
kernel void accumulate(CONST_PLANES(other), CONST_PLANES(factor), CONST_PLANES(weights), CONST_PLANES(motion),
                       int block, int channels, int height, int width, int squared, int light, PLANES(sum))
{
    const int x = get_global_id(0), y = get_global_id(1);
    if (x >= width || y >= height)
        return;
    const taps t = TAPS;
    float part[4], weight[4], of_all = 0.f;
    int nearest = 0;
    for (int i = 0; i < 4; i++) {
        weight[i] = AT(weights, i, y, x);
        part[i] = weight[i] * (light ? AT(factor, 0, t.y[i / 2], t.x[i % 2]) : 1.f);
        of_all += weight[i];
        nearest = t.weight[i] > t.weight[nearest] ? i : nearest;
    }
    if (of_all == 0.f)
        return;
    const int v = t.y[nearest / 2], u = t.x[nearest % 2];
    const float left = light ? AT(factor, 0, v, u) : 1.f;
    const float held = squared ? SQUARE(of_all) * (1.f - left * left) : of_all * (1.f - left);
    for (int c = 0; c < channels; c++) {
        float gained = light ? held * AT(other, c, v, u) : 0.f;
        bool known = !squared || !light || AT(other, c, v, u) >= 0.f;
        for (int i = 0; i < 4; i++) {
            const float value = AT(other, c, t.y[i / 2], t.x[i % 2]);
            gained += (squared ? SQUARE(part[i]) : part[i]) * value;
            known = known && (!squared || weight[i] == 0.f || value >= 0.f);
        }
        const float before = AT(sum, c, y, x);
        AT(sum, c, y, x) = squared && (before < 0.f || !known) ? -1.f : before + gained;
    }
}

/* out = sum / total, or, of variances, over its square. */
kernel void normalise(CONST_PLANES(sum), CONST_PLANES(total), int height, int width, int squared, PLANES(out))
{
    const int x = get_global_id(0), y = get_global_id(1), c = get_global_id(2);
    if (x >= width || y >= height)
        return;
    const float all = AT(total, 0, y, x), value = AT(sum, c, y, x);
    AT(out, c, y, x) = squared ? (value < 0.f ? -1.f : value / (all * all)) : value / all;
}
