/* Time since boot. */
#ifndef HAL_CLOCK_H
#define HAL_CLOCK_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

/* Microseconds since boot, monotonic, never wraps in practice. May be called from interrupts. */
uint64_t hal_time_us(const hal_t *hal);

/* Whether time comes from a crystal. False when it is dead and the board runs on its RC oscillator,
 * a few percent off: the links work, the servo gets no pulses until the board is mended. */
bool hal_clock_exact(const hal_t *hal);

#endif
