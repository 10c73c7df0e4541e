/*
 * Time since boot and the tick. TIM1 counts 20 ms and asks for the tick. TIM2 counts down through
 * 32 bits, which wraps after 60 s; the tick moves the point that microseconds are counted from.
 */
#include "board.h"

void interrupt_enable(uint32_t number, uint32_t priority) {
    NVIC->IPR[number] = (uint8_t)PRIORITY_BITS(priority);
    NVIC->ICPR[number / 32u] = 1u << (number % 32u);
    NVIC->ISER[number / 32u] = 1u << (number % 32u);
}

/* A reset of the core alone leaves the timers running. */
void time_init(hal_t *hal) {
    TIM1->CTRL = 0;
    TIM1->RIS = 1u;
    TIM2->CTRL = 0;
    TIM2->LOADVAL = UINT32_MAX;
    TIM2->CTRL = TIMER_CTRL_ENABLE;
    hal->time_us = 0;
    hal->time_last = TIM2->VAL;
}

void time_start_ticks(void) {
    TIM1->LOADVAL = COUNTS_PER_US * FRAME_US;
    interrupt_enable(INTERRUPT_TIMER1, PRIORITY_TICK);
    TIM1->CTRL = TIMER_CTRL_ENABLE | TIMER_CTRL_INTERRUPT;
}

static void move_base_isr(hal_t *hal) {
    const uint32_t mask = cpu_primask();
    cpu_interrupts_off();
    const uint32_t passed_us = (hal->time_last - TIM2->VAL) / COUNTS_PER_US;
    hal->time_us += passed_us;
    hal->time_last -= passed_us * COUNTS_PER_US;
    cpu_set_primask(mask);
}

void time_tick_isr(hal_t *hal) {
    TIM1->RIS = 1u;
    move_base_isr(hal);
}

/* The tick may come between the reads. */
uint64_t hal_time_us(const hal_t *hal) {
    const uint32_t mask = cpu_primask();
    cpu_interrupts_off();
    const uint32_t counts = hal->time_last - TIM2->VAL;
    const uint64_t base_us = hal->time_us;
    cpu_set_primask(mask);
    return base_us + counts / COUNTS_PER_US;
}

bool hal_clock_exact(const hal_t *hal) {
    (void)hal;
    return (SYSREG->MSSDDR_PLL_STATUS & PLLS_LOCKED) == PLLS_LOCKED;
}
