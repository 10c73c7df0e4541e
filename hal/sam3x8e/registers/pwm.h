/* Pulse width modulation: the servo's pulses and the tick. */
#ifndef REGISTERS_PWM_H
#define REGISTERS_PWM_H

#include "registers/field.h"

typedef struct {
    uint32_t CMR;
    uint32_t CDTY;    /* written only while the channel is off */
    uint32_t CDTYUPD; /* taken over when the period ends */
    uint32_t CPRD;
    uint32_t CPRDUPD;
    const uint32_t CCNT;
    uint32_t DT;
    uint32_t DTUPD;
} pwm_channel_registers_t;

typedef struct {
    uint32_t CLK;
    uint32_t ENA;
    uint32_t DIS;
    const uint32_t SR;
    uint32_t IER1;
    uint32_t IDR1;
    const uint32_t IMR1;
    const uint32_t ISR1; /* reading clears it */
    uint32_t SCM;
    uint32_t reserved_024[8];
    uint32_t OOV;
    uint32_t OS;
    uint32_t OSS;
    uint32_t OSC;
    uint32_t OSSUPD;
    uint32_t OSCUPD;
    uint32_t reserved_05c[34];
    uint32_t WPCR;
    uint32_t reserved_0e8[70];
    pwm_channel_registers_t CHANNEL[8];
} pwm_registers_t;

REGISTER_AT(pwm_channel_registers_t, DTUPD, 0x1C);
REGISTER_AT(pwm_registers_t, OSCUPD, 0x58);
REGISTER_AT(pwm_registers_t, CHANNEL, 0x200);

#define PWM ((volatile pwm_registers_t *)0x40094000u)

#define PWM_CLK_DIVA 0x000000FFu

#define PWM_CMR_CPRE 0x0000000Fu
#define PWM_CMR_CPRE_CLKA FIELD(PWM_CMR_CPRE, 0xB)

/* Bit of |channel| in ENA, DIS, SR and the interrupt registers. */
#define PWM_CHID(channel) (1u << (channel))
/* Bit of |channel|'s output L in OOV, OS, OSS, OSC, OSSUPD and OSCUPD. */
#define PWM_OUTPUT_L(channel) (0x10000u << (channel))

#endif
