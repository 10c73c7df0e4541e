/*
 * The conformance suite: it runs on a board in place of the firmware, uses hal/include/hal alone
 * and judges whether the board fulfils it. README.md describes the commands and answers.
 *
 * A scenario is a state machine that the main loop steps: on the simulated board time stands still
 * within a step, so that nothing may wait there.
 */
#ifndef CONFORMANCE_SUITE_H
#define CONFORMANCE_SUITE_H

#include "console.h"
#include "ticks.h"

#include "hal/flash.h"
#include "hal/hal.h"
#include "hal/serial.h"
#include "hal/system.h"

#include <stdbool.h>
#include <stdint.h>

/* A block that is sent or compared; the largest ring of a port that the suite can fill, and one. */
#define SUITE_BLOCK_BYTES 4097u

typedef struct suite suite_t;

typedef struct {
    const char *name;
    void (*begin)(suite_t *suite);
    bool (*step)(suite_t *suite); /* true: it is over */
} scenario_t;

/* What a scenario keeps from step to step; all zero when it begins. */
typedef struct {
    uint32_t phase, done, wrong;
    uint32_t offset;          /* in the flash */
    uint32_t least, most;     /* of what is measured */
    uint64_t total, since_us; /* ... its sum; begin of the phase */
    hal_serial_errors_t errors;
} progress_t;

struct suite {
    hal_t *hal;
    console_t console;
    ticks_t ticks;
    const scenario_t *running; /* NULL: waits for a command */
    progress_t progress;
    bool starving; /* the watchdog is not fed */
    uint8_t block[SUITE_BLOCK_BYTES];
};

extern const scenario_t clock_scenario, tick_scenario, lock_scenario;
extern const scenario_t flash_bounds_scenario, flash_write_scenario;
extern const scenario_t flash_keep_scenario, flash_kept_scenario;
extern const scenario_t serial_write_scenario, serial_baud_scenario;
extern const scenario_t loopback_scenario, overrun_scenario;
extern const scenario_t watchdog_scenario, crash_scenario, crash_record_scenario;
extern const scenario_t crash_forget_scenario, battery_scenario, led_scenario;

#endif
