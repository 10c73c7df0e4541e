/* The SPI NOR flash on SPI0: Spansion S25FL128S, 16 MiB. */
#ifndef SMARTFUSION2_NOR_H
#define SMARTFUSION2_NOR_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

#define NOR_BYTES (16u * 1024u * 1024u)
#define NOR_SECTOR_BYTES (64u * 1024u)
#define NOR_PAGE_BYTES 256u

/* All of these: false when the flash is not there, or not ready within its time. */

bool nor_read(hal_t *hal, uint32_t offset, uint8_t *out, uint32_t length);

/* |offset| is a multiple of the sector. 0.65 s at most, by the data sheet. */
bool nor_erase(hal_t *hal, uint32_t offset);

/* One erased page; |offset| is a multiple of it. 0.75 ms at most, by the data sheet. */
bool nor_program(hal_t *hal, uint32_t offset, const uint8_t *page);

#endif
