/* The drivers' interrupt handlers, as the vector table knows them, and how one is switched on. */
#ifndef SAM3X8E_INTERRUPTS_H
#define SAM3X8E_INTERRUPTS_H

#include "registers/cortex_m3.h"
#include "registers/peripherals.h"

/* 0 = most urgent of 16. hal_irq_lock() raises BASEPRI to the tick's, so that bytes go on moving
 * meanwhile. */
#define PRIORITY_CLOCK_FAILURE 0u
#define PRIORITY_DEAD_TICK 0u
#define PRIORITY_CONSOLE 2u
#define PRIORITY_DMA 4u
#define PRIORITY_TICK 8u

/* |priority| as the core wants it: in the upper four of eight bits. */
#define PRIORITY_BITS(priority) ((priority) << 4)

void console_isr(void);       /* UART: a byte came, a block is sent */
void imu_isr(void);           /* USART0: half a ring came, the line went quiet, a block is sent */
void radio_isr(void);         /* USART1: likewise */
void storage_flash_isr(void); /* EFC1: the flash is done */
void servo_isr(void);         /* PWM: a servo frame begins; the 50 Hz tick */

/* Lets the interrupt of peripheral |id| through at |priority|, 0 (most urgent) to 15. What it asked
 * for before is forgotten, unless it still does: the NVIC keeps requests that were taken back. */
static inline void interrupt_enable(uint32_t id, uint32_t priority) {
    NVIC->IPR[id] = (uint8_t)PRIORITY_BITS(priority);
    NVIC->ICPR[id / 32u] = 1u << (id % 32u);
    NVIC->ISER[id / 32u] = 1u << (id % 32u);
}

/* A request that stands by then is forgotten, unless its peripheral still makes it. */
static inline void interrupt_disable(uint32_t id) {
    NVIC->ICER[id / 32u] = 1u << (id % 32u);
    NVIC->ICPR[id / 32u] = 1u << (id % 32u);
}

#endif
