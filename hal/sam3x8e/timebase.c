/*
 * Time since boot: channel 0 of timer TC0 counts half the master clock in 32 bits, which wraps
 * after 102 s at 84 MHz. The tick moves the point that microseconds are counted from every 20 ms.
 */
#include "board.h"
#include "registers/tc.h"

#define COUNTER (&TC0->CHANNEL[0])

void timebase_init(hal_t *hal) {
    clock_enable(ID_TC0);
    COUNTER->CMR = TC_CMR_WAVE | TC_CMR_TCCLKS_TIMER_CLOCK1;
    COUNTER->CCR = TC_CCR_CLKEN | TC_CCR_SWTRG;
    hal->time_us = 0;
    hal->time_last = 0;
    hal->counts_per_us = hal->clocks.mck_hz / 2000000u;
}

void timebase_tick_isr(hal_t *hal) {
    const uint32_t mask = cpu_primask();
    cpu_interrupts_off();
    const uint32_t passed_us = (COUNTER->CV - hal->time_last) / hal->counts_per_us;
    hal->time_us += passed_us;
    hal->time_last += passed_us * hal->counts_per_us;
    cpu_set_primask(mask);
}

/* The tick may come between the three reads, and a more urgent interrupt within the tick. */
uint64_t hal_time_us(const hal_t *hal) {
    if (hal->counts_per_us == 0) {
        return 0;
    }
    const uint32_t mask = cpu_primask();
    cpu_interrupts_off();
    const uint32_t counts = COUNTER->CV - hal->time_last;
    const uint64_t base_us = hal->time_us;
    cpu_set_primask(mask);
    return base_us + counts / hal->counts_per_us;
}

bool hal_clock_exact(const hal_t *hal) { return hal->clocks.exact; }
