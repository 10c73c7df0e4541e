/* Bus matrix: who gets at which memory without waiting. */
#ifndef REGISTERS_MATRIX_H
#define REGISTERS_MATRIX_H

#include "registers/field.h"

typedef struct {
    uint32_t MCFG[6];
    uint32_t reserved_018[10];
    uint32_t SCFG[9]; /* slaves: 0 and 1 are SRAM0 and SRAM1 */
} matrix_registers_t;

REGISTER_AT(matrix_registers_t, SCFG, 0x40);

#define MATRIX ((volatile matrix_registers_t *)0x400E0400u)

#define MATRIX_SCFG_SLOT_CYCLE 0x000000FFu
#define MATRIX_SCFG_DEFMSTR_TYPE 0x00030000u
#define MATRIX_SCFG_DEFMSTR_TYPE_LAST FIELD(MATRIX_SCFG_DEFMSTR_TYPE, 1)

#endif
