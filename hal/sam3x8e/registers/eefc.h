/* Enhanced embedded flash controllers: one per bank of 256 KB. */
#ifndef REGISTERS_EEFC_H
#define REGISTERS_EEFC_H

#include "registers/field.h"

typedef struct {
    uint32_t FMR;
    uint32_t FCR;
    const uint32_t FSR;
    const uint32_t FRR;
} efc_registers_t;

REGISTER_AT(efc_registers_t, FRR, 0x0C);

#define EFC0 ((volatile efc_registers_t *)0x400E0A00u)
#define EFC1 ((volatile efc_registers_t *)0x400E0C00u)

#define EFC_FMR_FRDY 0x00000001u
#define EFC_FMR_FWS 0x00000F00u
#define EFC_FMR_SCOD 0x00010000u

#define EFC_FCR_FCMD 0x000000FFu
#define EFC_FCR_FCMD_EWP FIELD(EFC_FCR_FCMD, 0x03)
#define EFC_FCR_FCMD_CLB FIELD(EFC_FCR_FCMD, 0x09)
#define EFC_FCR_FCMD_GLB FIELD(EFC_FCR_FCMD, 0x0A)
#define EFC_FCR_FCMD_STUI FIELD(EFC_FCR_FCMD, 0x0E)
#define EFC_FCR_FCMD_SPUI FIELD(EFC_FCR_FCMD, 0x0F)
#define EFC_FCR_FARG 0x00FFFF00u
#define EFC_FCR_FKEY 0xFF000000u
#define EFC_FCR_FKEY_PASSWD FIELD(EFC_FCR_FKEY, 0x5A)

#define EFC_FSR_FRDY 0x00000001u
#define EFC_FSR_FCMDE 0x00000002u
#define EFC_FSR_FLOCKE 0x00000004u

#endif
