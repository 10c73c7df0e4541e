/* littlefs over the storage flash: geometry and callbacks. Main loop only. */
#ifndef STORE_BLOCKDEV_H
#define STORE_BLOCKDEV_H

#include "store/store_types.h"

/* Fills |store|'s littlefs configuration; |store| must not move afterwards. */
void blockdev_configure(store_t *store, hal_t *hal);

/* A folder's block that is fuller than this is compacted before a trial. littlefs, when it mounts,
 * takes nothing below half a block for it; set it in the configuration afterwards. */
lfs_size_t blockdev_compact_bytes(const hal_t *hal);

/* Whether |block| has been erased since the mount and not been programmed since: what reads erased
 * may be what a cut left of an erase. */
bool blockdev_is_blank(const store_t *store, uint32_t block);

/* Erases |block| unless it is blank, or programming erases. False when it does not become blank, or
 * erases are forbidden (erase_ahead.h): then it is counted. */
bool blockdev_erase(store_t *store, uint32_t block);

/* Programs the page at |offset| of the flash, STORE_PAGE_BYTES. Its block is not blank any more. */
bool blockdev_program(store_t *store, uint32_t offset, const uint8_t *page);

#endif
