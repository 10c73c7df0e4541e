/*
 * The board: what hal_t points at, and what the files of this folder share. Each driver owns its
 * part of the struct; there is one, defined in main.c.
 *
 * MMUART0 is the console. MMUART1 carries the servo's pulses (servo.c). There is no third UART: the
 * radio and the IMU are not there.
 */
#ifndef SMARTFUSION2_BOARD_H
#define SMARTFUSION2_BOARD_H

#include "crash.h"
#include "hal/clock.h"
#include "hal/flash.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"
#include "registers.h"
#include "registers/cortex_m3.h"

/* The core's clock, as the board's design sets it; the peripherals' is half of it. */
#define CORE_HZ 142000000u
#define APB0_HZ (CORE_HZ / 2u)
#define COUNTS_PER_US (APB0_HZ / 1000000u)
#define FRAME_US 20000u

/* 0 = most urgent of 16. hal_irq_lock() raises BASEPRI to the tick's. */
#define PRIORITY_CONSOLE 4u
#define PRIORITY_TICK 8u
#define PRIORITY_BITS(priority) ((priority) << 4)

#define RX_BYTES 2048u /* powers of two */
#define TX_BYTES 1024u

struct hal {
    volatile bool wake; /* set by every handler: the main loop has something to do */

    uint64_t time_us;   /* time.c: the time when the counter was at ... */
    uint32_t time_last; /* ... this */

    uint8_t rx[RX_BYTES], tx[TX_BYTES];  /* serial.c */
    volatile uint32_t rx_put, rx_got;    /* bytes since boot */
    volatile uint32_t tx_put, tx_got;    /* ... */
    volatile uint32_t overruns, framing; /* ... */

    uint16_t pulse_ticks[HAL_SERVO_COUNT]; /* servo.c: of the next frame */
    uint16_t frame;                        /* its number, modulo 2^16 */

    bool nor_there; /* nor.c: it answers as what it should be */

    hal_reset_cause_t reset_cause; /* chip.c, read once at boot */
};

extern hal_t board;

/* Once at boot, in this order; time_start_ticks() after app_init(). */
void time_init(hal_t *hal);
void chip_init(hal_t *hal);
void nor_init(hal_t *hal);
void serial_init(hal_t *hal);
void servo_init(hal_t *hal);
void time_start_ticks(void);

/* Once per tick, before the firmware's: the timer is acknowledged, the pulses that begin now go
 * out.
 */
void time_tick_isr(hal_t *hal);
void servo_frame_isr(hal_t *hal);

void console_isr(void); /* MMUART0 */
void tick_isr(void);    /* TIM1; main.c */

/* Sets a UART to |baud|, 8N1, its FIFOs empty and on. */
void uart_start(volatile uart_registers_t *uart, uint32_t baud);

/* Lets interrupt |number| through at |priority|. */
void interrupt_enable(uint32_t number, uint32_t priority);

#endif
