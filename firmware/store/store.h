/*
 * Files on the board: littlefs over the storage flash.
 *
 * Owns the mounted filesystem and all its buffers. One instance per board, no heap. Every replace is
 * write-new, sync, rename: after a cut at any instant the old or the new content is there.
 * Main loop only; a call that writes may take up to 100 ms on hardware.
 */
#ifndef STORE_STORE_H
#define STORE_STORE_H

#include "hal/flash.h"
#include "lfs.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define STORE_BLOCK_BYTES 2048u
#define STORE_BLOCKS (HAL_FLASH_SIZE_BYTES / STORE_BLOCK_BYTES)
#define STORE_CACHE_BYTES 256u
#define STORE_LOOKAHEAD_BYTES 16u
#define STORE_PATH_BYTES 40u /* longest path, with its final zero */

typedef enum {
    STORE_OK = 0,
    STORE_NOT_FOUND = 1,
    STORE_NO_SPACE = 2,
    STORE_CORRUPT = 3, /* content does not match its own length or CRC */
    STORE_IO = 4,      /* flash or filesystem failure */
    STORE_BAD_ARGUMENT = 5
} store_result_t;

typedef struct {
    lfs_t lfs;
    struct lfs_config config;
    hal_t *hal;
    uint8_t read_cache[STORE_CACHE_BYTES];
    uint8_t program_cache[STORE_CACHE_BYTES];
    uint8_t lookahead[STORE_LOOKAHEAD_BYTES];
    uint8_t file_cache[STORE_CACHE_BYTES]; /* for the short-lived files of this module */
    bool mounted;
    bool formatted;    /* this boot found no filesystem and made one */
    uint32_t failures; /* writes that failed since boot */
} store_t;

/* An open file; the caller owns it and must not move it while open. */
typedef struct {
    lfs_file_t file;
    struct lfs_file_config config;
    uint8_t cache[STORE_CACHE_BYTES];
    bool open;
} store_file_t;

typedef struct {
    char name[STORE_PATH_BYTES];
    uint32_t size_bytes;
    bool directory;
} store_entry_t;

typedef enum { STORE_READ, STORE_WRITE_NEW, STORE_APPEND } store_mode_t;

/* Mounts; formats only when there is no filesystem to mount. Makes /trials and /in. */
store_result_t store_mount(store_t *store, hal_t *hal);
void store_unmount(store_t *store);

/* Replaces |path| with the given bytes, atomically. */
store_result_t store_replace(store_t *store, const char *path, const void *bytes, size_t length);

/* Reads the whole of |path|: its length must be exactly |length|. */
store_result_t store_load(store_t *store, const char *path, void *out, size_t length);

store_result_t store_size(store_t *store, const char *path, uint32_t *size_bytes);
store_result_t store_remove(store_t *store, const char *path);

/* CRC-32 (base/crc.h) over the whole file. */
store_result_t store_crc32(store_t *store, const char *path, uint32_t *crc);

store_result_t store_open(store_t *store, store_file_t *file, const char *path, store_mode_t mode);
store_result_t store_read_at(store_t *store, store_file_t *file, uint32_t offset, void *out,
                             size_t max, size_t *got);
store_result_t store_write_at(store_t *store, store_file_t *file, uint32_t offset,
                              const void *bytes, size_t length);
store_result_t store_append(store_t *store, store_file_t *file, const void *bytes, size_t length);
store_result_t store_sync(store_t *store, store_file_t *file);
uint32_t store_file_size(store_t *store, store_file_t *file);
store_result_t store_close(store_t *store, store_file_t *file);

/* Entry number |index| of a folder ("." and ".." are not counted). STORE_NOT_FOUND past the end. */
store_result_t store_entry(store_t *store, const char *folder, uint32_t index, store_entry_t *entry);

/* Free bytes in whole blocks. Walks the filesystem. */
uint32_t store_free_bytes(store_t *store);

/* Removes the oldest files of /trials, never |keep_trial|, until |bytes| are free, then compacts, so
 * that the trial itself need not. */
store_result_t store_make_space(store_t *store, uint32_t bytes, uint32_t keep_trial);

#endif
