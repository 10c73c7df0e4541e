/*
 * A mocked board for the unit tests: every seam function, with what was asked of it on record and
 * faults to order. Plain data: set and read the fields.
 */
#ifndef MOCK_MOCK_HAL_H
#define MOCK_MOCK_HAL_H

#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"

#include <setjmp.h>
#include <stdbool.h>

#define MOCK_PORT_BYTES 65536u
#define MOCK_PULSES 8192u

/* A queue of bytes; |head| is the next to take, |tail| where the next goes. */
typedef struct {
    uint8_t bytes[MOCK_PORT_BYTES];
    size_t head, tail;
} mock_queue_t;

struct hal {
    uint64_t now_us;
    uint16_t pulse_ticks[HAL_SERVO_COUNT]; /* the last of each servo */
    uint16_t pulses[MOCK_PULSES];          /* of the tail */
    size_t pulse_count;
    mock_queue_t rx[HAL_PORT_COUNT]; /* filled by the test, read by the firmware */
    mock_queue_t tx[HAL_PORT_COUNT]; /* filled by the firmware */
    size_t tx_limit;                 /* write space reported at most; 0 = no limit */
    hal_serial_errors_t serial_errors[HAL_PORT_COUNT];
    uint8_t flash[HAL_FLASH_SIZE_BYTES];
    uint32_t flash_writes;
    uint32_t flash_fail_after; /* writes that succeed before all fail; 0 = never fail */
    /* A flash with a life of its own, as tests/unit/flash_model.h; NULL: none fails or wears. The
     * first writes a page, the second changes what was read. */
    bool (*flash_write)(hal_t *hal, uint32_t offset, const uint8_t *page);
    void (*flash_read)(hal_t *hal, uint32_t offset, uint8_t *read, uint32_t length);
    void *flash_context;
    uint16_t battery_mv; /* at the pack; from 9900 on the reading is full scale */
    const char *board_name;
    hal_reset_cause_t reset_cause;
    bool clock_inexact;
    bool crashed;
    hal_crash_t crash; /* valid when |crashed| */
    uint32_t baud[HAL_PORT_COUNT];
    uint32_t baud_max; /* faster ones are refused; 0 = none */
    bool led;
    uint32_t watchdog_feeds;
    uint32_t resets;
    int irq_locked;                     /* must be 0 or 1 */
    void (*on_unlock)(struct hal *hal); /* an interrupt that waited for it; NULL = none */
};

/* Flash all 0xFF, 8 V battery, time 0. */
void mock_hal_init(hal_t *hal);

void mock_feed(hal_t *hal, hal_port_t port, const void *bytes, size_t length);

/* Takes up to |max| bytes the firmware has sent. */
size_t mock_take(hal_t *hal, hal_port_t port, void *out, size_t max);

/* Runs |statement| and sets |panicked| to whether it ended in panic(). */
#define MOCK_EXPECT_PANIC(panicked, statement)                                                     \
    do {                                                                                           \
        mock_panic_armed = true;                                                                   \
        (panicked) = true;                                                                         \
        if (setjmp(mock_panic_jump) == 0) {                                                        \
            statement;                                                                             \
            (panicked) = false;                                                                    \
        }                                                                                          \
        mock_panic_armed = false;                                                                  \
    } while (0)

extern jmp_buf mock_panic_jump;
extern bool mock_panic_armed;
extern const char *mock_panic_where;

#endif
