/* Parallel I/O: the pins, 32 per port. */
#ifndef REGISTERS_PIO_H
#define REGISTERS_PIO_H

#include "registers/field.h"

typedef struct {
    uint32_t PER;
    uint32_t PDR;
    const uint32_t PSR;
    uint32_t reserved_00c;
    uint32_t OER;
    uint32_t ODR;
    const uint32_t OSR;
    uint32_t reserved_01c[5];
    uint32_t SODR;
    uint32_t CODR;
    uint32_t ODSR;
    const uint32_t PDSR;
    uint32_t reserved_040[8];
    uint32_t PUDR;
    uint32_t PUER;
    const uint32_t PUSR;
    uint32_t reserved_06c;
    uint32_t ABSR; /* 0 = peripheral A, 1 = B */
} pio_registers_t;

REGISTER_AT(pio_registers_t, PDSR, 0x3C);
REGISTER_AT(pio_registers_t, ABSR, 0x70);

#define PIOA ((volatile pio_registers_t *)0x400E0E00u)
#define PIOB ((volatile pio_registers_t *)0x400E1000u)
#define PIOC ((volatile pio_registers_t *)0x400E1200u)
#define PIOD ((volatile pio_registers_t *)0x400E1400u)

#endif
