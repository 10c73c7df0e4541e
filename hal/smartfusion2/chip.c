/* The chip itself: who it is, why it started, LED, watchdog, battery, lock, restart. */
#include "board.h"
#include "memory_map.h"

#include <string.h>

#define LED_GPIO 1u

/* Left in RAM that no reset clears. The chip's own register of causes stays 0 in QEMU. */
#define RESTARTED 0x52535431u
static NOINIT uint32_t restart_note;

/* The board has no divider: a full pack of two cells, 8.2 V, behind that of docs/how-to/wiring.md.
 */
#define BATTERY_MV 8200u
#define FULL_SCALE_MV 9900u

void chip_init(hal_t *hal) {
    hal->reset_cause = restart_note == RESTARTED ? HAL_RESET_SOFTWARE : HAL_RESET_POWER;
    restart_note = 0;
    GPIO->CFG[LED_GPIO] = GPIO_CFG_OUTPUT;
}

/* Every chip has a version; QEMU's has 0 there. */
const char *hal_board_name(const hal_t *hal) {
    (void)hal;
    return SYSREG->DEVICE_VERSION == 0 ? "emulated" : "smartfusion2";
}

hal_reset_cause_t hal_reset_cause(const hal_t *hal) { return hal->reset_cause; }

/* The chip's serial number is a service of its system controller, which QEMU does not have. So all
 * boards of this port have the same. */
void hal_unique_id(const hal_t *hal, uint8_t out[16]) {
    (void)hal;
    memcpy(out, "tailbeat-sf2-001", 16);
}

uint16_t hal_battery_reading(const hal_t *hal) {
    (void)hal;
    return BATTERY_MV * HAL_BATTERY_SCALE / FULL_SCALE_MV;
}

void hal_led_isr(hal_t *hal, bool on) {
    (void)hal;
    GPIO->OUT = on ? 1u << LED_GPIO : 0;
}

/* The design of the FPGA decides whether the watchdog runs, and its time. */
void hal_watchdog_feed(hal_t *hal) {
    (void)hal;
    WATCHDOG->WDOGREFRESH = WATCHDOG_REFRESH_KEY;
}

_Noreturn void chip_restart(void) {
    restart_note = RESTARTED;
    SCB->AIRCR = SCB_AIRCR_VECTKEY_PASSWD | SCB_AIRCR_SYSRESETREQ;
    cpu_barrier();
    for (;;) {
    }
}

void hal_reset(hal_t *hal) {
    (void)hal;
    cpu_interrupts_off();
    servo_kill();
    chip_restart();
}

void hal_irq_lock(hal_t *hal) {
    (void)hal;
    cpu_set_basepri(PRIORITY_BITS(PRIORITY_TICK));
}

void hal_irq_unlock(hal_t *hal) {
    (void)hal;
    cpu_set_basepri(0);
}
