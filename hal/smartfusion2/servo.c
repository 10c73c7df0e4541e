/*
 * The servo's pulses leave as bytes on MMUART1, for whatever makes pulses of them: the chip's PWM
 * would be a part of its FPGA. Each frame of 20 ms begins with a record of FRAME_BYTES per servo:
 * 0xA5, servo, width in ticks (u16, 0 = none), number of the frame (u16), sum of the bytes before
 * it. A width that the tick sets is that of the next frame, as with any PWM.
 */
#include "board.h"

#include "base/panic.h"

#define FRAME_BYTES 7u
#define SYNC 0xA5u
#define PULSES_BAUD 115200u

/* Nothing longer or shorter ever leaves the board, whatever the parameters say. */
#define SHORTEST_TICKS (500u * HAL_SERVO_TICKS_PER_US)
#define LONGEST_TICKS (2500u * HAL_SERVO_TICKS_PER_US)

_Static_assert(FRAME_BYTES *HAL_SERVO_COUNT <= UART_FIFO_BYTES, "a frame never waits for the UART");

void servo_init(hal_t *hal) {
    (void)hal;
    uart_start(MMUART1, PULSES_BAUD);
}

/* No frames, no pulses. The timer's enable bit needs no RAM. */
void servo_kill(void) { TIM1->CTRL = 0; }

static void send_isr(uint8_t servo, uint16_t width_ticks, uint16_t frame) {
    const uint8_t bytes[] = {SYNC,
                             servo,
                             (uint8_t)width_ticks,
                             (uint8_t)(width_ticks >> 8),
                             (uint8_t)frame,
                             (uint8_t)(frame >> 8)};
    uint8_t sum = 0;
    for (uint32_t i = 0; i < sizeof bytes; i++) {
        sum = (uint8_t)(sum + bytes[i]);
        MMUART1->RBR_THR_DLR = bytes[i];
    }
    MMUART1->RBR_THR_DLR = sum;
}

/* The UART had 20 ms for the frame before: one that is not empty is broken, and the gap in the
 * numbers tells. */
void servo_frame_isr(hal_t *hal) {
    if ((MMUART1->LSR & UART_LSR_THR_EMPTY) != 0) {
        for (uint32_t servo = 0; servo < HAL_SERVO_COUNT; servo++) {
            send_isr((uint8_t)servo, hal->pulse_ticks[servo], hal->frame);
        }
    }
    hal->frame++;
}

static uint16_t clamped(uint16_t ticks) {
    if (ticks < SHORTEST_TICKS) {
        return SHORTEST_TICKS;
    }
    return ticks > LONGEST_TICKS ? LONGEST_TICKS : ticks;
}

void hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks) {
    REQUIRE(servo < HAL_SERVO_COUNT);
    const bool off = width_ticks == 0 || !hal_clock_exact(hal);
    hal->pulse_ticks[servo] = off ? 0 : clamped(width_ticks);
}
