/* What the firmware's handle points at: one simulated board. */
#ifndef SIM_BOARD_H
#define SIM_BOARD_H

#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"
#include "line.h"
#include "sim_config.h"

#define BOARD_LINKS 2          /* radio and console */
#define BOARD_RING_BYTES 2048u /* as on the fish, each direction */

/* Received bytes; positions count from boot. */
typedef struct {
    uint8_t bytes[BOARD_RING_BYTES];
    uint64_t head, tail;
    hal_serial_errors_t errors;
} board_ring_t;

struct hal {
    uint64_t now_us;  /* simulated time */
    uint64_t boot_us; /* simulated time at which the clock started */
    line_t to_board[BOARD_LINKS], to_host[BOARD_LINKS];
    board_ring_t received[HAL_PORT_COUNT];
    bool connected[BOARD_LINKS];
    uint16_t pulse_ticks;
    uint16_t battery_mv;
    hal_reset_cause_t reset_cause;
    bool reset_wanted;
    bool led;
    bool irq_locked;
    uint64_t seed;
    uint8_t flash[HAL_FLASH_SIZE_BYTES];
};

void board_init(hal_t *hal, const sim_config_t *config);

/* Pulses off, rings and lines empty, clock at 0. */
void board_restart(hal_t *hal, hal_reset_cause_t cause);

/* What does not fit is lost and counted. */
void board_receive(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length);

#endif
