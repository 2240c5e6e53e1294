/* First-order regression, as in regression.cl, for GPUs: a work-group fits a rectangle of pixels, one a work-item.
 *
 * The offsets of the window are visited once, and the moments of all terms stay in registers: with seven components and
 * four colours 95 of them, with no features and three colours 15. That takes indices known to the compiler, so loops
 * over terms are unrolled. Terms are taken about the pixel itself: nothing is moved at the end, and nothing cancels.
 *
 * What neighbours share of their patches goes through local memory, in three stages an offset apart: while the moments
 * of one offset are added, the rows of the next one's patches are summed and the differences of the one after are made.
 * Each stage reads what the step before wrote; with two buffers a stage, an offset costs one barrier.
 *
 * Components depend on the block, so a group, which must lie in one, makes those of the pixels around it, in local
 * memory too: as many rows as fit, and as offsets come row by row, few are made again. A component that the block
 * leaves out costs nothing: how many are in use is the same for the whole group, so the moments of the others are
 * skipped without divergence.
 *
 * In a group of 32x8, with patches of 5x5, seven components and four colours, a pixel and offset cost about 260
 * operations, 200 of them for the moments; 27 B read (tone, variance) and 16 B (colours) from global memory, most of it
 * from the cache, as the window's other offsets read it too; 19 B written to and 90 B read from local memory, of which
 * a group has up to 32 KB. Compiled for sm_80 and gfx906 that is 170 to 240 registers, and none is spilled; what
 * solving needs lies in private memory.
 */
#include "first_order.h"
#include "weight.h"

#define ITEMS (GROUP_COLUMNS * GROUP_ROWS)
#define MOMENTS COLOR_MOMENT(TERMS, COLORS, 0)

/* The windows that are fitted, from the smallest, and how many offsets each takes. */
#ifdef WITH_INNER
#define WINDOWS 2
#else
#define WINDOWS 1
#endif
#define OFFSETS_OF(window) ((window) + 1 < WINDOWS ? INNER_OFFSETS : OFFSETS)

/* From an offset's differences to its moments. */
#define STAGES 3

/* Pixels of all patches of a group, and how many an item compares. */
#define CELL_COLUMNS (GROUP_COLUMNS + 2 * PATCH_RADIUS)
#define CELL_ROWS (GROUP_ROWS + 2 * PATCH_RADIUS)
#define CELLS (CELL_COLUMNS * CELL_ROWS)
#define CELLS_OF_ITEM ((CELLS + ITEMS - 1) / ITEMS)
#define CELL_AT(cell, row) ((cell) + (cell) / CELL_COLUMNS * ((row) - CELL_COLUMNS)) /* in planes, from the first */

/* Components: the pixels to a row, and the rows that are kept at a time; with the patches they fit in what every device
 * has, unless windows are huge. */
#define LOCAL_BYTES 32768
#define PATCH_BYTES (8 * (CELLS + 2 * CELL_ROWS * GROUP_COLUMNS))
#define LINE (GROUP_COLUMNS + 2 * REACH)
#define LINE_BYTES (4 * FEATURES * LINE)
#define DIRECTION_FLOATS ((FEATURES + 3) / 4 * 4) /* so that they are read by fours */
#define FITTING ((LOCAL_BYTES - PATCH_BYTES - 4 * FEATURES * DIRECTION_FLOATS) / (FEATURES > 0 ? LINE_BYTES : 1))
#define ALL_LINES (GROUP_ROWS + 2 * REACH)
#define LINES (FITTING >= ALL_LINES ? ALL_LINES : FITTING > GROUP_ROWS ? FITTING : GROUP_ROWS)

/* Three channels and the sum of their variances. */
INLINE float4 pixel_of(global const float *tone, int plane, global const float *variance)
{
    return (float4)(tone[0], tone[plane], tone[2 * plane], variance[0]);
}

INLINE float excess_of(float4 here, float4 there)
{
    const float4 d = here - there;
    return excess_of_noise(d.x * d.x + d.y * d.y + d.z * d.z, here.w, there.w);
}

/* Sums over the PATCH values of `wide`, `stride` apart, and over those of `narrow` in the patch's inner half. */
INLINE float2 sums_of(const local float *wide, const local float *narrow, int stride)
{
    float2 sums = (float2)(0.f, 0.f);
#pragma unroll
    for (int k = 0; k < PATCH; k++) {
        sums.x += wide[k * stride];
        if (k >= PATCH_RADIUS - INNER_RADIUS && k <= PATCH_RADIUS + INNER_RADIUS)
            sums.y += narrow[k * stride];
    }
    return sums;
}

