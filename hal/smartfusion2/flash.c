/* The storage in the first sectors of the NOR. */
#include "nor.h"

#include "board.h"

#include <string.h>

static uint8_t sector[NOR_SECTOR_BYTES];

bool hal_flash_read(hal_t *hal, uint32_t offset, void *out, uint32_t length) {
    if (offset > HAL_FLASH_SIZE_BYTES || length > HAL_FLASH_SIZE_BYTES - offset) {
        return false;
    }
    return nor_read(hal, offset, out, length);
}

static bool only_clears(const uint8_t *old, const uint8_t *page) {
    bool good = true;
    for (uint32_t i = 0; i < NOR_PAGE_BYTES; i++) {
        good = good && (old[i] & page[i]) == page[i];
    }
    return good;
}

static bool rewrite_sector(hal_t *hal, uint32_t start) {
    bool good = nor_erase(hal, start);
    for (uint32_t at = 0; at < NOR_SECTOR_BYTES; at += NOR_PAGE_BYTES) {
        good = good && nor_program(hal, start + at, sector + at);
    }
    return good;
}

bool hal_flash_write_page(hal_t *hal, uint32_t offset, const void *page) {
    if (offset % HAL_FLASH_PAGE_BYTES != 0 || offset >= HAL_FLASH_SIZE_BYTES) {
        return false;
    }
    const uint32_t start = offset - offset % NOR_SECTOR_BYTES;
    uint8_t *old = sector + (offset - start);
    bool good = nor_read(hal, offset, old, NOR_PAGE_BYTES);
    if (good && only_clears(old, page)) {
        good = nor_program(hal, offset, page);
    } else {
        good = good && nor_read(hal, start, sector, NOR_SECTOR_BYTES);
        memcpy(old, page, NOR_PAGE_BYTES);
        good = good && rewrite_sector(hal, start);
    }
    return good && nor_read(hal, offset, old, NOR_PAGE_BYTES) &&
           memcmp(old, page, NOR_PAGE_BYTES) == 0;
}
