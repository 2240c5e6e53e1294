/* Planes of blocks, vector by vector: of WIDTH columns a bundle, the values of every plane, lies in one piece of
 * memory. What kernels need of a place comes from one stream then, not from one a plane, more of which than a few no
 * processor foresees. As PLANES(p), planes of a bundle lie WIDTH apart.
 */
#ifndef MCDENOISE_BUNDLES_H
#define MCDENOISE_BUNDLES_H
#include "common.h"

/* Where column x, a multiple of WIDTH, of so many planes lies in a row. */
#ifdef BUNDLED
#define PLACE(x, planes) ((x) * (planes))
#else
#define PLACE(x, planes) (x)
#endif

/* CHUNK columns and a vector to each side. */
#define LINE (CHUNK + 2 * WIDTH)

/* `lines` of LINE places, the first one column `first`: as many columns as `reach` beyond each end of a row of `width`
 * mirror those within. */
inline void mirror_ends(float *line, int lines, int first, int reach, int width)
{
    for (int i = -reach; i < reach; i++) {
        const int column = i < 0 ? i : width + i, to = column - first, from = reflect(column, width) - first;
        if (to >= 0 && to < LINE)
            for (int k = 0; k < lines; k++)
                line[k * LINE + to] = line[k * LINE + from];
    }
}
#endif
