/* The arithmetic of noise.h, for loops over many keys. */
#ifndef SIM_NOISE_INLINE_H
#define SIM_NOISE_INLINE_H

#include <stdint.h>

#define NOISE_GOLDEN 0x9E3779B97F4A7C15u
#define NOISE_INVERSE_SIGMA 0.248706938 /* 1/sqrt(16 + 1/6) */

/* The finaliser of splitmix64. */
static inline uint64_t noise_mix(uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static inline uint64_t noise_bits(uint64_t key, uint64_t sample) {
    return noise_mix(key + (sample + 1u) * NOISE_GOLDEN);
}

static inline uint64_t noise_ones(uint64_t x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0Fu;
    return (x * 0x0101010101010101u) >> 56;
}

/* The number of ones among 64 random bits is binomial with variance 16; a triangular dither of
 * variance 1/6 on top turns its steps into a continuous, piecewise linear density. Three
 * multiplications and no libm: an IMU frame needs seven of these. */
static inline double noise_normal_of(uint64_t coins) {
    const uint64_t dither = noise_mix(coins + NOISE_GOLDEN);
    const double triangle = (double)(int64_t)(dither & UINT32_MAX) * 0x1p-32 +
                            (double)(int64_t)(dither >> 32) * 0x1p-32 - 1.0;
    return ((double)((int64_t)noise_ones(coins) - 32) + triangle) * NOISE_INVERSE_SIGMA;
}

#endif
