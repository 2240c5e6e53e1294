/* The search window of the prefilter: a disc, which holds half of the square around it, and what its corners would add to
 * the cost they do not take from the error. */
#ifndef MCDENOISE_WINDOW_H
#define MCDENOISE_WINDOW_H
#define IN_WINDOW(dx, dy, radius) ((dx) * (dx) + (dy) * (dy) <= (radius) * (radius))
#endif
