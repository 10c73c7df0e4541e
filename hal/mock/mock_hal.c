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

/* Sizes and times of the data sheets: SAM3X/A (Atmel-11057), W25Q64JV, W25Q128JV. */
static const hal_flash_geometry_t geometry = {
    .size_bytes = MOCK_FLASH_SIZE_BYTES,
    .erase_bytes = MOCK_FLASH_ERASE_BYTES,
    .program_bytes = MOCK_FLASH_PROGRAM_BYTES,
    .program_erases = !MOCK_FLASH_ERASES_FIRST,
#if MOCK_FLASH == MOCK_FLASH_SAM3X
    .program_max_us = 10000,
#elif MOCK_FLASH == MOCK_FLASH_NOR_4K
    .erase_typical_us = 45000,
    .erase_max_us = 400000,
    .program_max_us = 3000,
#else
    .erase_typical_us = 150000,
    .erase_max_us = 2000000,
    .program_max_us = 3000,
#endif
};

const char *mock_flash_name(void) {
    static const char *const names[] = {[MOCK_FLASH_SAM3X] = "SAM3X8E, pages of 256 bytes",
                                        [MOCK_FLASH_NOR_4K] = "W25Q64JV, sectors of 4 KiB",
                                        [MOCK_FLASH_NOR_64K] = "W25Q128JV, blocks of 64 KiB"};
    return names[MOCK_FLASH];
}

void mock_flash_load(hal_t *to, const uint8_t from[MOCK_FLASH_BYTES], bool all) {
    for (uint32_t at = 0; at < MOCK_FLASH_BYTES; at += MOCK_PIECE_BYTES) {
        bool *changed = &to->flash_changed[at / MOCK_PIECE_BYTES];
        if (all || *changed) {
            memcpy(to->flash + at, from + at, MOCK_PIECE_BYTES);
            *changed = false;
        }
    }
}

void mock_flash_copy(hal_t *to, hal_t *from, bool all) {
    for (uint32_t piece = 0; piece < MOCK_FLASH_BYTES / MOCK_PIECE_BYTES; piece++) {
        to->flash_changed[piece] = to->flash_changed[piece] || from->flash_changed[piece];
        from->flash_changed[piece] = false;
    }
    mock_flash_load(to, from->flash, all);
}

void mock_hal_init(hal_t *hal) {
    memset(hal, 0, sizeof *hal);
    memset(hal->flash_changed, true, sizeof hal->flash_changed);
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

const hal_flash_geometry_t *hal_flash_geometry(const hal_t *hal) {
    return hal->flash_geometry.size_bytes != 0 ? &hal->flash_geometry : &geometry;
}

/* What the store reads by the million: a copy whose length is known takes no call, which the
 * sanitizers make a long one. */
#define LITTLE_BYTES 16u

static bool out_of_flash(uint32_t offset, uint32_t length) {
    return offset > MOCK_FLASH_BYTES || length > MOCK_FLASH_BYTES - offset;
}

bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    if (out_of_flash(offset, length)) {
        return false;
    }
    if (length == LITTLE_BYTES) {
        memcpy(out, hal->flash + offset, LITTLE_BYTES);
    } else {
        memcpy(out, hal->flash + offset, length);
    }
    if (hal->flash_read != NULL) {
        hal->flash_read(hal, offset, out, length);
    }
    return true;
}

static void note_change(hal_t *hal, uint32_t offset) {
    hal->flash_changed[offset / MOCK_PIECE_BYTES] = true;
}

bool hal_flash_erase(hal_t *hal, uint32_t offset) {
    if (offset % MOCK_FLASH_ERASE_BYTES != 0 || out_of_flash(offset, MOCK_FLASH_ERASE_BYTES)) {
        return false;
    }
    if (!MOCK_FLASH_ERASES_FIRST) {
        return true;
    }
    if (hal->flash_fail_after != 0 && hal->flash_writes >= hal->flash_fail_after) {
        return false;
    }
    hal->flash_erases++;
    note_change(hal, offset);
    if (hal->flash_erase != NULL) {
        return hal->flash_erase(hal, offset);
    }
    memset(hal->flash + offset, 0xFF, MOCK_FLASH_ERASE_BYTES);
    return true;
}

/* As a chip that erases first wants a unit that is to be programmed. */
static bool is_erased(const hal_t *hal, uint32_t offset) {
    for (uint32_t i = 0; i < MOCK_FLASH_PROGRAM_BYTES; i++) {
        if (hal->flash[offset + i] != 0xFFu) {
            return false;
        }
    }
    return true;
}

bool hal_flash_program(hal_t *hal, uint32_t offset, const void *bytes) {
    if (offset % MOCK_FLASH_PROGRAM_BYTES != 0 || out_of_flash(offset, MOCK_FLASH_PROGRAM_BYTES)) {
        return false;
    }
    if (hal->flash_fail_after != 0 && hal->flash_writes >= hal->flash_fail_after) {
        return false;
    }
    if (MOCK_FLASH_ERASES_FIRST && !is_erased(hal, offset)) {
        hal->flash_misuses++;
        return false;
    }
    hal->flash_writes++;
    note_change(hal, offset);
    if (hal->flash_write != NULL) {
        return hal->flash_write(hal, offset, bytes);
    }
    memcpy(hal->flash + offset, bytes, MOCK_FLASH_PROGRAM_BYTES);
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

void *hal_guarded(hal_t *hal) { return hal->guarded; }

void hal_guard_open_isr(hal_t *hal) {
    if (hal->guard_open || memcmp(hal->guarded, hal->guarded_closed, sizeof hal->guarded) != 0) {
        abort();
    }
    hal->guard_open = true;
}

void hal_guard_close_isr(hal_t *hal) {
    if (!hal->guard_open) {
        abort();
    }
    memcpy(hal->guarded_closed, hal->guarded, sizeof hal->guarded);
    hal->guard_open = false;
}

void mock_reset_guarded(hal_t *hal) {
    memset(hal->guarded, 0, sizeof hal->guarded);
    memset(hal->guarded_closed, 0, sizeof hal->guarded_closed);
}
