/* All that the suite knows of the flash's interface. */
#ifndef CONFORMANCE_FLASH_ACCESS_H
#define CONFORMANCE_FLASH_ACCESS_H

#include "hal/hal.h"

#include <stdbool.h>
#include <stdint.h>

#define FLASH_PAGE_BYTES_MAX 256u

uint32_t flash_size(const hal_t *hal);

/* What is written at once. */
uint32_t flash_page_bytes(const hal_t *hal);

/* What is erased at once, a multiple of a page. */
uint32_t flash_unit_bytes(const hal_t *hal);

/* Longest time of flash_rewrite() that hal/include/hal allows. */
uint32_t flash_rewrite_max_us(const hal_t *hal);

/* Erases the unit at |offset| and writes its first page: one cycle of wear. */
bool flash_rewrite(hal_t *hal, uint32_t offset, const void *page);

/* flash_rewrite() where it must be refused: true when any part of it was accepted. */
bool flash_accepts(hal_t *hal, uint32_t offset, const void *page);

/* Leaves the unit at |offset| erased. */
bool flash_blank(hal_t *hal, uint32_t offset);

#endif
