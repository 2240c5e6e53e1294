/* Sums over (2 radius + 1)-wide windows, written transposed, as in box.cl, for GPUs.
 *
 * A work-item slides a window down rows_each rows of one column; neighbours in a group's row have neighbouring columns,
 * so that they read whole lines of memory, and the group's rows follow one another down the image. What they write
 * goes down a column of the transposed image, a line of memory apart: so BLOCK results a work-item are collected in
 * local memory and written by rows, BLOCK floats at a time. Rows of a block are 32 / BLOCK floats longer than they need
 * be, so that work-items that read a column of it do not meet in one bank.
 *
 * Local memory: GROUP_ROWS BLOCK (GROUP_COLUMNS + 32 / BLOCK) floats, 17 KiB with groups of 32 x 8, BLOCK = 16.
 * A value: 2 global loads, 1 global store, 1 local load, 1 local store, 14 operations; two barriers a block.
 */
#include "two_sum.h"

#define BLOCK_ROW (GROUP_COLUMNS + 32 / BLOCK)

/* rows_each: a multiple of BLOCK */
kernel __attribute__((reqd_work_group_size(GROUP_COLUMNS, GROUP_ROWS, 1)))
void box_transposed_group(CONST_PLANES(in), int height, int width, PLANES(out), int radius, int rows_each, float scale)
{
    local float blocks[GROUP_ROWS][BLOCK * BLOCK_ROW];
    const int column = get_local_id(0), c = get_global_id(2);
    const int left = get_group_id(0) * GROUP_COLUMNS, x = min(left + column, width - 1);
    const int first = get_global_id(1) * rows_each;
    const int group_first = get_group_id(1) * GROUP_ROWS * rows_each;
    local float *block = blocks[get_local_id(1)];

    float sum = 0.f, lost = 0.f;
    if (first < height)
        for (int k = -radius; k <= radius; k++)
            accumulate(&sum, &lost, AT(in, c, reflect(first + k, height), x));
    /* The same number of blocks for all of the group, because of the barriers; rows past the end go unused. */
    const int steps = min(rows_each, height - group_first);
    for (int done = 0; done < steps; done += BLOCK) {
        for (int i = 0; i < BLOCK; i++) {
            const int y = min(first + done + i, height - 1);
            block[i * BLOCK_ROW + column] = mean_of_sum(sum, lost, 2 * radius + 1, scale);
            accumulate(&sum, &lost, AT(in, c, reflect(y + radius + 1, height), x));
            accumulate(&sum, &lost, -AT(in, c, reflect(y - radius, height), x));
        }
        barrier(CLK_LOCAL_MEM_FENCE);
        for (int n = column; n < BLOCK * GROUP_COLUMNS; n += GROUP_COLUMNS) {
            const int i = n % BLOCK, j = n / BLOCK;
            if (left + j < width && first + done + i < height)
                AT(out, c, left + j, first + done + i) = block[i * BLOCK_ROW + j];
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
}
