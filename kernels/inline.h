/* For functions that must become part of the kernel: one that is left a function takes arrays by address, so they
 * cannot be registers, and by C99's rules plain `inline` does not even give it a definition to call. */
#ifndef MCDENOISE_INLINE_H
#define MCDENOISE_INLINE_H
#define INLINE static inline __attribute__((always_inline))
#endif
