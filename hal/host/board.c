#include "board.h"

#include "base/panic.h"
#include "common/byte_ring.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define UNLIMITED_CHUNK 256u
#define BOOT_BAUD 115200u
#define BAUD_MIN 1200u
#define BAUD_MAX 1000000u
#define BAUD_TOLERANCE 0.03
#define BATTERY_FULL_SCALE_MV 9900u
#define GARBLED 0xA5         /* as on the emulated board's wires */
#define BITS_NS 10000000000u /* of a byte, at one baud */

_Noreturn void panic(const char *where) {
    fprintf(stderr, "tailbeat: panic at %s\n", where);
    abort();
}

void board_init(hal_t *hal, double link_bytes_per_s, uint64_t id) {
    for (unsigned port = 0; port < BOARD_LINKS; port++) {
        line_init(&hal->to_board[port], link_bytes_per_s);
        line_init(&hal->to_host[port], link_bytes_per_s);
        hal->connected[port] = true;
    }
    memset(hal->flash, 0xFF, sizeof hal->flash);
    hal->id = id;
}

void board_restart(hal_t *hal, hal_reset_cause_t cause) {
    for (unsigned port = 0; port < BOARD_LINKS; port++) {
        line_drop_all(&hal->to_board[port]);
        line_cut(&hal->to_host[port], hal->now_us);
    }
    for (unsigned port = 0; port < HAL_PORT_COUNT; port++) {
        hal->received[port].head = hal->received[port].tail = 0;
        hal->received[port].errors = (hal_serial_errors_t){0};
    }
    hal->to_imu.length = hal->to_imu.early = 0;
    hal->to_imu.baud = BOOT_BAUD;
    hal->boot_us = hal->now_us;
    memset(hal->pulse_ticks, 0, sizeof hal->pulse_ticks);
    memset(hal->guarded, 0, sizeof hal->guarded);
    hal->reset_cause = cause;
    hal->reset_wanted = false;
    hal->led = false;
    hal->irq_locked = false;
}

uint64_t hal_time_us(const hal_t *hal) { return hal->now_us - hal->boot_us; }

bool hal_clock_exact(const hal_t *hal) {
    (void)hal;
    return true;
}

void hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks) {
    REQUIRE(servo < HAL_SERVO_COUNT);
    hal->pulse_ticks[servo] = width_ticks;
}

/* No memory protection here. */
void *hal_guarded(hal_t *hal) { return hal->guarded; }
void hal_guard_open_isr(hal_t *hal) { (void)hal; }
void hal_guard_close_isr(hal_t *hal) { (void)hal; }

static size_t room(const board_ring_t *ring) {
    return BOARD_RING_BYTES - (size_t)(ring->tail - ring->head);
}

void board_receive(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    board_ring_t *ring = &hal->received[port];
    const size_t fits = length < room(ring) ? length : room(ring);
    byte_ring_put(ring->bytes, BOARD_RING_BYTES, ring->tail, bytes, fits);
    ring->tail += fits;
    ring->errors.overruns += (uint32_t)(length - fits);
}

void board_receive_imu(hal_t *hal, uint8_t *bytes, size_t length, uint32_t baud) {
    if (fabs((double)baud / hal->to_imu.baud - 1) > BAUD_TOLERANCE) {
        for (size_t i = 0; i < length; i++) {
            bytes[i] ^= GARBLED;
        }
        hal->received[HAL_PORT_IMU].errors.framing += (uint32_t)length;
    }
    board_receive(hal, HAL_PORT_IMU, bytes, length);
}

/* Bytes that are through, of those that are not early. */
static size_t wire_passed(const board_wire_t *wire, uint64_t now_us) {
    const uint64_t now_ns = now_us * 1000u;
    const uint64_t byte_ns = BITS_NS / wire->baud;
    const uint64_t passed = now_ns > wire->begin_ns ? (now_ns - wire->begin_ns) / byte_ns : 0;
    const size_t left = wire->length - wire->early;
    return passed < left ? (size_t)passed : left;
}

static void wire_write(board_wire_t *wire, uint64_t now_us, const uint8_t *bytes, size_t length) {
    if (wire->length == 0) {
        wire->begin_ns = now_us * 1000u;
    }
    memcpy(wire->bytes + wire->length, bytes, length);
    wire->length += length;
}

static void wire_set_baud(board_wire_t *wire, uint64_t now_us, uint32_t baud) {
    if (wire->length > 0 && baud != wire->baud) {
        wire->early += wire_passed(wire, now_us);
        wire->early_baud = wire->baud;
        wire->begin_ns = now_us * 1000u;
    }
    wire->baud = baud;
}

uint64_t board_wire_due_us(const board_wire_t *wire) {
    if (wire->length == 0) {
        return UINT64_MAX;
    }
    const uint64_t byte_ns = BITS_NS / wire->baud;
    return (wire->begin_ns + (wire->length - wire->early) * byte_ns + 999u) / 1000u;
}

/* Moves what has come along the line into the ring. An unlimited line waits for room instead of
 * losing bytes: it stands for a transport with flow control. */
