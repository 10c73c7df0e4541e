/* From reset to main(), and where the core goes on faults and interrupts. */
#include "board.h"
#include "guard.h"
#include "memory_map.h"

#include <string.h>

int main(void);

typedef void (*handler_t)(void);

#define EXCEPTIONS 15u

_Noreturn void reset_handler(void);

/* Aligned for VTOR: the next power of two above its 388 bytes. */
static const struct {
    const uint32_t *stack_top;
    handler_t exceptions[EXCEPTIONS];
    handler_t interrupts[INTERRUPTS];
} vectors __attribute__((section(".vectors"), used, aligned(512))) = {
    .stack_top = __stack_top,
    .exceptions = {reset_handler, crash_entry_isr, crash_entry_isr, crash_entry_isr,
                   crash_entry_isr, crash_entry_isr, 0, 0, 0, 0, crash_entry_isr, crash_entry_isr,
                   0, crash_entry_isr, crash_entry_isr},
    .interrupts = {[0 ... INTERRUPT_MMUART0 - 1] = crash_entry_isr,
                   [INTERRUPT_MMUART0] = console_isr,
                   [INTERRUPT_MMUART0 + 1 ... INTERRUPT_TIMER1 - 1] = crash_entry_isr,
                   [INTERRUPT_TIMER1] = tick_isr,
                   [INTERRUPT_TIMER1 + 1 ... INTERRUPTS - 1] = crash_entry_isr},
};

static size_t bytes_between(const uint32_t *start, const uint32_t *end) {
    return (uintptr_t)end - (uintptr_t)start;
}

static void fill_ram(void) {
    memcpy(__data_start, __data_load, bytes_between(__data_start, __data_end));
    memset(__bss_start, 0, bytes_between(__bss_start, __bss_end));
}

/* Where DDR lies the core expects a device, which takes aligned accesses only. */
static void make_ddr_memory(void) {
    MPU->RNR = 0;
    MPU->RBAR = (uint32_t)__ram_start;
    MPU->RASR = MPU_RASR_ENABLE | MPU_RASR_XN | MPU_RASR_AP_ALL | MPU_RASR_CACHED |
                FIELD(MPU_RASR_SIZE, __builtin_ctz(DDR_BYTES) - 1);
    MPU->CTRL = MPU_CTRL_ENABLE | MPU_CTRL_PRIVDEFENA;
    cpu_barrier();
}

static void enable_faults(void) {
    SCB->SHCSR = SCB_SHCSR_MEMFAULTENA | SCB_SHCSR_BUSFAULTENA | SCB_SHCSR_USGFAULTENA;
    SCB->CCR |= SCB_CCR_DIV_0_TRP;
}

_Noreturn void reset_handler(void) {
    SCB->VTOR = (uint32_t)&vectors;
    SYSREG->SOFT_RESET_CR &= ~SOFT_RESETS_USED;
    make_ddr_memory();
    fill_ram();
    guard_init();
    enable_faults();
    (void)main();
    chip_restart();
}
