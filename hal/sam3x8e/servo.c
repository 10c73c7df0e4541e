/*
 * The servo's pulses and the tick: channel 4 of the PWM controller, output L, at D9.
 *
 * The channel counts 60000 thirds of a microsecond, 20 ms, from boot on, pulses or none; the end of
 * each period is the tick. With CPOL = 0 its low-side output is high for CDTY counts at the start
 * of a period. Pulses are held back by the output override (OOV = 0: low).
 *
 * The duty (CDTYUPD) and the override (OSSUPD, OSCUPD) are both buffered and both taken over when a
 * period ends, so a pulse is whole or absent. Should the tick be so late that the end of a period
 * falls between the two writes, then the duty comes first and the override stays for one frame
 * more: a late pulse, never one of the wrong width.
 */
#include "board.h"
#include "pins.h"
#include "registers/pwm.h"

#define PWM_CLOCK_HZ (HAL_SERVO_TICKS_PER_US * 1000000u)
#define FRAME_TICKS 60000u
#define OUTPUT PWM_OUTPUT_L(SERVO_PWM_CHANNEL)

/* Nothing longer or shorter ever leaves the board, whatever the parameters say. */
#define SHORTEST_TICKS (500u * HAL_SERVO_TICKS_PER_US)
#define LONGEST_TICKS (2500u * HAL_SERVO_TICKS_PER_US)

static uint16_t clamped(uint16_t ticks) {
    if (ticks < SHORTEST_TICKS) {
        return SHORTEST_TICKS;
    }
    return ticks > LONGEST_TICKS ? LONGEST_TICKS : ticks;
}

void servo_kill(void) { pin_output(PIN_SERVO, false); }

void servo_init(hal_t *hal) {
    servo_kill();
    hal->servo_on = false;
    clock_enable(ID_PWM);
    PWM->DIS = PWM_CHID(SERVO_PWM_CHANNEL);
    PWM->OOV = 0;
    PWM->OSS = OUTPUT;
    PWM->CLK = FIELD(PWM_CLK_DIVA, (hal->clocks.mck_hz + PWM_CLOCK_HZ / 2u) / PWM_CLOCK_HZ);
    volatile pwm_channel_registers_t *channel = &PWM->CHANNEL[SERVO_PWM_CHANNEL];
    channel->CMR = PWM_CMR_CPRE_CLKA;
    channel->CPRD = FRAME_TICKS;
    channel->CDTY = SHORTEST_TICKS;
    PWM->IER1 = PWM_CHID(SERVO_PWM_CHANNEL);
    interrupt_enable(ID_PWM, PRIORITY_TICK);
    PWM->ENA = PWM_CHID(SERVO_PWM_CHANNEL);
}

/* The override holds the PWM's output low as the pin is low: handing it over is no edge. */
static void take_pin_isr(hal_t *hal) {
    if (!hal->servo_on) {
        hal->servo_on = true;
        pin_to_peripheral(PIN_SERVO);
    }
}

void hal_servo_pulse_isr(hal_t *hal, uint16_t width_ticks) {
    if (width_ticks == 0 || !hal_clock_exact(hal)) {
        PWM->OSSUPD = OUTPUT;
        return;
    }
    take_pin_isr(hal);
    PWM->CHANNEL[SERVO_PWM_CHANNEL].CDTYUPD = clamped(width_ticks);
    PWM->OSCUPD = OUTPUT;
}

void servo_isr(void) {
    (void)PWM->ISR1;
    board.ticks++;
    board_tick_isr();
    battery_tick_isr(&board);
}