static void collect(hal_t *hal, hal_port_t port) {
    line_t *line = &hal->to_board[port];
    uint8_t chunk[UNLIMITED_CHUNK];
    for (;;) {
        const size_t space = room(&hal->received[port]);
        const size_t most = line->byte_ns == 0 && space < sizeof chunk ? space : sizeof chunk;
        const size_t length = line_read(line, hal->now_us, chunk, most);
        if (length == 0) {
            return;
        }
        board_receive(hal, port, chunk, length);
    }
}

size_t hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max) {
    if (port < BOARD_LINKS && !line_is_empty(&hal->to_board[port])) {
        collect(hal, port);
    }
    board_ring_t *ring = &hal->received[port];
    const size_t held = (size_t)(ring->tail - ring->head);
    const size_t taken = held < max ? held : max;
    if (taken == 0) {
        return 0;
    }
    byte_ring_take(ring->bytes, BOARD_RING_BYTES, ring->head, out, taken);
    ring->head += taken;
    return taken;
}

size_t hal_serial_write_space(const hal_t *hal, hal_port_t port) {
    if (port >= BOARD_LINKS) {
        return BOARD_RING_BYTES - hal->to_imu.length;
    }
    const uint64_t queued = line_queued(&hal->to_host[port], hal->now_us);
    return queued < BOARD_RING_BYTES ? BOARD_RING_BYTES - (size_t)queued : 0;
}

size_t hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    if (length > hal_serial_write_space(hal, port)) {
        return 0;
    }
    if (port >= BOARD_LINKS) {
        wire_write(&hal->to_imu, hal->now_us, bytes, length);
    } else if (length > 0 && hal->connected[port]) {
        /* A cut radio swallows everything. */
        line_write(&hal->to_host[port], hal->now_us, bytes, length);
    }
    return length;
}

/* The links run at the speed of the configuration. */
bool hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud) {
    if (baud < BAUD_MIN || baud > BAUD_MAX) {
        return false;
    }
    if (port >= BOARD_LINKS) {
        wire_set_baud(&hal->to_imu, hal->now_us, baud);
    }
    return true;
}

hal_serial_errors_t hal_serial_errors(const hal_t *hal, hal_port_t port) {
    return hal->received[port].errors;
}

/* As the fish's: pages that are erased and written in one operation. */
const hal_flash_geometry_t *hal_flash_geometry(const hal_t *hal) {
    static const hal_flash_geometry_t geometry = {
        .size_bytes = HOST_FLASH_BYTES,
        .erase_bytes = HOST_FLASH_PAGE_BYTES,
        .program_bytes = HOST_FLASH_PAGE_BYTES,
        .program_erases = true,
    };
    (void)hal;
    return &geometry;
}

bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    if (offset > HOST_FLASH_BYTES || length > HOST_FLASH_BYTES - offset) {
        return false;
    }
    memcpy(out, hal->flash + offset, length);
    return true;
}

bool hal_flash_erase(hal_t *hal, uint32_t offset) {
    (void)hal;
    return offset % HOST_FLASH_PAGE_BYTES == 0 && offset < HOST_FLASH_BYTES;
}

bool hal_flash_program(hal_t *hal, uint32_t offset, const void *bytes) {
    if (offset % HOST_FLASH_PAGE_BYTES != 0 || offset >= HOST_FLASH_BYTES) {
        return false;
    }
    memcpy(hal->flash + offset, bytes, HOST_FLASH_PAGE_BYTES);
    return true;
}

const char *hal_board_name(const hal_t *hal) {
    (void)hal;
    return "simulated";
}

hal_reset_cause_t hal_reset_cause(const hal_t *hal) { return hal->reset_cause; }

/* A crash here ends the process. */
bool hal_crash_read(const hal_t *hal, hal_crash_t *out) {
    (void)hal;
    (void)out;
    return false;
}

const char *hal_crash_register(const hal_t *hal, uint32_t index) {
    (void)hal;
    (void)index;
    return "";
}

void hal_crash_forget(hal_t *hal) { (void)hal; }

void hal_unique_id(const hal_t *hal, uint8_t out[16]) {
    memcpy(out, "sim-fish", 8);
    for (unsigned i = 0; i < 8; i++) {
        out[8 + i] = (uint8_t)(hal->id >> (8 * i));
    }
}

/* Behind the divider of docs/how-to/wiring.md. */
uint16_t hal_battery_reading(const hal_t *hal) {
    const uint32_t reading =
        (hal->battery_mv * HAL_BATTERY_SCALE + BATTERY_FULL_SCALE_MV / 2u) / BATTERY_FULL_SCALE_MV;
    return (uint16_t)(reading < HAL_BATTERY_SCALE ? reading : HAL_BATTERY_SCALE - 1u);
}
void hal_led_isr(hal_t *hal, bool on) { hal->led = on; }
/* The event loop is the main loop: it cannot hang without hanging the whole process. */
void hal_watchdog_feed(hal_t *hal) { (void)hal; }
void hal_reset(hal_t *hal) { hal->reset_wanted = true; }

void hal_irq_lock(hal_t *hal) {
    REQUIRE(!hal->irq_locked);
    hal->irq_locked = true;
}

void hal_irq_unlock(hal_t *hal) {
    REQUIRE(hal->irq_locked);
    hal->irq_locked = false;
}
