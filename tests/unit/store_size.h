/* The store on the mocked board's flash, as constants: store/store.h computes the same. */
#ifndef STORE_SIZE_H
#define STORE_SIZE_H

#include "mock_hal.h"
#include "store/store.h"

#define BLOCK_BYTES                                                                                \
    (MOCK_FLASH_ERASE_BYTES > STORE_BLOCK_MIN_BYTES ? MOCK_FLASH_ERASE_BYTES                       \
                                                    : STORE_BLOCK_MIN_BYTES)
#define BLOCKS_FIT (MOCK_FLASH_BYTES / BLOCK_BYTES)
#define BLOCKS (BLOCKS_FIT < STORE_BLOCKS_MAX ? BLOCKS_FIT : STORE_BLOCKS_MAX)
#define DATA_BLOCKS (BLOCKS - STORE_RAW_BLOCKS)
#define RESERVE_BYTES (STORE_RESERVE_BLOCKS * BLOCK_BYTES)

#endif
