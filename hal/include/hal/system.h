/* The board itself: identity, reset, battery, LED, watchdog, interrupt lock. */
#ifndef HAL_SYSTEM_H
#define HAL_SYSTEM_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    HAL_RESET_POWER = 0,
    HAL_RESET_BACKUP = 1,
    HAL_RESET_WATCHDOG = 2,
    HAL_RESET_SOFTWARE = 3,
    HAL_RESET_PIN = 4
} hal_reset_cause_t;

typedef enum {
    HAL_CRASH_ASSERTION = 1,    /* panic() */
    HAL_CRASH_HARD_FAULT = 2,   /* a fault of no kind below */
    HAL_CRASH_MEMORY_FAULT = 3, /* the stack ran into its guard, a write where none may be */
    HAL_CRASH_BUS_FAULT = 4,
    HAL_CRASH_USAGE_FAULT = 5, /* division by zero, undefined instruction */
    HAL_CRASH_INTERRUPT = 6    /* one that nobody expects */
} hal_crash_kind_t;

#define HAL_CRASH_WHERE_BYTES 48u
#define HAL_CRASH_REGISTERS 12u
#define HAL_CRASH_NAME_BYTES 8u
#define HAL_CRASH_STACK_WORDS 32u

/* How the firmware died. Registers and stack are those of the moment; what a core does not have or
 * could not save is 0. */
typedef struct {
    uint32_t kind;                     /* hal_crash_kind_t */
    uint32_t crashes;                  /* since power-on */
    uint64_t time_us;                  /* since the boot that crashed */
    char where[HAL_CRASH_WHERE_BYTES]; /* "file:line" of a failed assertion, end of it; else "" */
    uint32_t pc, return_address, sp;
    uint32_t registers[HAL_CRASH_REGISTERS]; /* others of the core, see hal_crash_register() */
    uint32_t stack_words;                    /* valid words in |stack| */
    uint32_t stack[HAL_CRASH_STACK_WORDS];   /* from |sp| upwards */
} hal_crash_t;

/* What the board calls itself: "fish", "simulated" and "emulated" (this image in an emulator of its
 * chip), or the name of another port. At most 15 characters. */
const char *hal_board_name(const hal_t *hal);

hal_reset_cause_t hal_reset_cause(const hal_t *hal);

/* Fills |out| with how the run before this one died; false when it did not. The record stays until
 * hal_crash_forget(). */
bool hal_crash_read(const hal_t *hal, hal_crash_t *out);

/* Name of |registers[index]| of the board's crash records, shorter than HAL_CRASH_NAME_BYTES; ""
 * when the board does not fill it. */
const char *hal_crash_register(const hal_t *hal, uint32_t index);

void hal_crash_forget(hal_t *hal);

/* 128-bit serial number of the chip. */
void hal_unique_id(const hal_t *hal, uint8_t out[16]);

/* Voltage at the battery's analogue input, averaged over about 100 ms, in HAL_BATTERY_SCALE-ths of
 * the converter's full scale. */
#define HAL_BATTERY_SCALE 65536u
uint16_t hal_battery_reading(const hal_t *hal);

/* Takes effect at once. Any context. */
void hal_led_isr(hal_t *hal, bool on);

/* Tells the watchdog that the main loop is alive. */
void hal_watchdog_feed(hal_t *hal);

/* Restarts the board. Returns on boards that only take note of it (sim, mock). */
void hal_reset(hal_t *hal);

/* Keeps the tick out while the main loop hands data over. Does not nest. */
void hal_irq_lock(hal_t *hal);
void hal_irq_unlock(hal_t *hal);

#endif
