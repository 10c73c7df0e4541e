/* The fish's storage flash, for hal/flash.h: bank 1 of the SAM3X8E. A page takes about 5 ms. */
#ifndef SAM3X8E_STORAGE_GEOMETRY_H
#define SAM3X8E_STORAGE_GEOMETRY_H

#define STORAGE_BYTES (256u * 1024u)
#define STORAGE_PAGE_BYTES 256u
#define STORAGE_LIMIT_US 30000u /* six times what a page takes */

static inline const hal_flash_geometry_t *hal_flash_geometry(const hal_t *hal) {
    static const hal_flash_geometry_t geometry = {
        .size_bytes = STORAGE_BYTES,
        .erase_bytes = STORAGE_PAGE_BYTES,
        .program_bytes = STORAGE_PAGE_BYTES,
        .program_erases = true,
        .program_max_us = STORAGE_LIMIT_US / 3u,
    };
    (void)hal;
    return &geometry;
}

#endif