#if FEATURES > 0
/* The components of some lines of pixels. corner: the first feature of the first pixel. */
INLINE void make_components(global const float *corner, int row, int plane, int lines, global const float *block,
                            local float direction[FEATURES][DIRECTION_FLOATS], int count,
                            local float component[FEATURES][LINES][LINE])
{
    for (int line = get_local_id(1); line < lines; line += GROUP_ROWS)
        for (int c = get_local_id(0); c < LINE; c += GROUP_COLUMNS) {
            float feature[FEATURES];
#pragma unroll
            for (int q = 0; q < FEATURES; q++)
                feature[q] = corner[q * plane + line * row + c] - BLOCK_MEAN(block, q);
            for (int k = 0; k < count; k++) {
                float sum = direction[k][0] * feature[0];
#pragma unroll
                for (int q = 1; q < FEATURES; q++)
                    sum += direction[k][q] * feature[q];
                component[k][line][c] = sum;
            }
        }
}
#define MAKE_COMPONENTS                                                                                                \
    make_components(stack + INDEX(stack, 0, y0 + first_line, x0 - REACH), stack_row, stack_plane,                      \
                    min(LINES, GROUP_ROWS + REACH - first_line), block, direction, terms - COMPONENT, component)
#endif

INLINE void add_moments(float moments[MOMENTS], float weight, const float term[TERMS], int terms,
                        const float color[COLORS])
{
#pragma unroll
    for (int a = 0; a < TERMS; a++)
        if (a < COMPONENT || a < terms) {
            const float weighted = weight * term[a];
#pragma unroll
            for (int b = 0; b < TERMS; b++) /* not b <= a: some compilers unroll constant bounds only */
                if (b <= a)
                    moments[LOWER(a, b)] += weighted * term[b];
#pragma unroll
            for (int k = 0; k < COLORS; k++)
                moments[COLOR_MOMENT(TERMS, k, a)] += weighted * color[k];
        }
}

/* In a copy of the moments, as solving takes indices that are not known. */
INLINE void fit(const float moments[MOMENTS], int terms, const float ridges[TERMS], float ridge,
#if FEATURES > 0
                const float direction[FEATURES][FEATURES], const fits noise[FEATURES],
#endif
                float result[COLORS])
{
    fits m[LOWER(TERMS, 0)], least[TERMS], z[TERMS];
#pragma unroll
    for (int i = 0; i < LOWER(TERMS, 0); i++)
        m[i].of[0] = moments[i];
#pragma unroll
    for (int a = 0; a < TERMS; a++) {
        least[a].of[0] = a == 0 ? moments[0] : moments[0] * ridges[a];
        z[a].of[0] = 0.f;
    }
#if FEATURES > 0
    add_ridges(m, terms, least, ridge, direction, noise);
#else
    add_ridges(m, terms, least, ridge);
#endif
    cholesky(m, terms, least);
    solve_for_constant(m, terms, z);
#pragma unroll
    for (int k = 0; k < COLORS; k++) {
        result[k] = 0.f;
#pragma unroll
        for (int a = 0; a < TERMS; a++)
            result[k] += z[a].of[0] * moments[COLOR_MOMENT(TERMS, k, a)];
    }
}

/* offsets: (x, y) of the window's pixels, in pixels, row by row; those of the inner window come first. The rest as in
 * regression.cl. */
