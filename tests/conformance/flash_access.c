#include "flash_access.h"

#include "hal/flash.h"

#include <string.h>

#define REWRITE_MAX_US 10000u

_Static_assert(HAL_FLASH_PAGE_BYTES <= FLASH_PAGE_BYTES_MAX, "a page fits the suite's buffers");

uint32_t flash_size(const hal_t *hal) {
    (void)hal;
    return HAL_FLASH_SIZE_BYTES;
}

uint32_t flash_page_bytes(const hal_t *hal) {
    (void)hal;
    return HAL_FLASH_PAGE_BYTES;
}

uint32_t flash_unit_bytes(const hal_t *hal) {
    (void)hal;
    return HAL_FLASH_PAGE_BYTES;
}

uint32_t flash_rewrite_max_us(const hal_t *hal) {
    (void)hal;
    return REWRITE_MAX_US;
}

bool flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    return hal_flash_read(hal, offset, out, length);
}

bool flash_rewrite(hal_t *hal, uint32_t offset, const void *page) {
    return hal_flash_write_page(hal, offset, page);
}

bool flash_accepts(hal_t *hal, uint32_t offset, const void *page) {
    return flash_rewrite(hal, offset, page);
}

bool flash_blank(hal_t *hal, uint32_t offset) {
    uint8_t blank[HAL_FLASH_PAGE_BYTES];
    memset(blank, 0xFF, sizeof blank);
    return hal_flash_write_page(hal, offset, blank);
}
