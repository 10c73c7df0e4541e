/* Analogue to digital converter, 12 bits. */
#ifndef REGISTERS_ADC_H
#define REGISTERS_ADC_H

#include "registers/field.h"

typedef struct {
    uint32_t CR;
    uint32_t MR;
    uint32_t SEQR1;
    uint32_t SEQR2;
    uint32_t CHER;
    uint32_t CHDR;
    const uint32_t CHSR;
    uint32_t reserved_01c;
    const uint32_t LCDR;
    uint32_t IER;
    uint32_t IDR;
    const uint32_t IMR;
    const uint32_t ISR;
    uint32_t reserved_034[7];
    const uint32_t CDR[16];
} adc_registers_t;

REGISTER_AT(adc_registers_t, ISR, 0x30);
REGISTER_AT(adc_registers_t, CDR, 0x50);

#define ADC ((volatile adc_registers_t *)0x400C0000u)

#define ADC_CR_SWRST 0x00000001u
#define ADC_CR_START 0x00000002u

#define ADC_MR_PRESCAL 0x0000FF00u
#define ADC_MR_STARTUP 0x000F0000u
#define ADC_MR_TRACKTIM 0x0F000000u
#define ADC_MR_TRANSFER 0x30000000u

#define ADC_CDR_DATA 0x00000FFFu

/* Bit of |channel| in CHER, CHDR, CHSR and, as "conversion ended", in ISR. */
#define ADC_CHANNEL(channel) (1u << (channel))

#endif
