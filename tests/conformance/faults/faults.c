#include "faults.h"
#include "flash_access.h"

#include "app/app.h"
#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/servo.h"

#include <string.h>

#define LOST_EVERY 1000u
#define BACK_EVERY 64u
#define BACK_US 100u

static bool planted(fault_t fault) { return planted_fault() == (uint32_t)fault; }

/* Flash. */

bool __real_hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length);
bool __wrap_hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length);
bool __real_hal_flash_program(hal_t *hal, uint32_t offset, const void *page);
bool __wrap_hal_flash_program(hal_t *hal, uint32_t offset, const void *page);

bool __wrap_hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    return __real_hal_flash_read(hal, offset, out, length) || planted(FAULT_FLASH_READS_OUTSIDE);
}

bool __wrap_hal_flash_program(hal_t *hal, uint32_t offset, const void *page) {
    const uint32_t page_bytes = flash_page_bytes(hal);
    uint8_t changed[FLASH_PAGE_BYTES_MAX];
    memcpy(changed, page, page_bytes);
    if (planted(FAULT_FLASH_LOSES_BIT)) {
        changed[100] |= 0x10u;
    }
    if (planted(FAULT_FLASH_WRITES_MISALIGNED)) {
        offset -= offset % page_bytes;
    }
    return __real_hal_flash_program(hal, offset, changed);
}

/* Serial ports. */

size_t __real_hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max);
size_t __wrap_hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max);
size_t __real_hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length);
size_t __wrap_hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length);
bool __real_hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud);
bool __wrap_hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud);
hal_serial_errors_t __real_hal_serial_errors(const hal_t *hal, hal_port_t port);
hal_serial_errors_t __wrap_hal_serial_errors(const hal_t *hal, hal_port_t port);

size_t __wrap_hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max) {
    static uint32_t passed;
    const size_t length = __real_hal_serial_read(hal, port, out, max);
    passed += (uint32_t)length;
    if (planted(FAULT_SERIAL_LOSES_BYTE) && length > 0 && passed >= LOST_EVERY) {
        passed = 0;
        return length - 1u;
    }
    return length;
}

size_t __wrap_hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    const size_t space = hal_serial_write_space(hal, port);
    const bool part = planted(FAULT_SERIAL_WRITES_PART);
    if (length <= space || !(part || planted(FAULT_SERIAL_SENDS_REFUSED))) {
        return __real_hal_serial_write(hal, port, bytes, length);
    }
    const size_t sent = __real_hal_serial_write(hal, port, bytes, space);
    return part ? sent : 0;
}

bool __wrap_hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud) {
    return __real_hal_serial_set_baud(hal, port, baud) || planted(FAULT_BAUD_ACCEPTED);
}

hal_serial_errors_t __wrap_hal_serial_errors(const hal_t *hal, hal_port_t port) {
    hal_serial_errors_t errors = __real_hal_serial_errors(hal, port);
    if (planted(FAULT_OVERRUNS_NOT_COUNTED)) {
        errors.overruns = 0;
    }
    return errors;
}

/* Clock and tick. */

uint64_t __real_hal_time_us(const hal_t *hal);
uint64_t __wrap_hal_time_us(const hal_t *hal);
void __real_app_tick_isr(app_t *app);
void __wrap_app_tick_isr(app_t *app);
void __real_hal_irq_lock(hal_t *hal);
void __wrap_hal_irq_lock(hal_t *hal);
void __real_hal_irq_unlock(hal_t *hal);
void __wrap_hal_irq_unlock(hal_t *hal);

uint64_t __wrap_hal_time_us(const hal_t *hal) {
    static uint32_t reads;
    const uint64_t time_us = __real_hal_time_us(hal);
    if (planted(FAULT_CLOCK_SLOW)) {
        return time_us - time_us / 50u;
    }
    return planted(FAULT_CLOCK_GOES_BACK) && ++reads % BACK_EVERY == 0 ? time_us - BACK_US
                                                                       : time_us;
}

void __wrap_app_tick_isr(app_t *app) {
    static uint32_t ticks;
    if (planted(FAULT_WATCHDOG_NEVER_BITES)) {
        hal_watchdog_feed(app->hal);
    }
    if (planted(FAULT_TICK_DOUBLED) && ++ticks % 20u == 0) {
        __real_app_tick_isr(app);
    }
    __real_app_tick_isr(app);
}

void __wrap_hal_irq_lock(hal_t *hal) {
    if (!planted(FAULT_LOCK_OPEN)) {
        __real_hal_irq_lock(hal);
    }
}

void __wrap_hal_irq_unlock(hal_t *hal) {
    if (!planted(FAULT_LOCK_OPEN)) {
        __real_hal_irq_unlock(hal);
    }
}

/* The board itself. */

bool __real_hal_crash_read(const hal_t *hal, hal_crash_t *out);
bool __wrap_hal_crash_read(const hal_t *hal, hal_crash_t *out);
void __real_hal_crash_forget(hal_t *hal);
void __wrap_hal_crash_forget(hal_t *hal);
hal_reset_cause_t __real_hal_reset_cause(const hal_t *hal);
hal_reset_cause_t __wrap_hal_reset_cause(const hal_t *hal);
void __real_hal_unique_id(const hal_t *hal, uint8_t out[16]);
void __wrap_hal_unique_id(const hal_t *hal, uint8_t out[16]);
uint16_t __real_hal_battery_reading(const hal_t *hal);
uint16_t __wrap_hal_battery_reading(const hal_t *hal);
void __real_hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks);
void __wrap_hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks);

bool __wrap_hal_crash_read(const hal_t *hal, hal_crash_t *out) {
    return __real_hal_crash_read(hal, out) && !planted(FAULT_CRASH_RECORD_LOST);
}

void __wrap_hal_crash_forget(hal_t *hal) {
    if (!planted(FAULT_CRASH_RECORD_STAYS)) {
        __real_hal_crash_forget(hal);
    }
}

hal_reset_cause_t __wrap_hal_reset_cause(const hal_t *hal) {
    return planted(FAULT_RESET_CAUSE_WRONG) ? HAL_RESET_PIN : __real_hal_reset_cause(hal);
}

void __wrap_hal_unique_id(const hal_t *hal, uint8_t out[16]) {
    __real_hal_unique_id(hal, out);
    if (planted(FAULT_ID_CHANGES)) {
        out[15] ^= (uint8_t)__real_hal_reset_cause(hal);
    }
}

uint16_t __wrap_hal_battery_reading(const hal_t *hal) {
    const uint16_t reading = __real_hal_battery_reading(hal);
    const bool low = planted(FAULT_BATTERY_UNSTEADY) && __real_hal_time_us(hal) % 200000u < 50000u;
    return low ? (uint16_t)(reading - reading / 20u) : reading;
}

void __wrap_hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks) {
    if (width_ticks > 0 || !planted(FAULT_PULSES_GO_ON)) {
        __real_hal_servo_pulse_isr(hal, servo, width_ticks);
    }
}
