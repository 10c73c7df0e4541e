/* The power cut at every page write of a boot, in every way a page can be left. */
#ifndef BOOT_CUTS_H
#define BOOT_CUTS_H

#include "app_fixture.h"
#include "flash_model.h"

/* Whether the power went during the boot. */
static inline bool boot_is_cut(void) {
    if (setjmp(flash_model_off) != 0) {
        return true;
    }
    reboot();
    return false;
}

/* Boots from |whole| with each cut, boots again and calls |check|. Returns the number of cuts. */
static inline uint32_t cut_every_write_of_a_boot(const uint8_t whole[MOCK_FLASH_BYTES],
                                                 void (*check)(void)) {
    static flash_model_t model;
    uint32_t cuts = 0;
    bool cut = true;
    for (uint32_t n = 1; cut; n++) {
        for (unsigned kind = 0; kind < CUT_KINDS; kind++) {
            mock_flash_load(&hal, whole, n == 1u && kind == 0);
            flash_model_attach(&model, &hal, n * CUT_KINDS + kind);
            model.cut_in = n;
            model.cut_kind = (cut_kind_t)kind;
            cut = boot_is_cut();
            model.cut_in = 0;
            cuts += cut;
            reboot();
            check();
        }
    }
    return cuts;
}

#endif
