/* Every function that a board owes the firmware, as it is when nothing is there. The contracts are
 * in hal/include/hal; here is what a port has to do for them. */
#include "board.h"

#include "base/panic.h"

#include <string.h>

/* End the pulses first, keep |where| in RAM that no reset clears, restart the chip. Interrupts may
 * be off, the stack may be full. */
_Noreturn void panic(const char *where) {
    (void)where;
    for (;;) {
    }
}

/* Read a free-running counter. The tick moves the base that it is counted from before the counter
 * wraps. Interrupts call this too, so base and counter are read with interrupts off. */
uint64_t hal_time_us(const hal_t *hal) { return hal->time_us; }

/* False keeps the servo limp: report the crystal or the PLL as it is. */
bool hal_clock_exact(const hal_t *hal) {
    (void)hal;
    return false;
}

/* Take bytes out of the ring that the interrupt or the DMA fills. A port that is not there never
 * has any. Rings hold the longest pause of the main loop, 100 ms, at the port's speed. */
size_t hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max) {
    REQUIRE(port < HAL_PORT_COUNT);
    (void)hal;
    (void)out;
    (void)max;
    return 0;
}

/* A port that is not there takes everything, as a line with nothing at its end: the firmware waits
 * for space and not for an answer. */
size_t hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    (void)bytes;
    return length <= hal_serial_write_space(hal, port) ? length : 0;
}

/* At least 512: the longest message of the link is 280 bytes. */
size_t hal_serial_write_space(const hal_t *hal, hal_port_t port) {
    REQUIRE(port < HAL_PORT_COUNT);
    (void)hal;
    return 1024;
}

/* False makes the firmware put the IMU's parameters back to their defaults. */
bool hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud) {
    REQUIRE(port < HAL_PORT_COUNT);
    (void)hal;
    return baud > 0;
}

/* Count in the interrupt; nothing is cleared. */
hal_serial_errors_t hal_serial_errors(const hal_t *hal, hal_port_t port) {
    REQUIRE(port < HAL_PORT_COUNT);
    (void)hal;
    return (hal_serial_errors_t){0};
}

/* Without a flash the board runs, refuses to arm and reports a fault of the storage. */
bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    (void)hal;
    (void)offset;
    (void)out;
    (void)length;
    return false;
}

/* Sizes and times of the chip's data sheet, constant. */
const hal_flash_geometry_t *hal_flash_geometry(const hal_t *hal) {
    (void)hal;
    static const hal_flash_geometry_t geometry = {
        .size_bytes = 256u * 1024u,
        .erase_bytes = 4096u,
        .program_bytes = 256u,
        .erase_typical_us = 45000u,
        .erase_max_us = 400000u,
        .program_max_us = 3000u,
    };
    return &geometry;
}

/* Erase one unit, then look that it reads 0xFF. Feed the watchdog if that may take longer. */
bool hal_flash_erase(hal_t *hal, uint32_t offset) {
    (void)hal;
    (void)offset;
    return false;
}

/* Program one unit, then compare. */
bool hal_flash_program(hal_t *hal, uint32_t offset, const void *bytes) {
    (void)hal;
    (void)offset;
    (void)bytes;
    return false;
}

/* The width is buffered until the frame that follows: a pulse is whole or absent. Clamp it to 500
 * to 2500 us, whatever the firmware says. 0, or a clock that is not exact: no pulse. */
void hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks) {
    REQUIRE(servo < HAL_SERVO_COUNT);
    hal->pulse_ticks[servo] = width_ticks;
}

const char *hal_board_name(const hal_t *hal) {
    (void)hal;
    return "template";
}

/* Read the chip's register once at boot, before anything clears it. */
hal_reset_cause_t hal_reset_cause(const hal_t *hal) {
    (void)hal;
    return HAL_RESET_POWER;
}

/* A board without RAM that outlives a reset has none. */
bool hal_crash_read(const hal_t *hal, hal_crash_t *out) {
    (void)hal;
    (void)out;
    return false;
}

/* The names of what the crash handler of this core keeps. */
const char *hal_crash_register(const hal_t *hal, uint32_t index) {
    (void)hal;
    (void)index;
    return "";
}

void hal_crash_forget(hal_t *hal) { (void)hal; }

/* Different on every board: the host keeps keys and experiments by it. */
void hal_unique_id(const hal_t *hal, uint8_t out[16]) {
    (void)hal;
    memcpy(out, "template-board-0", 16);
}

/* 0 is an empty battery, which keeps the board from arming. */
uint16_t hal_battery_reading(const hal_t *hal) {
    (void)hal;
    return 0;
}

void hal_led_isr(hal_t *hal, bool on) {
    (void)hal;
    (void)on;
}

/* The watchdog bites after 1 to 2 s. */
void hal_watchdog_feed(hal_t *hal) { (void)hal; }

/* End the pulses first. */
void hal_reset(hal_t *hal) { (void)hal; }

/* Raise the priority mask to the tick's, so that the serial ports go on. */
void hal_irq_lock(hal_t *hal) { (void)hal; }
void hal_irq_unlock(hal_t *hal) { (void)hal; }

/* An MPU region that is read-only but between open and close keeps a wild write out. All zeros
 * after each reset. */
void *hal_guarded(hal_t *hal) { return hal->guarded; }
void hal_guard_open_isr(hal_t *hal) { (void)hal; }
void hal_guard_close_isr(hal_t *hal) { (void)hal; }
