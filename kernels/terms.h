/* What is known of the features in and around a block of pixels: their means; how many principal components carry
 * something; the variance of each; and its direction, a unit vector of features. */
#ifndef MCDENOISE_TERMS_H
#define MCDENOISE_TERMS_H

#define BLOCK_FLOATS (FEATURES + 1 + FEATURES + FEATURES * FEATURES)
#define BLOCK_MEAN(block, a) (block)[a]
#define BLOCK_COUNT(block) (block)[FEATURES]
#define BLOCK_VARIANCE(block, k) (block)[FEATURES + 1 + (k)]
#define BLOCK_DIRECTION(block, k, a) (block)[2 * FEATURES + 1 + (k) * FEATURES + (a)]

#endif
