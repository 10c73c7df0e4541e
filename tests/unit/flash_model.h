/*
 * The storage flash as hardware (MOCK_FLASH, mock_hal.h): each page write and each erase is counted
 * and takes its time, the power may go in the midst of one, and pages or erase units wear out.
 *
 * A cut is a world that forks: |before_write| is called with the flash as it is, and
 * flash_model_cut() makes of another board's copy of it what the cut leaves. The first world goes
 * on to its next write. RAM does not outlive a cut, so the flash is all that the second one has.
 * Inside a forked world cut_in makes the power go for good: flash_model_off jumps.
 */
#ifndef FLASH_MODEL_H
#define FLASH_MODEL_H

#include "mock_hal.h"
#include "store_size.h"

#define FLASH_PAGES MOCK_FLASH_PAGES
#define FLASH_UNITS (MOCK_FLASH_BYTES / MOCK_FLASH_ERASE_BYTES)
#define FLASH_UNSTABLE_BYTES MOCK_FLASH_ERASE_BYTES
#define FLASH_QUADWORD_BYTES 16u /* what the chip programs at a time */

/* What the page under way holds after the cut, where programming erases. Where it does not, the
 * page was erased before: all blank is one of these; half erased means half programmed everywhere.
 * An erase that is cut leaves the whole unit as it was; erased; partly erased; partly or all zero,
 * as such chips begin with that; with some bits up; or with bits that come up or not at each read.
 */
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
    uint32_t writes, erases; /* since flash_model_attach */
    uint64_t busy_us;        /* erases at their typical time, writes at their longest */
    uint32_t page_writes[FLASH_PAGES];
    uint32_t unit_erases[FLASH_UNITS];
    /* |page| NULL: the unit at |offset| is erased. */
    void (*before_write)(void *context, uint32_t offset, const uint8_t *page);
    void *context;
    uint32_t cut_in; /* the power goes in the n-th write or erase from now; 0 = it stays */
    cut_kind_t cut_kind;
    uint32_t endurance; /* writes a page, or erases a unit, takes before bits stay wrong; 0 = any */
    uint32_t worn;      /* writes or erases that failed for that */
    uint32_t random;
    uint32_t unstable_at; /* offset; FLASH_STABLE = none */
    uint8_t unstable[FLASH_UNSTABLE_BYTES];
} flash_model_t;

#define FLASH_STABLE UINT32_MAX

extern jmp_buf flash_model_off;

/* Clears |model| and gives |hal|'s flash its life. The content stays. */
void flash_model_attach(flash_model_t *model, hal_t *hal, uint32_t seed);

/* Makes |hal|'s flash what |kind| of cut leaves when |page| was being written at |offset|, or,
 * NULL, the unit there was being erased. */
void flash_model_cut(flash_model_t *model, hal_t *hal, cut_kind_t kind, uint32_t offset,
                     const uint8_t *page);

/* One bit of the page at |offset| comes down or goes up for good. */
void flash_model_rot(flash_model_t *model, hal_t *hal, uint32_t offset);

/* 0 .. limit - 1, from the model's own generator. */
uint32_t flash_model_random(flash_model_t *model, uint32_t limit);

#endif
