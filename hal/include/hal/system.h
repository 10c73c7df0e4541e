/* The board itself: identity, reset, battery, LED, watchdog, interrupt lock. */
#ifndef HAL_SYSTEM_H
#define HAL_SYSTEM_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    HAL_BOARD_FISH = 1,
    HAL_BOARD_SIMULATED = 2,
    HAL_BOARD_EMULATED = 3
} hal_board_kind_t;

typedef enum {
    HAL_RESET_POWER = 0,
    HAL_RESET_BACKUP = 1,
    HAL_RESET_WATCHDOG = 2,
    HAL_RESET_SOFTWARE = 3,
    HAL_RESET_PIN = 4
} hal_reset_cause_t;

hal_board_kind_t hal_board_kind(const hal_t *hal);
hal_reset_cause_t hal_reset_cause(const hal_t *hal);

/* 128-bit serial number of the chip. */
void hal_unique_id(const hal_t *hal, uint8_t out[16]);

/* Battery voltage at the pack, averaged over about 100 ms. */
uint16_t hal_battery_mv(const hal_t *hal);

void hal_led(hal_t *hal, bool on);

/* Tells the watchdog that the main loop is alive. */
void hal_watchdog_feed(hal_t *hal);

/* Restarts the board. Returns on boards that only take note of it (sim, mock). */
void hal_reset(hal_t *hal);

/* Keeps the tick out while the main loop hands data over. Does not nest. */
void hal_irq_lock(hal_t *hal);
void hal_irq_unlock(hal_t *hal);

#endif
