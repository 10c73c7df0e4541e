/* What the firmware's handle points at: one board in a computer's memory, in simulated time. */
#ifndef HOST_BOARD_H
#define HOST_BOARD_H

#include "flash_size.h"
#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/guard.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"
#include "line.h"

#define BOARD_LINKS 2          /* radio and console */
#define BOARD_RING_BYTES 2048u /* as on the fish, each direction */

/* Received bytes; positions count from boot. */
typedef struct {
    uint8_t bytes[BOARD_RING_BYTES];
    uint64_t head, tail;
    hal_serial_errors_t errors;
} board_ring_t;

/* Bytes on their way to the IMU. They arrive together when the last one is through. */
typedef struct {
    uint8_t bytes[BOARD_RING_BYTES];
    size_t length;
    size_t early; /* so many were through at |early_baud| when the speed was changed */
    uint32_t early_baud, baud;
    uint64_t begin_ns; /* of the first byte that is not early */
} board_wire_t;

struct hal {
    uint64_t now_us;  /* simulated time */
    uint64_t boot_us; /* simulated time at which the clock started */
    line_t to_board[BOARD_LINKS], to_host[BOARD_LINKS];
    board_ring_t received[HAL_PORT_COUNT];
    bool connected[BOARD_LINKS];
    board_wire_t to_imu;
    uint16_t pulse_ticks[HAL_SERVO_COUNT];
    uint64_t guarded[HAL_GUARDED_BYTES / 8u];
    uint16_t battery_mv;
    hal_reset_cause_t reset_cause;
    bool reset_wanted;
    bool led;
    bool irq_locked;
    uint64_t id;
    uint8_t flash[HOST_FLASH_BYTES];
};

/* Links of |link_bytes_per_s|, 0 = unlimited; an empty flash. |hal| is all zero before. */
void board_init(hal_t *hal, double link_bytes_per_s, uint64_t id);

/* Pulses off, rings and lines empty, clock at 0. */
void board_restart(hal_t *hal, hal_reset_cause_t cause);

/* What does not fit is lost and counted. */
void board_receive(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length);

/* A message of the IMU, all of it: garbage when the two ends are not set to the same speed. */
void board_receive_imu(hal_t *hal, uint8_t *bytes, size_t length, uint32_t baud);

/* When what the board has sent will have reached the IMU; UINT64_MAX = nothing on the way. */
uint64_t board_wire_due_us(const board_wire_t *wire);

#endif
