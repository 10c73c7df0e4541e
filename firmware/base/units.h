/* Constants shared by everything that counts time. */
#ifndef BASE_UNITS_H
#define BASE_UNITS_H

#include <stdint.h>

#define FRAME_US 20000u /* servo frame and control tick: 50 Hz */
#define FRAME_S 0.02f
#define BEATS_MAX 512u /* longest trial, in beats */

/* |value| / 1000, rounded down: microseconds to milliseconds, nanoseconds to microseconds. Pure,
 * callable from interrupts. */
uint64_t units_thousandth(uint64_t value);

#endif
