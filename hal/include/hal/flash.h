/*
 * The storage flash (bank 1 of the SAM3X8E): an array of pages that are erased and written in one
 * operation, as the chip does. There is no separate erase.
 */
#ifndef HAL_FLASH_H
#define HAL_FLASH_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

#define HAL_FLASH_PAGE_BYTES 256u
#define HAL_FLASH_SIZE_BYTES (256u * 1024u)

/* Copies |length| bytes at |offset| into |out|. False when out of range or the flash hangs. */
bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length);

/* Erases and writes one whole page; |offset| is a multiple of the page size. Blocks for up to 10 ms
 * on hardware, 30 ms when it fails. False when the page does not read back as written, |offset| is
 * bad, or the supply is too low to begin. */
bool hal_flash_write_page(hal_t *hal, uint32_t offset, const void *page);

#endif
