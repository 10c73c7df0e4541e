/* The chip itself: who it is, why it started, LED, watchdog, restart. */
#include "board.h"
#include "crash.h"
#include "pins.h"
#include "registers/eefc.h"
#include "registers/rstc.h"
#include "registers/wdt.h"

#include <string.h>

#define ID_WORDS 4u
#define FLASH_POLLS_MAX 100000u

#define EMULATOR_ID "tailbeat" /* how the emulator's ids begin; the rest differs by board */

static const volatile uint32_t *const bank0 = (const volatile uint32_t *)0x00080000u;

/*
 * Between its two commands the flash shows the unique identifier in place of its first words, and
 * code fetched from it may be wrong (errata: sequential fetch must be off, SCOD). So this runs from
 * RAM, calls nobody, and no interrupt may come: the vector table is in flash too.
 */
static __attribute__((section(".ramfunc"), noinline, long_call)) void
read_unique_id(uint32_t out[ID_WORDS]) {
    const uint32_t mode = EFC0->FMR;
    EFC0->FMR = mode | EFC_FMR_SCOD;
    EFC0->FCR = EFC_FCR_FKEY_PASSWD | EFC_FCR_FCMD_STUI;
    for (uint32_t i = 0; i < FLASH_POLLS_MAX && (EFC0->FSR & EFC_FSR_FRDY) != 0; i++) {
    }
    for (uint32_t i = 0; i < ID_WORDS; i++) {
        out[i] = bank0[i];
    }
    EFC0->FCR = EFC_FCR_FKEY_PASSWD | EFC_FCR_FCMD_SPUI;
    for (uint32_t i = 0; i < FLASH_POLLS_MAX && (EFC0->FSR & EFC_FSR_FRDY) == 0; i++) {
    }
    EFC0->FMR = mode;
}

static hal_reset_cause_t read_reset_cause(void) {
    const uint32_t type = FIELD_OF(RSTC->SR, RSTC_SR_RSTTYP);
    return type <= HAL_RESET_PIN ? (hal_reset_cause_t)type : HAL_RESET_POWER;
}

void chip_init(hal_t *hal) {
    uint32_t id[ID_WORDS];
    const uint32_t mask = cpu_primask();
    cpu_interrupts_off();
    read_unique_id(id);
    cpu_set_primask(mask);
    memcpy(hal->unique_id, id, sizeof hal->unique_id);
    hal->reset_cause = read_reset_cause();
    pin_output(PIN_LED, false);
}

const char *hal_board_name(const hal_t *hal) {
    const bool emulated = memcmp(hal->unique_id, EMULATOR_ID, sizeof EMULATOR_ID - 1) == 0;
    return emulated ? "emulated" : "fish";
}

_Noreturn void chip_restart(void) {
    RSTC->CR = RSTC_CR_KEY_PASSWD | RSTC_CR_PERRST | RSTC_CR_PROCRST;
    cpu_barrier();
    for (volatile uint32_t waited = 0; waited < 10000u; waited++) {
    }
    SCB->AIRCR = SCB_AIRCR_VECTKEY_PASSWD | SCB_AIRCR_SYSRESETREQ;
    cpu_barrier();
    for (;;) {
    }
}

hal_reset_cause_t hal_reset_cause(const hal_t *hal) { return hal->reset_cause; }

void hal_unique_id(const hal_t *hal, uint8_t out[16]) {
    memcpy(out, hal->unique_id, sizeof hal->unique_id);
}

void hal_led_isr(hal_t *hal, bool on) {
    (void)hal;
    pin_set(PIN_LED, on);
}

void hal_watchdog_feed(hal_t *hal) {
    (void)hal;
    WDT->CR = WDT_CR_KEY_PASSWD | WDT_CR_WDRSTT;
}

/* With interrupts off: no tick hands the servo's pin back. */
void hal_reset(hal_t *hal) {
    (void)hal;
    cpu_interrupts_off();
    servo_kill();
    chip_restart();
}
