/* Power management controller: clocks. */
#ifndef REGISTERS_PMC_H
#define REGISTERS_PMC_H

#include "registers/field.h"

typedef struct {
    uint32_t SCER;
    uint32_t SCDR;
    const uint32_t SCSR;
    uint32_t reserved_00c;
    uint32_t PCER0;
    uint32_t PCDR0;
    const uint32_t PCSR0;
    uint32_t CKGR_UCKR;
    uint32_t CKGR_MOR;
    const uint32_t CKGR_MCFR;
    uint32_t CKGR_PLLAR;
    uint32_t reserved_02c;
    uint32_t MCKR;
    uint32_t reserved_034[11];
    uint32_t IER;
    uint32_t IDR;
    const uint32_t SR; /* reading clears CFDEV */
    const uint32_t IMR;
    uint32_t reserved_070[36];
    uint32_t PCER1;
    uint32_t PCDR1;
    const uint32_t PCSR1;
} pmc_registers_t;

REGISTER_AT(pmc_registers_t, SR, 0x68);
REGISTER_AT(pmc_registers_t, PCSR1, 0x108);

#define PMC ((volatile pmc_registers_t *)0x400E0600u)

#define CKGR_MOR_MOSCXTEN 0x00000001u
#define CKGR_MOR_MOSCRCEN 0x00000008u
#define CKGR_MOR_MOSCRCF 0x00000070u
#define CKGR_MOR_MOSCRCF_12_MHZ FIELD(CKGR_MOR_MOSCRCF, 2)
#define CKGR_MOR_MOSCXTST 0x0000FF00u
#define CKGR_MOR_KEY 0x00FF0000u
#define CKGR_MOR_KEY_PASSWD FIELD(CKGR_MOR_KEY, 0x37)
#define CKGR_MOR_MOSCSEL 0x01000000u
#define CKGR_MOR_CFDEN 0x02000000u

#define CKGR_PLLAR_DIVA 0x000000FFu
#define CKGR_PLLAR_PLLACOUNT 0x00003F00u
#define CKGR_PLLAR_MULA 0x07FF0000u
#define CKGR_PLLAR_ONE 0x20000000u

#define PMC_MCKR_CSS 0x00000003u
#define PMC_MCKR_CSS_MAIN_CLK FIELD(PMC_MCKR_CSS, 1)
#define PMC_MCKR_CSS_PLLA_CLK FIELD(PMC_MCKR_CSS, 2)
#define PMC_MCKR_PRES 0x00000070u
#define PMC_MCKR_PRES_CLK_1 FIELD(PMC_MCKR_PRES, 0)
#define PMC_MCKR_PRES_CLK_2 FIELD(PMC_MCKR_PRES, 1)

#define PMC_SR_MOSCXTS 0x00000001u
#define PMC_SR_LOCKA 0x00000002u
#define PMC_SR_MCKRDY 0x00000008u
#define PMC_SR_MOSCSELS 0x00010000u
#define PMC_SR_MOSCRCS 0x00020000u
#define PMC_SR_CFDS 0x00080000u

#define PMC_IER_CFDEV 0x00040000u

#endif
