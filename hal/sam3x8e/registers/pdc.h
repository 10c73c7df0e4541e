/* Peripheral DMA: two buffers per direction, the next one taken when the current one is through. */
#ifndef REGISTERS_PDC_H
#define REGISTERS_PDC_H

#include "registers/field.h"

typedef struct {
    uint32_t RPR;
    uint32_t RCR;
    uint32_t TPR;
    uint32_t TCR;
    uint32_t RNPR;
    uint32_t RNCR;
    uint32_t TNPR;
    uint32_t TNCR;
    uint32_t PTCR;
    const uint32_t PTSR;
} pdc_registers_t;

REGISTER_AT(pdc_registers_t, PTSR, 0x24);

#define PDC_PTCR_RXTEN 0x00000001u
#define PDC_PTCR_RXTDIS 0x00000002u
#define PDC_PTCR_TXTEN 0x00000100u
#define PDC_PTCR_TXTDIS 0x00000200u

#endif
