#include "flash_access.h"

#include "hal/flash.h"

#include <string.h>

uint32_t flash_size(const hal_t *hal) { return hal_flash_geometry(hal)->size_bytes; }

uint32_t flash_page_bytes(const hal_t *hal) { return hal_flash_geometry(hal)->program_bytes; }

uint32_t flash_unit_bytes(const hal_t *hal) { return hal_flash_geometry(hal)->erase_bytes; }

uint32_t flash_rewrite_max_us(const hal_t *hal) {
    const hal_flash_geometry_t *geometry = hal_flash_geometry(hal);
    return geometry->erase_max_us + geometry->program_max_us;
}

bool flash_rewrite(hal_t *hal, uint32_t offset, const void *page) {
    return hal_flash_erase(hal, offset) && hal_flash_program(hal, offset, page);
}

bool flash_accepts(hal_t *hal, uint32_t offset, const void *page) {
    const bool erased = hal_flash_erase(hal, offset);
    const bool programmed = hal_flash_program(hal, offset, page);
    return erased || programmed;
}

/* Where programming erases, the unit is one page. */
bool flash_blank(hal_t *hal, uint32_t offset) {
    uint8_t blank[FLASH_PAGE_BYTES_MAX];
    memset(blank, 0xFF, sizeof blank);
    return hal_flash_erase(hal, offset) &&
           (!hal_flash_geometry(hal)->program_erases || hal_flash_program(hal, offset, blank));
}
