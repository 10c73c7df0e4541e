/* littlefs over the storage flash: geometry, callbacks, and the look at the superblock that decides
 * about formatting. Main loop only. */
#ifndef STORE_BLOCKDEV_H
#define STORE_BLOCKDEV_H

#include "store/store.h"

/* Fills |store|'s littlefs configuration; |store| must not move afterwards. */
void blockdev_configure(store_t *store, hal_t *hal);

/* Whether either superblock holds a first commit whose CRC is right: there was a filesystem. */
bool blockdev_superblock_readable(hal_t *hal);

#endif
