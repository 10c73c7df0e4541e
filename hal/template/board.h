/*
 * The template of a port: copy this folder, rename it, and fill in one function after the other
 * (docs/how-to/port.md). As it is, it builds and does nothing.
 */
#ifndef TEMPLATE_BOARD_H
#define TEMPLATE_BOARD_H

#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/guard.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"

/* Whatever the drivers keep. One struct, defined in main.c; each driver owns its part. */
struct hal {
    volatile bool wake; /* set by every handler: the main loop has something to do */
    uint64_t time_us;
    uint16_t pulse_ticks[HAL_SERVO_COUNT];
    uint64_t guarded[HAL_GUARDED_BYTES / sizeof(uint64_t)];
};

extern hal_t board;

/* The tick's work: the handler of the servo's frame calls it. */
void board_tick_isr(void);

#endif
