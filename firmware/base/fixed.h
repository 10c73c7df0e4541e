/*
 * Fixed-point numbers: an int32_t or int64_t and how many of its bits stand behind the binary
 * point, which names and comments tell as Q24, Q30, ... A processor without floating point
 * multiplies two of them in one instruction. A product of Qa and Qb is Q(a+b), in 64 bits.
 *
 * Integer arithmetic alone, so the same bits on every target. A negative number shifted to the
 * right keeps its sign, as every compiler of this code has it (test_fixed.c). Pure, callable from
 * interrupts.
 */
#ifndef BASE_FIXED_H
#define BASE_FIXED_H

#include <stdint.h>

/* |x| * 2^bits to the nearest whole number, halves away from zero, clipped to +-FIXED_WIDE_MAX; so
 * is what is not finite. */
#define FIXED_WIDE_MAX ((int64_t)1 << 61)
int64_t fixed_from(float x, int32_t bits);

/* |x| / 2^bits to the nearest, halves up; the caller knows that it fits into 32 bits. |bits|: 1 to
 * 62; |x| less than 2^(bits-1) away from the ends of its range. */
static inline int32_t fixed_down(int64_t x, uint32_t bits) {
    return (int32_t)((x + ((int64_t)1 << (bits - 1u))) >> bits);
}

/* The same, clipped to 32 bits. */
int32_t fixed_clipped(int64_t x, uint32_t bits);

/* The same of |x| and what was left of those before, |left|, which gets what is left now: over many
 * of them rounding loses nothing. |bits| up to 31. */
int32_t fixed_carried(int64_t x, uint32_t bits, int32_t *left);

static inline int64_t fixed_dot(const int32_t a[3], const int32_t b[3]) {
    return (int64_t)a[0] * b[0] + (int64_t)a[1] * b[1] + (int64_t)a[2] * b[2];
}

/* |out| is neither of the factors. */
void fixed_cross(const int32_t a[3], const int32_t b[3], int64_t out[3]);

#endif
