/* What every call of the store begins and ends with. But for the last two only its own files use
 * it. Main loop only. */
#ifndef STORE_STORE_CALL_H
#define STORE_STORE_CALL_H

#include "store/store_types.h"

/* More than any store has, and far from the end of 32 bits. */
#define STORE_BYTES_MAX 0x40000000u

#define STORE_NEW_SUFFIX ".new"
#define STORE_NEW_SUFFIX_BYTES 4u

/* Blocks in use. */
typedef struct {
    uint8_t seen[STORE_BLOCK_SET_BYTES];
    uint32_t blocks, data_blocks; /* that there are */
    uint32_t data;                /* of the latter in use */
    uint8_t raw_taken;
} store_usage_t;

/* False when the filesystem cannot be walked: then nothing is free. */
bool store_find_usage(store_t *store, store_usage_t *usage);

/* Begins a call: counts its reads from 0. Whether the store is mounted. */
bool store_begin(store_t *store);

/* Opens a file that is closed within this call; they share one buffer. Returns littlefs's code. */
int store_open_short(store_t *store, lfs_file_t *file, struct lfs_file_config *config,
                     const char *path, int flags);

/* littlefs's code as ours. */
store_result_t store_result(int code);

/* The same for a call that wrote: counts failures. */
store_result_t store_written(store_t *store, int code);

/* Whether littlefs finds from a file's last block to its first, as it must to see which blocks are
 * free. True for what is no file, or cannot be read. */
bool store_is_linked(store_t *store, const char *path);

/* Free bytes in whole blocks, and whether the filesystem can be walked; 0 where it cannot. */
bool store_find_free(store_t *store, uint32_t *bytes);

/* The same bytes. */
uint32_t store_free_bytes(store_t *store);

/* Whether a write failed since the last question for another reason than a full store: pages did
 * not take their data, or the filesystem is damaged. One bad page is no failure: littlefs writes
 * the data elsewhere. */
bool store_take_damage(store_t *store);

#endif
