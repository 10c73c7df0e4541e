#include "startup.h"

#include "board.h"
#include "crash.h"
#include "guard.h"
#include "memory_map.h"
#include "registers/matrix.h"
#include "registers/rstc.h"
#include "registers/supc.h"
#include "registers/wdt.h"

#include <string.h>

int main(void);

/* In 128 periods of the slow RC oscillator: 1 s, between 0.74 and 1.64 s as that one spreads. */
#define WATCHDOG_COUNT 256u

/* The only write that the watchdog takes. It runs on in WFI and halts for a debugger; the window
 * (WDD) is open all the time. */
static void start_watchdog(void) {
    WDT->MR = WDT_MR_WDRSTEN | WDT_MR_WDDBGHLT | WDT_MR_WDD | FIELD(WDT_MR_WDV, WATCHDOG_COUNT);
}

/* The boot loader may leave the reset pin switched off. */
static void enable_reset_pin(void) { RSTC->MR = RSTC_MR_KEY_PASSWD | RSTC_MR_URSTEN; }

/* Without a default master each access to SRAM waits a cycle. */
static void speed_up_sram(void) {
    const uint32_t last_master = MATRIX_SCFG_DEFMSTR_TYPE_LAST | FIELD(MATRIX_SCFG_SLOT_CYCLE, 64);
    MATRIX->SCFG[0] = last_master;
    MATRIX->SCFG[1] = last_master;
}

static void watch_supply(void) { SUPC->SMMR = SUPC_SMMR_SMTH_2_9V | SUPC_SMMR_SMSMPL_CSM; }

static size_t bytes_between(const uint32_t *start, const uint32_t *end) {
    return (uintptr_t)end - (uintptr_t)start;
}

static void fill_ram(void) {
    memcpy(__data_start, __data_load, bytes_between(__data_start, __data_end));
    memset(__bss_start, 0, bytes_between(__bss_start, __bss_end));
}

static void enable_faults(void) {
    SCB->SHCSR = SCB_SHCSR_MEMFAULTENA | SCB_SHCSR_BUSFAULTENA | SCB_SHCSR_USGFAULTENA;
    SCB->CCR |= SCB_CCR_DIV_0_TRP;
}

_Noreturn void reset_handler(void) {
    start_watchdog();
    servo_kill();
    enable_reset_pin();
    SCB->VTOR = (uint32_t)&vectors;
    speed_up_sram();
    const clock_tree_t clocks = clock_tree_init();
    fill_ram();
    board.clocks = clocks;
    guard_init();
    enable_faults();
    watch_supply();
    (void)main();
    chip_restart();
}
