/*
 * What is used of the SmartFusion2's peripherals (Microsemi UG0331), under the names of its guide.
 * 32-bit accesses only; read-only registers are const.
 */
#ifndef SMARTFUSION2_REGISTERS_H
#define SMARTFUSION2_REGISTERS_H

#include "registers/field.h"

/* MMUART: a 16550 with its registers four bytes apart. */
typedef struct {
    uint32_t RBR_THR_DLR; /* receive, transmit; low divisor while LCR_DLAB is set */
    uint32_t IER_DMR;     /* interrupts; high divisor likewise */
    uint32_t IIR_FCR;     /* why the interrupt; FIFO control */
    uint32_t LCR;
    uint32_t MCR;
    const uint32_t LSR;
} uart_registers_t;

REGISTER_AT(uart_registers_t, LSR, 0x14);

#define MMUART0 ((volatile uart_registers_t *)0x40000000u)
#define MMUART1 ((volatile uart_registers_t *)0x40010000u)

#define UART_IER_RECEIVED 0x01u
#define UART_IER_SENT 0x02u
#define UART_FCR_ENABLE 0x01u
#define UART_FCR_CLEAR_RX 0x02u
#define UART_FCR_CLEAR_TX 0x04u
#define UART_FCR_RX_14_BYTES 0xC0u
#define UART_LCR_8_BITS 0x03u
#define UART_LCR_DLAB 0x80u
#define UART_LSR_READY 0x01u
#define UART_LSR_OVERRUN 0x02u
#define UART_LSR_FRAMING 0x08u
#define UART_LSR_THR_EMPTY 0x20u
#define UART_FIFO_BYTES 16u

typedef struct {
    uint32_t CONTROL;
    uint32_t DFSIZE;
    const uint32_t STATUS;
    uint32_t INT_CLEAR;
    const uint32_t RX_DATA;
    uint32_t TX_DATA;
    uint32_t CLK_GEN;
    uint32_t SLAVE_SELECT;
} spi_registers_t;

REGISTER_AT(spi_registers_t, SLAVE_SELECT, 0x1C);

#define SPI0 ((volatile spi_registers_t *)0x40001000u)

#define SPI_CONTROL_ENABLE 0x00000001u
#define SPI_CONTROL_MASTER 0x00000002u
#define SPI_CONTROL_FRAMES 0x00FFFF00u /* of a transfer, through which the slave stays selected */
#define SPI_CONTROL_SPS 0x04000000u
#define SPI_CONTROL_BIGFIFO 0x20000000u
#define SPI_STATUS_RX_EMPTY 0x00000040u

/* The system timer: two down-counters on APB0's clock. */
typedef struct {
    const uint32_t VAL;
    uint32_t LOADVAL;
    uint32_t BGLOADVAL;
    uint32_t CTRL;
    uint32_t RIS;
} timer_registers_t;

REGISTER_AT(timer_registers_t, RIS, 0x10);

#define TIM1 ((volatile timer_registers_t *)0x40004000u)
#define TIM2 ((volatile timer_registers_t *)0x40004018u)

#define TIMER_CTRL_ENABLE 0x1u
#define TIMER_CTRL_INTERRUPT 0x4u

typedef struct {
    const uint32_t WDOGVALUE;
    const uint32_t WDOGLOAD;
    const uint32_t WDOGMVRP;
    uint32_t WDOGREFRESH;
} watchdog_registers_t;

#define WATCHDOG ((volatile watchdog_registers_t *)0x40005000u)
#define WATCHDOG_REFRESH_KEY 0xAC15DE42u

typedef struct {
    uint32_t CFG[32];
    uint32_t IRQ;
    const uint32_t IN;
    uint32_t OUT;
} gpio_registers_t;

REGISTER_AT(gpio_registers_t, OUT, 0x88);

#define GPIO ((volatile gpio_registers_t *)0x40013000u)
#define GPIO_CFG_OUTPUT 0x5u /* output register and its buffer on */

typedef struct {
    uint32_t reserved_00[18];
    uint32_t SOFT_RESET_CR;
    uint32_t reserved_4c[64];
    const uint32_t DEVICE_VERSION;
    const uint32_t MSSDDR_PLL_STATUS;
} sysreg_registers_t;

REGISTER_AT(sysreg_registers_t, SOFT_RESET_CR, 0x48);
REGISTER_AT(sysreg_registers_t, MSSDDR_PLL_STATUS, 0x150);

#define SYSREG ((volatile sysreg_registers_t *)0x40038000u)

/* Timer, MMUART0, MMUART1, SPI0, GPIO. */
#define SOFT_RESETS_USED ((1u << 6) | (1u << 7) | (1u << 8) | (1u << 9) | (1u << 14))
#define PLLS_LOCKED 0x3u

#define DDR_BYTES (64u * 1024u * 1024u)
#define MPU_RASR_AP_ALL 0x03000000u
#define MPU_RASR_CACHED 0x00020000u /* normal memory, write-through */

enum { INTERRUPT_MMUART0 = 10, INTERRUPT_TIMER1 = 14, INTERRUPTS = 81 };

#endif
