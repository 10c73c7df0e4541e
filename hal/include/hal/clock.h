/* Time since boot. */
#ifndef HAL_CLOCK_H
#define HAL_CLOCK_H

#include "hal/hal.h"

#include <stdint.h>

/* Microseconds since boot, monotonic, never wraps in practice. May be called from interrupts. */
uint64_t hal_time_us(const hal_t *hal);

#endif