kernel __attribute__((reqd_work_group_size(GROUP_COLUMNS, GROUP_ROWS, 1)))
void regress(constant float2 *offsets, CONST_PLANES(tone), CONST_PLANES(variance), CONST_PLANES(stack),
#if FEATURES > 0
             CONST_PLANES(noise), global const float *restrict blocks, int blocks_across,
#endif
             int height, int width, float bandwidth, float ridge, float noise_ridge, float position_ridge,
             float darkest,
#ifdef WITH_INNER
             PLANES(inner),
#endif
             PLANES(out))
{
    local float excess[2][CELLS], wide[2][CELL_ROWS][GROUP_COLUMNS], narrow[2][CELL_ROWS][GROUP_COLUMNS];
    const int lx = get_local_id(0), ly = get_local_id(1), item = ly * GROUP_COLUMNS + lx;
    const int x0 = get_group_id(0) * GROUP_COLUMNS, y0 = get_group_id(1) * GROUP_ROWS, x = x0 + lx, y = y0 + ly;
    const float scale = -0.25f / (bandwidth * bandwidth);

    int terms = COMPONENT;
#if FEATURES > 0
    local float component[FEATURES][LINES][LINE], direction[FEATURES][DIRECTION_FLOATS];
    global const float *block = blocks + BLOCK_FLOATS * (y0 / BLOCK_ROWS * blocks_across + x0 / BLOCK_COLUMNS);
    terms += (int)BLOCK_COUNT(block);
    for (int k = ly; k < terms - COMPONENT; k += GROUP_ROWS)
        for (int q = lx; q < FEATURES; q += GROUP_COLUMNS)
            direction[k][q] = BLOCK_DIRECTION(block, k, q);
    barrier(CLK_LOCAL_MEM_FENCE);
    int first_line = LINES == ALL_LINES ? -REACH : 0; /* that of the components, counted from y0 */
    MAKE_COMPONENTS;
    barrier(CLK_LOCAL_MEM_FENCE);
    float own[FEATURES];
#pragma unroll
    for (int k = 0; k < FEATURES; k++)
        own[k] = COMPONENT + k < terms ? component[k][ly - first_line][lx + REACH] : 0.f;
#endif

    /* The pixels that this item compares: where they are, and what they hold. */
    int tone_at[CELLS_OF_ITEM], variance_at[CELLS_OF_ITEM];
    float4 here[CELLS_OF_ITEM];
#pragma unroll
    for (int n = 0; n < CELLS_OF_ITEM; n++) {
        const int cell = min(item + n * ITEMS, CELLS - 1);
        tone_at[n] = INDEX(tone, 0, y0 - PATCH_RADIUS, x0 - PATCH_RADIUS) + CELL_AT(cell, tone_row);
        variance_at[n] = INDEX(variance, 0, y0 - PATCH_RADIUS, x0 - PATCH_RADIUS) + CELL_AT(cell, variance_row);
        here[n] = pixel_of(tone + tone_at[n], tone_plane, variance + variance_at[n]);
    }
    float moments[MOMENTS], base[COLORS];
#pragma unroll
    for (int i = 0; i < MOMENTS; i++)
        moments[i] = 0.f;
#pragma unroll
    for (int k = 0; k < COLORS; k++)
        base[k] = AT(stack, FEATURES + k, y, x);

    int step = 0;
    for (int window = 0; window < WINDOWS; window++) {
        for (; step < OFFSETS_OF(window) + STAGES - 1; step++) {
            const int now = step & 1, before = now ^ 1;
            barrier(CLK_LOCAL_MEM_FENCE);
            if (step < OFFSETS) {
                const int dx = offsets[step].x, dy = offsets[step].y;
                const int move = dy * tone_row + dx, variance_move = dy * variance_row + dx;
#pragma unroll
                for (int n = 0; n < CELLS_OF_ITEM; n++)
                    if (item + n * ITEMS < CELLS) {
                        const float4 there = pixel_of(tone + tone_at[n] + move, tone_plane,
                                                      variance + variance_at[n] + variance_move);
                        excess[now][item + n * ITEMS] = excess_of(here[n], there);
                    }
            }
            if (step >= 1 && step - 1 < OFFSETS)
                for (int row = ly; row < CELL_ROWS; row += GROUP_ROWS) {
                    const local float *first = &excess[before][row * CELL_COLUMNS + lx];
                    const float2 sums = sums_of(first, first, 1);
                    wide[now][row][lx] = sums.x;
                    narrow[now][row][lx] = sums.y;
                }
            if (step >= 2) {
                const int dx = offsets[step - 2].x, dy = offsets[step - 2].y;
                float term[TERMS], color[COLORS];
                term[0] = 1.f;
                term[1] = offsets[step - 2].x;
                term[2] = offsets[step - 2].y;
#if FEATURES > 0
                if (dy < first_line || dy + GROUP_ROWS > first_line + LINES) {
                    first_line = dy;
                    MAKE_COMPONENTS;
                    barrier(CLK_LOCAL_MEM_FENCE);
                }
#pragma unroll
                for (int k = 0; k < FEATURES; k++)
                    if (COMPONENT + k < terms)
                        term[COMPONENT + k] = component[k][ly + dy - first_line][lx + REACH + dx] - own[k];
#endif
                global const float *there = stack + INDEX(stack, FEATURES, y + dy, x + dx);
#pragma unroll
                for (int k = 0; k < COLORS; k++)
                    color[k] = there[k * stack_plane] - base[k];
                const float2 sums = sums_of(&wide[before][ly][lx], &narrow[before][ly][lx], GROUP_COLUMNS);
                add_moments(moments, weight_of_sums(sums.x, sums.y, scale), term, terms, color);
            }
        }

        if (x < width && y < height) {
            float ridges[TERMS], result[COLORS];
            ridges[1] = ridges[2] = ridge_of_position(position_ridge);
#if FEATURES > 0
            float directions[FEATURES][FEATURES];
            fits noises[FEATURES];
#pragma unroll
            for (int k = 0; k < FEATURES; k++) {
                ridges[COMPONENT + k] =
                    COMPONENT + k < terms ? ridge_of_component(BLOCK_VARIANCE(block, k), own[k]) : 0.f;
                noises[k].of[0] = noise_ridge * AT(noise, k, y, x);
                for (int q = 0; q < FEATURES && COMPONENT + k < terms; q++)
                    directions[k][q] = direction[k][q];
            }
            fit(moments, terms, ridges, ridge, directions, noises, result);
#else
            fit(moments, terms, ridges, ridge, result);
#endif
#ifdef WITH_INNER
            if (window + 1 < WINDOWS)
                STORE_FIT(result, base, y, x, inner);
            else
#endif
                STORE_FIT(result, base, y, x, out);
        }
    }
}
