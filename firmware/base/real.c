#include "base/real.h"

#include "base/panic.h"

#include <math.h>
#include <string.h>

#define EXPONENT_ALL_ONES 0x7F800000u
#define SIGN_BIT 0x80000000u
#define HIDDEN_BIT 0x00800000u
#define EXPONENT_BIAS 127

_Static_assert(sizeof(float) == sizeof(uint32_t), "float is IEEE-754 single");

static uint32_t bits_of(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static float of_bits(uint32_t bits) {
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

bool real_is_finite(float x) { return (bits_of(x) & EXPONENT_ALL_ONES) != EXPONENT_ALL_ONES; }

float real_clip(float x, float low, float high) {
    if (x < low) {
        return low;
    }
    return x > high ? high : x;
}

float real_abs(float x) { return of_bits(bits_of(x) & ~SIGN_BIT); }

uint64_t real_whole_u64(float x) {
    if (!(x >= 1.0f && x < 0x1p64f)) {
        return 0;
    }
    const uint32_t bits = bits_of(x);
    const int32_t shift = (int32_t)(bits >> 23) - EXPONENT_BIAS - 23;
    const uint64_t mantissa = (bits & (HIDDEN_BIT - 1u)) | HIDDEN_BIT;
    return shift >= 0 ? mantissa << shift : mantissa >> -shift;
}

#if defined(__SSE2__) || defined(__aarch64__)

/* IEEE-754 has the processor's own root correctly rounded, as the one below. */
float real_sqrt(float x) {
    if (x > 0.0f) {
        return sqrtf(x);
    }
    return x <= 0.0f ? 0.0f : x;
}

#else

/* Largest 25-bit root with root * root <= square, bit by bit. */
static uint32_t integer_root(uint64_t square) {
    uint32_t root = 0;
    for (uint32_t bit = 1u << 24; bit != 0; bit >>= 1) {
        const uint32_t candidate = root | bit;
        if ((uint64_t)candidate * candidate <= square) {
            root = candidate;
        }
    }
    return root;
}

float real_sqrt(float x) {
    const uint32_t bits = bits_of(x);
    if ((bits & ~SIGN_BIT) > EXPONENT_ALL_ONES || bits == EXPONENT_ALL_ONES) {
        return x;
    }
    if (bits == 0 || (bits & SIGN_BIT) != 0) {
        return 0.0f;
    }
    int32_t exponent = (int32_t)(bits >> 23) - EXPONENT_BIAS;
    uint32_t mantissa = bits & (HIDDEN_BIT - 1u);
    if (exponent == -EXPONENT_BIAS) {
        exponent = 1 - EXPONENT_BIAS;
        while (mantissa < HIDDEN_BIT) {
            mantissa <<= 1;
            exponent--;
        }
    } else {
        mantissa |= HIDDEN_BIT;
    }
    if (exponent % 2 != 0) {
        mantissa <<= 1;
        exponent--;
    }
    /* 24 bits of result and one to round by. A tie cannot be: the square of an odd root is odd. */
    const uint32_t root = (integer_root((uint64_t)mantissa << 25) + 1u) >> 1;
    return of_bits(((uint32_t)(exponent / 2 + EXPONENT_BIAS) << 23) + (root - HIDDEN_BIT));
}

#endif

/* sin(pi*x) for 0 <= x <= 1/2. Minimax fit of degree 9, then the last bits of the coefficients
 * chosen so that the float32 value is 1 at 1/2 and never above; error below 1.8e-7 over 400 000
 * points. */
static float sin_half_turn(float x) {
    const float square = x * x;
    float sum = 0.0772201195f;
    sum = sum * square - 0.59804523f;
    sum = sum * square + 2.55003214f;
    sum = sum * square - 5.16770792f;
    sum = sum * square + 3.14159274f;
    return sum * x;
}

float real_sin_turn(uint32_t numerator, uint32_t denominator) {
    REQUIRE(denominator > 0);
    uint32_t part = numerator % denominator;
    const bool negative = part > denominator - part;
    if (negative) {
        part = denominator - part;
    }
    /* At most half a turn is left, so twice the part fits; it counts half turns. */
    part *= 2u;
    if (part > denominator - part) {
        part = denominator - part;
    }
    const float sine = sin_half_turn((float)part / (float)denominator);
    return negative ? -sine : sine;
}
