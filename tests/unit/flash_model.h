/*
 * The storage flash as hardware: each page write is counted, the power may go in the midst of one,
 * and pages wear out.
 *
 * A cut is a world that forks: |before_write| is called with the flash as it is, and
 * flash_model_cut() makes of another board's copy of it what the cut leaves. The first world goes
 * on to its next write. RAM does not outlive a cut, so the flash is all that the second one has.
 * Inside a forked world cut_in makes the power go for good: flash_model_off jumps.
 */
#ifndef FLASH_MODEL_H
#define FLASH_MODEL_H

#include "mock_hal.h"

#define FLASH_PAGES (HAL_FLASH_SIZE_BYTES / HAL_FLASH_PAGE_BYTES)
#define FLASH_QUADWORD_BYTES 16u /* what the chip programs at a time */

/* What the page under way holds after the cut. */
typedef enum {
    CUT_UNTOUCHED,       /* old: the power went before the erase */
    CUT_ERASED,          /* all 0xFF */
    CUT_TORN_OVER_BLANK, /* some quadwords new, the rest 0xFF */
    CUT_TORN_OVER_OLD,   /* some quadwords new, the rest old */
    CUT_TORN_EARLY, /* the same, but only the first 20 bytes: a superblock's magic, not its CRC */
    CUT_HALF_QUADWORD, /* some new, one in which bits have not come down yet, the rest 0xFF */
    CUT_HALF_ERASED,   /* old, in which some bits have come up already */
    CUT_UNSTABLE,      /* new, but some bits come down or not each time they are read */
    CUT_WRITTEN,       /* all new: the power went before anybody knew */
    CUT_KINDS
} cut_kind_t;

typedef struct {
    uint32_t writes; /* since flash_model_attach */
    uint32_t page_writes[FLASH_PAGES];
    void (*before_write)(void *context, uint32_t offset, const uint8_t *page);
    void *context;
    uint32_t cut_in; /* the power goes in the n-th write from now; 0 = it stays */
    cut_kind_t cut_kind;
    uint32_t endurance; /* writes a page takes before bits of it stay wrong; 0 = any number */
    uint32_t worn;      /* writes that failed for that */
    uint32_t random;
    uint32_t unstable_page; /* offset; FLASH_STABLE = none */
    uint8_t unstable[HAL_FLASH_PAGE_BYTES];
} flash_model_t;

#define FLASH_STABLE UINT32_MAX

extern jmp_buf flash_model_off;

/* Clears |model| and gives |hal|'s flash its life. The content stays. */
void flash_model_attach(flash_model_t *model, hal_t *hal, uint32_t seed);

/* Makes |hal|'s flash what |kind| of cut leaves when |page| was being written at |offset|. */
void flash_model_cut(flash_model_t *model, hal_t *hal, cut_kind_t kind, uint32_t offset,
                     const uint8_t *page);

/* One bit of the page at |offset| comes down or goes up for good. */
void flash_model_rot(flash_model_t *model, hal_t *hal, uint32_t offset);

/* 0 .. limit - 1, from the model's own generator. */
uint32_t flash_model_random(flash_model_t *model, uint32_t limit);

#endif
