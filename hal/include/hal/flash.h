/*
 * The storage flash: bytes that last without power, in units that are erased and units that are
 * programmed. How large these are, and how long both take, differs from chip to chip: the store
 * asks for it (hal_flash_geometry).
 *
 * Two kinds of chip fulfil this:
 *   - erase first: an erased byte reads 0xFF, and programming only clears bits. A program unit is
 *     programmed once after each erase of its erase unit (NOR flash, with or without ECC).
 *   - programming erases: a program unit takes any content at any time (bank 1 of the SAM3X8E,
 *     whose pages are erased and written in one operation).
 *
 * After a power cut, what was being erased or programmed may hold anything, and may read otherwise
 * each time. All else stays as it was.
 *
 * Main loop only. The calls block for as long as the chip works; interrupts go on. A board whose
 * erase may outlast its watchdog feeds it meanwhile. The store erases nothing while a trial is open
 * (store/erase_ahead.h).
 */
#ifndef HAL_FLASH_H
#define HAL_FLASH_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

/* The same at every call. Sizes are powers of two, but for |size_bytes|: a multiple of the others.
 */
typedef struct {
    uint32_t size_bytes;
    uint32_t erase_bytes;   /* what one erase clears; where programming erases: |program_bytes| */
    uint32_t program_bytes; /* what one call programs */
    bool program_erases;    /* there is no separate erase */
    uint32_t erase_typical_us, erase_max_us; /* 0 where programming erases */
    uint32_t program_max_us;                 /* one that fails may take three times as long */
} hal_flash_geometry_t;

/* Never NULL; the struct is constant. A board that has one flash for ever may define the function
 * inline, in a header that its build names: then nothing is compiled that its flash does not need.
 */
#ifdef HAL_FLASH_GEOMETRY_HEADER
#include HAL_FLASH_GEOMETRY_HEADER
#else
const hal_flash_geometry_t *hal_flash_geometry(const hal_t *hal);
#endif

/* Copies |length| bytes at |offset| into |out|. False when out of range or the flash hangs. */
bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length);

/* Erases one erase unit; |offset| is a multiple of its size. False when it does not read erased
 * afterwards, |offset| is bad, or the supply is too low to begin. Where programming erases there is
 * nothing to do: true, and the content stays. */
bool hal_flash_erase(hal_t *hal, uint32_t offset);

/* Programs one whole program unit; |offset| is a multiple of its size. False when it does not read
 * back as |bytes|, |offset| is bad, or the supply is too low to begin. Programs also what reads so
 * already: it may have been cut short, and waver. A chip that erases first is never asked to
 * program a unit twice without an erase between. */
bool hal_flash_program(hal_t *hal, uint32_t offset, const void *bytes);

#endif
