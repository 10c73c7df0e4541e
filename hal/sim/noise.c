#include "noise.h"

#define GOLDEN 0x9E3779B97F4A7C15u

/* The finaliser of splitmix64. */
static uint64_t mix(uint64_t z) {
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
    z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
    return z ^ (z >> 31);
}

static uint64_t bits(uint64_t key, uint64_t sample) { return mix(key + (sample + 1u) * GOLDEN); }

static int ones(uint64_t x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0F0F0F0F0F0F0F0Fu;
    return (int)((x * 0x0101010101010101u) >> 56);
}

uint64_t noise_key(uint64_t seed, noise_stream_t stream, uint64_t trial) {
    const uint64_t a = bits(seed, (uint64_t)stream);
    return bits(a, trial);
}

double noise_uniform(uint64_t key, uint64_t sample) {
    return (double)(bits(key, sample) >> 11) * 0x1p-53;
}

/* The number of ones among 64 random bits is binomial with variance 16; a triangular dither of
 * variance 1/6 on top turns its steps into a continuous, piecewise linear density. Three
 * multiplications and no libm: an IMU frame needs seven of these. */
double noise_normal(uint64_t key, uint64_t sample) {
    static const double inverse_sigma = 0.248706938; /* 1/sqrt(16 + 1/6) */
    const uint64_t coins = bits(key, sample);
    const uint64_t dither = mix(coins + GOLDEN);
    const double triangle =
        (double)(uint32_t)dither * 0x1p-32 + (double)(dither >> 32) * 0x1p-32 - 1.0;
    return ((double)(ones(coins) - 32) + triangle) * inverse_sigma;
}
