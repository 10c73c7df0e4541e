#include "mock_hal.h"

#include "base/panic.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

jmp_buf mock_panic_jump;
bool mock_panic_armed;
const char *mock_panic_where;

_Noreturn void panic(const char *where) {
    mock_panic_where = where;
    if (mock_panic_armed) {
        longjmp(mock_panic_jump, 1);
    }
    fprintf(stderr, "panic at %s\n", where);
    abort();
}

void mock_hal_init(hal_t *hal) {
    memset(hal, 0, sizeof *hal);
    memset(hal->flash, 0xFF, sizeof hal->flash);
    hal->battery_mv = 8000;
    hal->board_name = "simulated";
}

void mock_feed(hal_t *hal, hal_port_t port, const void *bytes, size_t length) {
    mock_queue_t *queue = &hal->rx[port];
    if (length > MOCK_PORT_BYTES - queue->tail) {
        abort();
    }
    memcpy(queue->bytes + queue->tail, bytes, length);
    queue->tail += length;
}

static size_t queue_take(mock_queue_t *queue, void *out, size_t max) {
    size_t held = queue->tail - queue->head;
    size_t taken = held < max ? held : max;
    memcpy(out, queue->bytes + queue->head, taken);
    queue->head += taken;
    if (queue->head == queue->tail) {
        queue->head = queue->tail = 0;
    }
    return taken;
}

size_t mock_take(hal_t *hal, hal_port_t port, void *out, size_t max) {
    return queue_take(&hal->tx[port], out, max);
}

uint64_t hal_time_us(const hal_t *hal) { return hal->now_us; }

bool hal_clock_exact(const hal_t *hal) { return !hal->clock_inexact; }

void hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks) {
    REQUIRE(servo < HAL_SERVO_COUNT);
    hal->pulse_ticks[servo] = width_ticks;
    if (servo != HAL_SERVO_TAIL) {
        return;
    }
    if (hal->pulse_count < MOCK_PULSES) {
        hal->pulses[hal->pulse_count] = width_ticks;
    }
    hal->pulse_count++;
}

size_t hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max) {
    return queue_take(&hal->rx[port], out, max);
}

size_t hal_serial_write_space(const hal_t *hal, hal_port_t port) {
    size_t space = MOCK_PORT_BYTES - hal->tx[port].tail;
    return hal->tx_limit != 0 && hal->tx_limit < space ? hal->tx_limit : space;
}

size_t hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    if (length > hal_serial_write_space(hal, port)) {
        return 0;
    }
    mock_queue_t *queue = &hal->tx[port];
    memcpy(queue->bytes + queue->tail, bytes, length);
    queue->tail += length;
    return length;
}

bool hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud) {
    if (hal->baud_max != 0 && baud > hal->baud_max) {
        return false;
    }
    hal->baud[port] = baud;
    return true;
}

hal_serial_errors_t hal_serial_errors(const hal_t *hal, hal_port_t port) {
    return hal->serial_errors[port];
}

bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    if (offset > HAL_FLASH_SIZE_BYTES || length > HAL_FLASH_SIZE_BYTES - offset) {
        return false;
    }
    memcpy(out, hal->flash + offset, length);
    if (hal->flash_read != NULL) {
        hal->flash_read(hal, offset, out, length);
    }
    return true;
}

bool hal_flash_write_page(hal_t *hal, uint32_t offset, const void *page) {
    if (offset % HAL_FLASH_PAGE_BYTES != 0 || offset >= HAL_FLASH_SIZE_BYTES) {
        return false;
    }
    if (hal->flash_fail_after != 0 && hal->flash_writes >= hal->flash_fail_after) {
        return false;
    }
    hal->flash_writes++;
    if (hal->flash_write != NULL) {
        return hal->flash_write(hal, offset, page);
    }
    memcpy(hal->flash + offset, page, HAL_FLASH_PAGE_BYTES);
    return true;
}

const char *hal_board_name(const hal_t *hal) { return hal->board_name; }
hal_reset_cause_t hal_reset_cause(const hal_t *hal) { return hal->reset_cause; }

bool hal_crash_read(const hal_t *hal, hal_crash_t *out) {
    if (hal->crashed) {
        *out = hal->crash;
    }
    return hal->crashed;
}

const char *hal_crash_register(const hal_t *hal, uint32_t index) {
    (void)hal;
    static const char *const names[] = {"a0", "cause"};
    return index < sizeof names / sizeof names[0] ? names[index] : "";
}

void hal_crash_forget(hal_t *hal) { hal->crashed = false; }

void hal_unique_id(const hal_t *hal, uint8_t out[16]) {
    (void)hal;
    memcpy(out, "mocked-board-001", 16);
}

/* As behind the divider of docs/how-to/wiring.md: 9.9 V are full scale. */
uint16_t hal_battery_reading(const hal_t *hal) {
    const uint32_t reading = (hal->battery_mv * HAL_BATTERY_SCALE + 4950u) / 9900u;
    return (uint16_t)(reading < HAL_BATTERY_SCALE ? reading : HAL_BATTERY_SCALE - 1u);
}
void hal_led_isr(hal_t *hal, bool on) { hal->led = on; }
void hal_watchdog_feed(hal_t *hal) { hal->watchdog_feeds++; }
void hal_reset(hal_t *hal) { hal->resets++; }

void hal_irq_lock(hal_t *hal) {
    if (++hal->irq_locked != 1) {
        abort();
    }
}

void hal_irq_unlock(hal_t *hal) {
    if (--hal->irq_locked != 0) {
        abort();
    }
    if (hal->on_unlock != NULL) {
        hal->on_unlock(hal);
    }
}
