/*
 * Comparisons of numbers as a processor without floating point makes them: with the integers that
 * their bits are, in a quarter of the time. As doubles they are what they are. Pure, callable from
 * interrupts.
 */
#ifndef ILC_NUMBER_ORDER_H
#define ILC_NUMBER_ORDER_H

#include "ilc/number_type.h"

#include <stdbool.h>

#ifdef ILC_DOUBLE
#include <math.h>

static inline bool number_is_nan(number_t x) { return isnan(x); }
static inline bool number_is_zero(number_t x) { return x == 0.0; }
static inline bool number_is_one(number_t x) { return x == 1.0; }
static inline number_t number_order(number_t x) { return x; }

#else
#include <stdint.h>
#include <string.h>

#define NUMBER_SIZE_BITS 0x7FFFFFFFu
#define NUMBER_INFINITY_BITS 0x7F800000u
#define NUMBER_ONE_BITS 0x3F800000u

static inline uint32_t number_bits(number_t x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline bool number_is_nan(number_t x) {
    return (number_bits(x) & NUMBER_SIZE_BITS) > NUMBER_INFINITY_BITS;
}

static inline bool number_is_zero(number_t x) { return (number_bits(x) & NUMBER_SIZE_BITS) == 0; }

static inline bool number_is_one(number_t x) { return number_bits(x) == NUMBER_ONE_BITS; }

/* Rises with |x|, the same for 0 and -0. Of numbers other than NaN. */
static inline int32_t number_order(number_t x) {
    const int32_t bits = (int32_t)number_bits(x);
    return bits < 0 ? INT32_MIN - bits : bits;
}

#endif

#endif
