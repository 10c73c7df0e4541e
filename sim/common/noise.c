#include "noise.h"

#include "noise_inline.h"

uint64_t noise_key(uint64_t seed, noise_stream_t stream, uint64_t trial) {
    const uint64_t a = noise_bits(seed, (uint64_t)stream);
    return noise_bits(a, trial);
}

double noise_uniform(uint64_t key, uint64_t sample) {
    return (double)(noise_bits(key, sample) >> 11) * 0x1p-53;
}

double noise_normal(uint64_t key, uint64_t sample) {
    return noise_normal_of(noise_bits(key, sample));
}
