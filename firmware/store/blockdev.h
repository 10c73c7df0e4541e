/* littlefs over the storage flash: geometry and callbacks. Main loop only. */
#ifndef STORE_BLOCKDEV_H
#define STORE_BLOCKDEV_H

#include "store/store.h"

/* Fills |store|'s littlefs configuration; |store| must not move afterwards. */
void blockdev_configure(store_t *store, hal_t *hal);

#endif
