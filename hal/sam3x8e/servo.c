/*
 * The servos' pulses and the tick: one channel of the PWM controller each, output L (pins.h).
 *
 * The channels begin together and count 60000 thirds of a microsecond, 20 ms, from boot on, pulses
 * or none; the end of the tail's period is the tick. With CPOL = 0 a low-side output is high for
 * CDTY counts at the start of a period. Pulses are held back by the output override (OOV = 0: low).
 *
 * The duty (CDTYUPD) and the override (OSSUPD, OSCUPD) are both buffered and both taken over when a
 * period ends, so a pulse is whole or absent. Should the tick be so late that the end of a period
 * falls between the two writes, then the duty comes first and the override stays for one frame
 * more: a late pulse, never one of the wrong width.
 *
 * The pin is the PWM's while pulses are asked for. Both ways it changes hands while the override
 * holds the PWM's output as low as the pin itself is, so that this is no edge: the tick that asks
 * for no pulse any more leaves the pin until the last one is out, and the next tick takes it. From
 * then on each tick sees to it again that the pin is low, whatever became of it.
 */
#include "board.h"
#include "pins.h"
#include "registers/pwm.h"
#include "registers/tc.h"

#include "base/panic.h"

/* While pulses go out. Without the tick the PWM would repeat the last one until the watchdog bites;
 * this interrupt, which is a crash (vectors.c), comes sooner, and through any handler. */
#define DEAD_TICK (&TC0->CHANNEL[1])
#define DEAD_TICK_FRAMES 2u
#define DEAD_TICK_DIVIDER 128u

#define PWM_CLOCK_HZ (HAL_SERVO_TICKS_PER_US * 1000000u)
#define FRAME_TICKS 60000u

typedef struct {
    pin_t pin;
    uint32_t channel;
} servo_wiring_t;

#define WIRING(name, pin, channel) [HAL_SERVO_##name] = {PIN_##pin, channel},
static const servo_wiring_t servos[HAL_SERVO_COUNT] = {SAM3X8E_SERVOS(WIRING)};
#undef WIRING

#define CHANNEL_BIT(name, pin, channel) | PWM_CHID(channel)
#define ALL_CHANNELS (0u SAM3X8E_SERVOS(CHANNEL_BIT))
#define OUTPUT_BIT(name, pin, channel) | PWM_OUTPUT_L(channel)
#define ALL_OUTPUTS (0u SAM3X8E_SERVOS(OUTPUT_BIT))

/* Nothing longer or shorter ever leaves the board, whatever the parameters say. */
#define SHORTEST_TICKS (500u * HAL_SERVO_TICKS_PER_US)
#define LONGEST_TICKS (2500u * HAL_SERVO_TICKS_PER_US)

static uint16_t clamped(uint16_t ticks) {
    if (ticks < SHORTEST_TICKS) {
        return SHORTEST_TICKS;
    }
    return ticks > LONGEST_TICKS ? LONGEST_TICKS : ticks;
}

void servo_kill(void) {
    for (uint32_t servo = 0; servo < HAL_SERVO_COUNT; servo++) {
        pin_output(servos[servo].pin, false);
    }
}

void servo_init(hal_t *hal) {
    servo_kill();
    clock_enable(ID_PWM);
    PWM->DIS = ALL_CHANNELS;
    PWM->OOV = 0;
    PWM->OSS = ALL_OUTPUTS;
    PWM->CLK = FIELD(PWM_CLK_DIVA, (hal->clocks.mck_hz + PWM_CLOCK_HZ / 2u) / PWM_CLOCK_HZ);
    for (uint32_t servo = 0; servo < HAL_SERVO_COUNT; servo++) {
        volatile pwm_channel_registers_t *channel = &PWM->CHANNEL[servos[servo].channel];
        channel->CMR = PWM_CMR_CPRE_CLKA;
        channel->CPRD = FRAME_TICKS;
        channel->CDTY = SHORTEST_TICKS;
    }
    clock_enable(ID_TC1);
    DEAD_TICK->CMR = TC_CMR_WAVE | TC_CMR_TCCLKS_TIMER_CLOCK4;
    DEAD_TICK->RC = hal->clocks.mck_hz / (DEAD_TICK_DIVIDER * 1000u) * 20u * DEAD_TICK_FRAMES;
    DEAD_TICK->IER = TC_IER_CPCS;
    interrupt_enable(ID_TC1, PRIORITY_DEAD_TICK);
    PWM->IER1 = PWM_CHID(servos[HAL_SERVO_TAIL].channel);
    interrupt_enable(ID_PWM, PRIORITY_TICK);
    PWM->ENA = ALL_CHANNELS;
}

void hal_servo_pulse_isr(hal_t *hal, hal_servo_t servo, uint16_t width_ticks) {
    REQUIRE(servo < HAL_SERVO_COUNT);
    const uint32_t channel = servos[servo].channel;
    const bool held = (PWM->OS & PWM_OUTPUT_L(channel)) != 0;
    const bool off = width_ticks == 0 || !hal_clock_exact(hal);
    /* The last pulse is out only when the override holds: until then each tick counts. */
    DEAD_TICK->CCR = off && held ? TC_CCR_CLKDIS : TC_CCR_CLKEN | TC_CCR_SWTRG;
    if (off) {
        PWM->OSSUPD = PWM_OUTPUT_L(channel);
        if (held) {
            pin_output(servos[servo].pin, false);
        }
        return;
    }
    if (held) {
        pin_to_peripheral(servos[servo].pin);
    }
    PWM->CHANNEL[channel].CDTYUPD = clamped(width_ticks);
    PWM->OSCUPD = PWM_OUTPUT_L(channel);
}

void servo_tick_isr(hal_t *hal) {
    (void)PWM->ISR1;
    hal->ticks++;
}
