/* Reset controller. */
#ifndef REGISTERS_RSTC_H
#define REGISTERS_RSTC_H

#include "registers/field.h"

typedef struct {
    uint32_t CR;
    const uint32_t SR;
    uint32_t MR;
} rstc_registers_t;

REGISTER_AT(rstc_registers_t, MR, 0x08);

#define RSTC ((volatile rstc_registers_t *)0x400E1A00u)

#define RSTC_CR_PROCRST 0x00000001u
#define RSTC_CR_PERRST 0x00000004u
#define RSTC_CR_KEY 0xFF000000u
#define RSTC_CR_KEY_PASSWD FIELD(RSTC_CR_KEY, 0xA5)

#define RSTC_SR_RSTTYP 0x00000700u

#define RSTC_MR_URSTEN 0x00000001u
#define RSTC_MR_KEY 0xFF000000u
#define RSTC_MR_KEY_PASSWD FIELD(RSTC_MR_KEY, 0xA5)

#endif
