/*
 * float32 helpers that give the same bits on every target: no libm, no contraction.
 * Pure, callable from interrupts.
 */
#ifndef BASE_REAL_H
#define BASE_REAL_H

#include <stdbool.h>
#include <stdint.h>

#define REAL_PI 3.14159265358979f
#define REAL_RAD_PER_DEG (REAL_PI / 180.0f)

/* False for NaN and infinities, whatever the compiler flags. */
bool real_is_finite(float x);

/* |x| clipped to [low, high]. NaN stays NaN. */
float real_clip(float x, float low, float high);

float real_abs(float x);

/* x >= 0 without its fraction, as the cast does it; 0 for what is below 0, NaN or 2^64 and above.
 * The compiler's own conversion brings 1.3 KB of double arithmetic into the image. */
uint64_t real_whole_u64(float x);

/* Square root, correctly rounded by integer arithmetic; 0 for x <= 0; NaN, +infinity unchanged. */
float real_sqrt(float x);

/* sin(2*pi*numerator/denominator), denominator > 0. Error below 3e-7, |value| <= 1. Exactly 0 at
 * half turns, +-1 at odd quarter turns, and exactly symmetric: turning back or mirroring a quarter
 * turn gives the same bits but for the sign. Numerators beyond a turn wrap. */
float real_sin_turn(uint32_t numerator, uint32_t denominator);

#endif
