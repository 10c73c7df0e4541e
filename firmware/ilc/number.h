/*
 * The number that the laws compute with: float on the board, double where ILC_DOUBLE is defined,
 * which the host does to recompute the thesis from the same source.
 *
 * With float everything here has the same bits on every target (base/real.h). With double the
 * square root is the host's, correctly rounded as IEEE 754 asks for. Pure, callable from
 * interrupts.
 */
#ifndef ILC_NUMBER_H
#define ILC_NUMBER_H

#include "ilc/number_type.h"

#include <stdbool.h>

/* A constant; in float no double is left of it. */
#define NUMBER(x) ((number_t)(x))

/* False for NaN and infinities. */
bool number_is_finite(number_t x);

number_t number_abs(number_t x);

/* |x| clipped to [low, high], neither of them NaN. NaN stays NaN. */
number_t number_clip(number_t x, number_t low, number_t high);

/* Square root; 0 for x <= 0. */
number_t number_sqrt(number_t x);

#endif
