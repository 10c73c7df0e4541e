/* Supply controller: monitor of the 3.3 V rail, brown-out detector, slow clock. */
#ifndef REGISTERS_SUPC_H
#define REGISTERS_SUPC_H

#include "registers/field.h"

typedef struct {
    uint32_t CR;
    uint32_t SMMR;
    uint32_t MR;
    uint32_t WUMR;
    uint32_t WUIR;
    const uint32_t SR; /* reading clears SMS */
} supc_registers_t;

REGISTER_AT(supc_registers_t, SR, 0x14);

#define SUPC ((volatile supc_registers_t *)0x400E1A10u)

#define SUPC_SMMR_SMTH 0x0000000Fu
#define SUPC_SMMR_SMTH_2_9V FIELD(SUPC_SMMR_SMTH, 10)
#define SUPC_SMMR_SMSMPL 0x00000700u
#define SUPC_SMMR_SMSMPL_CSM FIELD(SUPC_SMMR_SMSMPL, 1)

#define SUPC_SR_SMOS 0x00000040u

#endif
