/* Watchdog. MR takes one write per reset. */
#ifndef REGISTERS_WDT_H
#define REGISTERS_WDT_H

#include "registers/field.h"

typedef struct {
    uint32_t CR;
    uint32_t MR;
    const uint32_t SR;
} wdt_registers_t;

REGISTER_AT(wdt_registers_t, SR, 0x08);

#define WDT ((volatile wdt_registers_t *)0x400E1A50u)

#define WDT_CR_WDRSTT 0x00000001u
#define WDT_CR_KEY 0xFF000000u
#define WDT_CR_KEY_PASSWD FIELD(WDT_CR_KEY, 0xA5)

#define WDT_MR_WDV 0x00000FFFu
#define WDT_MR_WDRSTEN 0x00002000u
#define WDT_MR_WDD 0x0FFF0000u
#define WDT_MR_WDDBGHLT 0x10000000u

#endif
