#include "clock_tree.h"

#include "interrupts.h"
#include "registers/eefc.h"
#include "registers/peripherals.h"
#include "registers/pmc.h"

#define CRYSTAL_HZ 12000000u
#define FULL_SPEED_HZ 84000000u

/* Between 53 and 78 MHz the flash needs three wait states, above four. */
#define FLASH_WAIT_STATES 4u

/* The crystal is given 64 * 8 periods of the slow clock to start: 12 to 26 ms as that one spreads.
 * A slow starter must not be taken for a dead one. */
#define CRYSTAL_START_COUNT 64u

/* 12 MHz * (13 + 1) = 168 MHz, halved for the core; the PLL gets 63 slow periods to lock. */
#define PLL_MULTIPLIER 13u
#define PLL_LOCK_COUNT 63u

/* A poll takes at least 0.3 us at 12 MHz, so that this is 60 ms or more, twice what the slowest
 * change needs. */
#define POLLS_MAX 200000u

/* The detector tells after two periods of the slow clock, 100 us at most. */
#define FAILURE_DETECTOR_POLLS 1000u

#define RC_12_MHZ (CKGR_MOR_KEY_PASSWD | CKGR_MOR_MOSCRCEN | CKGR_MOR_MOSCRCF_12_MHZ)
#define CRYSTAL_ON (CKGR_MOR_MOSCXTEN | FIELD(CKGR_MOR_MOSCXTST, CRYSTAL_START_COUNT))

static bool wait_for(uint32_t flag) {
    for (uint32_t poll = 0; poll < POLLS_MAX; poll++) {
        if ((PMC->SR & flag) != 0) {
            return true;
        }
    }
    return false;
}

static bool set_main(uint32_t mor, uint32_t ready) {
    PMC->CKGR_MOR = mor;
    return wait_for(ready);
}

static bool set_master(uint32_t source, uint32_t divider) {
    PMC->MCKR = source | divider;
    return wait_for(PMC_SR_MCKRDY);
}

/* After a reset of the chip the core runs on the RC oscillator. A debugger or boot loader that only
 * jumps here leaves it on the PLL or the crystal, neither of which may be changed while in use.
 * Source and divider change one at a time. */
static void leave_fast_clocks(void) {
    const uint32_t master = PMC->MCKR;
    if ((master & PMC_MCKR_CSS) != PMC_MCKR_CSS_MAIN_CLK) {
        (void)set_master(PMC_MCKR_CSS_MAIN_CLK, master & PMC_MCKR_PRES);
        (void)set_master(PMC_MCKR_CSS_MAIN_CLK, PMC_MCKR_PRES_CLK_1);
    }
    const uint32_t with_rc = PMC->CKGR_MOR | CKGR_MOR_KEY_PASSWD | CKGR_MOR_MOSCRCEN;
    if ((with_rc & CKGR_MOR_MOSCSEL) != 0) {
        (void)set_main(with_rc, PMC_SR_MOSCRCS);
        (void)set_main(with_rc & ~CKGR_MOR_MOSCSEL, PMC_SR_MOSCSELS);
    }
}

/* MOSCXTS only says that the time to start is over. The failure detector says whether it swings. */
static bool crystal_swings(void) {
    if (!set_main(RC_12_MHZ | CRYSTAL_ON, PMC_SR_MOSCXTS)) {
        return false;
    }
    PMC->CKGR_MOR = RC_12_MHZ | CRYSTAL_ON | CKGR_MOR_CFDEN;
    uint32_t failed = 0;
    for (uint32_t poll = 0; poll < FAILURE_DETECTOR_POLLS; poll++) {
        failed = PMC->SR & PMC_SR_CFDS;
    }
    return failed == 0;
}

/* The RC oscillator goes on running for the failure detector to fall back on. */
static bool crystal_select(void) {
    if (crystal_swings() &&
        set_main(RC_12_MHZ | CRYSTAL_ON | CKGR_MOR_CFDEN | CKGR_MOR_MOSCSEL, PMC_SR_MOSCSELS)) {
        return true;
    }
    (void)set_main(RC_12_MHZ, PMC_SR_MOSCSELS);
    return false;
}

static bool pll_select(void) {
    PMC->CKGR_PLLAR = CKGR_PLLAR_ONE | FIELD(CKGR_PLLAR_MULA, PLL_MULTIPLIER) |
                      FIELD(CKGR_PLLAR_PLLACOUNT, PLL_LOCK_COUNT) | FIELD(CKGR_PLLAR_DIVA, 1);
    if (wait_for(PMC_SR_LOCKA) && set_master(PMC_MCKR_CSS_MAIN_CLK, PMC_MCKR_PRES_CLK_2) &&
        set_master(PMC_MCKR_CSS_PLLA_CLK, PMC_MCKR_PRES_CLK_2)) {
        return true;
    }
    (void)set_master(PMC_MCKR_CSS_MAIN_CLK, PMC_MCKR_PRES_CLK_2);
    (void)set_master(PMC_MCKR_CSS_MAIN_CLK, PMC_MCKR_PRES_CLK_1);
    return false;
}

/* A crystal that dies later throws the core onto the RC oscillator with all dividers wrong: that is
 * a crash (vectors.c), and the next boot finds the crystal dead. */
static void watch_crystal(void) {
    (void)PMC->SR;
    PMC->IER = PMC_IER_CFDEV;
    interrupt_enable(ID_PMC, PRIORITY_CLOCK_FAILURE);
}

clock_tree_t clock_tree_init(void) {
    EFC0->FMR = FIELD(EFC_FMR_FWS, FLASH_WAIT_STATES);
    EFC1->FMR = FIELD(EFC_FMR_FWS, FLASH_WAIT_STATES);
    leave_fast_clocks();
    (void)wait_for(PMC_SR_MOSCRCS);
    (void)set_main(RC_12_MHZ, PMC_SR_MOSCRCS);
    const bool crystal = crystal_select();
    const bool fast = pll_select();
    if (crystal) {
        watch_crystal();
    }
    return (clock_tree_t){.mck_hz = fast ? FULL_SPEED_HZ : CRYSTAL_HZ, .exact = crystal && fast};
}

void clock_enable(uint32_t id) {
    if (id < 32u) {
        PMC->PCER0 = 1u << id;
    } else {
        PMC->PCER1 = 1u << (id - 32u);
    }
}
