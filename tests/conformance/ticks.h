/* What the tick notes by the board's own clock, and the pulses it orders. */
#ifndef CONFORMANCE_TICKS_H
#define CONFORMANCE_TICKS_H

#include "hal/hal.h"
#include "hal/servo.h"

#include <stdint.h>

/* Since ticks_begin(). */
typedef struct {
    uint32_t count;
    uint64_t first_us, last_us;
    uint32_t shortest_us, longest_us; /* between two ticks */
} tick_times_t;

typedef struct {
    tick_times_t times;
    uint16_t pulse_ticks[HAL_SERVO_COUNT]; /* 0: no pulses */
} ticks_t;

void ticks_begin(ticks_t *ticks, hal_t *hal);

/* The tick is kept out meanwhile. */
tick_times_t ticks_read(const ticks_t *ticks, hal_t *hal);

/* Of ticks_begin() on; also while the tick is locked out. */
uint32_t ticks_count(const ticks_t *ticks);

void ticks_isr(ticks_t *ticks, hal_t *hal);

#endif
