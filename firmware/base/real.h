/*
 * float32 helpers that give the same bits on every target: no libm, no contraction.
 * Pure, callable from interrupts.
 */
#ifndef BASE_REAL_H
#define BASE_REAL_H

#include <stdbool.h>
#include <stdint.h>

#define REAL_PI 3.14159265358979f

/* False for NaN and infinities, whatever the compiler flags. */
bool real_is_finite(float x);

/* |x| clipped to [low, high]. NaN stays NaN. */
float real_clip(float x, float low, float high);

float real_abs(float x);

/* Square root, correctly rounded; 0 for x <= 0. */
float real_sqrt(float x);

/* sin(2*pi*numerator/denominator), denominator > 0. Error below 3e-7. Exactly 0 at half turns,
 * exactly odd: sin(-x) = -sin(x). */
float real_sin_turn(uint32_t numerator, uint32_t denominator);

#endif
