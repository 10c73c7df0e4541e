#include "base/fixed.h"

#include <string.h>

#define MANTISSA_BITS 23
#define HIDDEN_BIT (1u << MANTISSA_BITS)
#define EXPONENT_BIAS 127

int64_t fixed_from(float x, int32_t bits) {
    uint32_t word;
    memcpy(&word, &x, sizeof word);
    const int32_t exponent = (int32_t)(word >> MANTISSA_BITS & 0xFFu);
    const int32_t up = exponent - EXPONENT_BIAS - MANTISSA_BITS + bits;
    const uint32_t mantissa = (word & (HIDDEN_BIT - 1u)) | HIDDEN_BIT;
    int64_t size = 0;
    if (exponent == 0xFF || up > 60 - MANTISSA_BITS) {
        size = FIXED_WIDE_MAX;
    } else if (up >= 0) {
        size = (int64_t)mantissa << up;
    } else if (up >= -MANTISSA_BITS - 1) {
        size = ((mantissa >> (-up - 1)) + 1u) >> 1;
    }
    return word >> 31 != 0 ? -size : size;
}

int32_t fixed_clipped(int64_t x, uint32_t bits) {
    const int64_t down = ((x >> (bits - 1u)) + 1) >> 1;
    const int32_t fits = (int32_t)down;
    if (fits == down) {
        return fits;
    }
    return x < 0 ? INT32_MIN : INT32_MAX;
}

int32_t fixed_carried(int64_t x, uint32_t bits, int32_t *left) {
    x += *left;
    const int32_t down = fixed_clipped(x, bits);
    *left = (int32_t)(x - ((int64_t)down * ((int64_t)1 << bits)));
    return down;
}

void fixed_cross(const int32_t a[3], const int32_t b[3], int64_t out[3]) {
    for (uint32_t i = 0, j = 1, k = 2; i < 3u; j = k, k = i++) {
        out[i] = (int64_t)a[j] * b[k] - (int64_t)a[k] * b[j];
    }
}
