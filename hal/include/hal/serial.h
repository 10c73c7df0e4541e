/* Byte streams: the radio link, the wired console and the IMU. 8N1, no flow control. */
#ifndef HAL_SERIAL_H
#define HAL_SERIAL_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum {
    HAL_PORT_RADIO = 0,   /* Bluetooth serial module, MAVLink */
    HAL_PORT_CONSOLE = 1, /* wired programming port, MAVLink */
    HAL_PORT_IMU = 2,     /* VN-100 */
    HAL_PORT_COUNT
} hal_port_t;

/* What the hardware lost on a port since boot. */
typedef struct {
    uint32_t overruns; /* bytes lost because nobody took them in time */
    uint32_t framing;  /* bytes with a bad stop bit */
} hal_serial_errors_t;

/* Takes up to |max| received bytes out of the port's ring into |out|. Returns how many. */
size_t hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max);

/* Queues all |length| bytes for sending, or none. Returns |length| or 0. The bytes are copied. */
size_t hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length);

/* Bytes that hal_serial_write would accept now. */
size_t hal_serial_write_space(const hal_t *hal, hal_port_t port);

/* Line speed from the next byte on; what is in the rings stays. Boots with 115200. Waits until at
 * most two bytes are sent. False when the port cannot keep within 2 % of it. */
bool hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud);

hal_serial_errors_t hal_serial_errors(const hal_t *hal, hal_port_t port);

#endif
