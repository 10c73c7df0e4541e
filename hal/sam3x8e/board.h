/*
 * The fish's board: what hal_t points at, and what the files of this folder share. Each driver owns
 * its part of the struct; there is one, defined in main.c.
 */
#ifndef SAM3X8E_BOARD_H
#define SAM3X8E_BOARD_H

#include "clock_tree.h"
#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"
#include "interrupts.h"
#include "serial_port.h"

/* One per tick: the mean over 100 ms. */
#define BATTERY_SAMPLES 5u

struct hal {
    clock_tree_t clocks; /* clock_tree.c */
    volatile bool wake;  /* set by every handler: the main loop has something to do */

    volatile uint32_t ticks; /* servo.c: 20 ms frames since boot */

    uint64_t time_us;       /* timebase.c: the time when the counter was at ... */
    uint32_t time_last;     /* ... this */
    uint32_t counts_per_us; /* timebase.c; 0 until it runs */

    serial_port_t ports[HAL_PORT_COUNT];       /* serial.c */
    uint8_t unique_id[16];                     /* chip.c, read once at boot */
    hal_reset_cause_t reset_cause;             /* chip.c, read once at boot */
    uint16_t battery_samples[BATTERY_SAMPLES]; /* battery.c: the last ones, counts */
    uint8_t battery_at;                        /* ... the oldest of them */
    volatile uint32_t battery_sum;
};

extern hal_t board;

/* Once at boot, in this order, with the clocks up; the servo's after app_init(), as it starts the
 * tick. */
void timebase_init(hal_t *hal);
void chip_init(hal_t *hal);
void storage_flash_init(hal_t *hal);
void serial_init(hal_t *hal);
void battery_init(hal_t *hal);
void servo_init(hal_t *hal);

/* First in the tick: its interrupt is taken, and counted. */
void servo_tick_isr(hal_t *hal);

/* Keeps the time from wrapping; at least once in 100 s. */
void timebase_tick_isr(hal_t *hal);

/* Once per tick: battery sample. */
void battery_tick_isr(hal_t *hal);

/* Whether the 3.3 V rail is high enough to write flash (supply monitor at 2.9 V). */
bool supply_good(void);

#endif
