/*
 * Files on the board: littlefs over the storage flash.
 *
 * Owns the mounted filesystem and all its buffers. One instance per board, no heap. Every replace
 * is one commit: after a cut at any instant the old or the new content is there. Main loop only; a
 * call that writes may take up to 100 ms on hardware.
 */
#ifndef STORE_STORE_H
#define STORE_STORE_H

#include "hal/flash.h"
#include "lfs.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A block of the store is 2048 bytes, or an erase unit of the flash where that is larger. There are
 * as many as fit, at most STORE_BLOCKS_MAX: of a larger flash the first part is used. The maximum
 * keeps block numbers in a byte. */
#define STORE_BLOCK_MIN_BYTES 2048u
#define STORE_BLOCKS_MAX 255u
#define STORE_BLOCK_SET_BYTES ((STORE_BLOCKS_MAX + 7u) / 8u) /* a bit for each block */
/* What is written at once, in one or more program units of the flash. */
#define STORE_PAGE_BYTES 256u
/* The superblock counts all blocks, as earlier firmware wrote it (littlefs mounts no other count),
 * but the last STORE_RAW_BLOCKS are never handed out: they are raw pages (witness.h). */
#define STORE_RAW_BLOCKS 5u
#define STORE_CACHE_BYTES STORE_PAGE_BYTES
#define STORE_LOOKAHEAD_BYTES STORE_BLOCK_SET_BYTES
#define STORE_PATH_BYTES 40u /* longest path, with its final zero; 4 less for store_replace */

/* Blocks that store_make_space keeps free beyond what it is asked for: learned input, pending trial
 * and the filesystem's own blocks must find room after a trial filled all the rest. */
#define STORE_RESERVE_BLOCKS 10u

/* Fewer blocks are refused: the raw ones, 8 of folders and superblocks, 13 of records, those kept
 * free, and STORE_TRIAL_BLOCKS of a trial of 40 beats that is logged on a flash which erases first:
 * 6 of data, one for each sync of its 76 s, and what its folder may take (store/erase_ahead.h). */
#define STORE_TRIAL_BLOCKS 44u
#define STORE_BLOCKS_MIN (STORE_RAW_BLOCKS + 8u + 13u + STORE_RESERVE_BLOCKS + STORE_TRIAL_BLOCKS)

typedef enum {
    STORE_OK = 0,
    STORE_NOT_FOUND = 1,
    STORE_NO_SPACE = 2,
    STORE_CORRUPT = 3, /* content does not match its own length or CRC */
    STORE_IO = 4,      /* flash or filesystem failure */
    STORE_BAD_ARGUMENT = 5,
    STORE_TOO_SMALL = 6,   /* the flash has fewer than STORE_BLOCKS_MIN blocks */
    STORE_BAD_GEOMETRY = 7 /* units of sizes that no store can be made of */
} store_result_t;

/* An open file; the caller owns it and must not move it while open. */
typedef struct {
    lfs_file_t file;
    struct lfs_file_config config;
    uint8_t cache[STORE_CACHE_BYTES];
    bool open;
    bool gone; /* removed or replaced since it was opened for reading: its blocks hold other things
                */
} store_file_t;

typedef struct {
    lfs_t lfs;
    struct lfs_config config;
    hal_t *hal;
    uint8_t read_cache[STORE_CACHE_BYTES];
    uint8_t program_cache[STORE_CACHE_BYTES];
    uint8_t lookahead[STORE_LOOKAHEAD_BYTES];
    uint8_t file_cache[STORE_CACHE_BYTES]; /* for the short-lived files of this module */
    uint8_t keep[STORE_BLOCK_SET_BYTES];   /* blocks not to be written; see store_renew */
    uint8_t blank[STORE_BLOCK_SET_BYTES];  /* erased since the mount, and not programmed since */
    bool erase_forbidden;                  /* store/erase_ahead.h */
    uint32_t erases_refused;               /* for that, since the mount */
    bool wavers;                           /* what the mount read did not stay the same */
    bool mounted;
    store_file_t *reader; /* open for reading; NULL = none */
    char reader_path[STORE_PATH_BYTES];
    bool formatted;        /* this boot found no filesystem and made one */
    uint32_t generation;   /* of the newest witness; store/witness.h */
    uint8_t raw_taken;     /* raw blocks that hold files of an earlier firmware, one bit each */
    uint32_t failures;     /* writes that failed since boot */
    uint16_t pages_failed; /* that did not take their data, in the call that is on */
    bool hurt;             /* see store_take_damage */
    uint32_t reads;        /* of the flash, in the call that is on */
    uint32_t fed_reads;    /* since the mount, as far as they feed the watchdog */
} store_t;

typedef struct {
    char name[STORE_PATH_BYTES];
    uint32_t size_bytes;
    bool directory;
} store_entry_t;

/* The blocks of a store on |hal|'s flash, raw ones included, and their size. */
static inline uint32_t store_block_bytes(const hal_t *hal) {
    const uint32_t erase_bytes = hal_flash_geometry(hal)->erase_bytes;
    return erase_bytes > STORE_BLOCK_MIN_BYTES ? erase_bytes : STORE_BLOCK_MIN_BYTES;
}

static inline uint32_t store_blocks(const hal_t *hal) {
    const uint32_t fit = hal_flash_geometry(hal)->size_bytes / store_block_bytes(hal);
    return fit < STORE_BLOCKS_MAX ? fit : STORE_BLOCKS_MAX;
}

/* Whether blocks must be erased before they are programmed: where not, all that has to do with it
 * does nothing. */
static inline bool store_erases_first(const hal_t *hal) {
    return !hal_flash_geometry(hal)->program_erases;
}

/* Those that littlefs hands out. */
static inline uint32_t store_data_blocks(const hal_t *hal) {
    return store_blocks(hal) - STORE_RAW_BLOCKS;
}

typedef enum { STORE_READ = 0, STORE_WRITE_NEW = 1, STORE_APPEND = 2 } store_mode_t;

/* STORE_OK when a store can be made of |hal|'s flash, else STORE_TOO_SMALL or STORE_BAD_GEOMETRY.
 */
store_result_t store_fits(const hal_t *hal);

/* Mounting, in steps, for a caller who wants to save what lies in the blocks before they are used
 * anew. |store| must not move while mounted. Every other call answers STORE_IO while not mounted.
 *
 * store_find mounts the filesystem that is there, once store_fits. STORE_CORRUPT: there is none,
 * one that lacks a folder (littlefs mounts only when every folder is readable), or one whose making
 * a cut ended.
 *
 * store_renew makes an empty one and mounts it. Blocks whose bit (b % 8 of byte b / 8) is set in
 * |keep| (NULL: none; 0 and 1 cannot be kept) are not written before store_finish: until then the
 * filesystem counts as unfinished, and whoever finds it after a cut may save them again.
 *
 * store_finish makes /trials and /in and removes what a cut left behind: halves of a store_replace
 * and trial files without content. A flash that is full or cannot be written stays mounted, so that
 * the trials on it can be read. */
store_result_t store_find(store_t *store, hal_t *hal);
store_result_t store_renew(store_t *store, hal_t *hal, const uint8_t *keep);
store_result_t store_finish(store_t *store);

/* All of it; saves nothing. */
store_result_t store_mount(store_t *store, hal_t *hal);

/* Erases all files and mounts the empty filesystem. */
store_result_t store_format(store_t *store, hal_t *hal);

/* Whether a write failed since the last question for another reason than a full store: pages did
 * not take their data, or the filesystem is damaged. One bad page is no failure: littlefs writes
 * the data elsewhere. */
bool store_take_damage(store_t *store);

/* All files must be closed. */
void store_unmount(store_t *store);

/* Replaces |path| with the given bytes, atomically. */
store_result_t store_replace(store_t *store, const char *path, const void *bytes, size_t length);

/* The same with a generation, which the file carries from then on: store/critical.h. */
store_result_t store_replace_marked(store_t *store, const char *path, const void *bytes,
                                    size_t length, uint32_t generation);

/* The generation that |path| carries; 0 when it has none. */
store_result_t store_generation(store_t *store, const char *path, uint32_t *generation);

/* Whether files lay in |block|, one of the raw blocks, when the store was mounted. Since then they
 * can only have left. */
bool store_raw_taken(const store_t *store, uint32_t block);

/* Writes the blocks of all folders anew, both of each pair: what they held before is gone. */
store_result_t store_rewrite_folders(store_t *store);

/* Reads the whole of |path|: STORE_CORRUPT unless its length is exactly |length|. */
store_result_t store_load(store_t *store, const char *path, void *out, size_t length);

store_result_t store_size(store_t *store, const char *path, uint32_t *size_bytes);
store_result_t store_remove(store_t *store, const char *path);

/* CRC-32 (base/crc.h) over the whole file. */
store_result_t store_crc32(store_t *store, const char *path, uint32_t *crc);

/* STORE_READ and STORE_APPEND need the file to be there; STORE_WRITE_NEW empties it. What is
 * written counts from the next store_sync or store_close on. A file that was opened must be closed,
 * also after a failed write. One file at a time is open for reading; when it is removed or replaced
 * meanwhile it has no bytes any more (STORE_NOT_FOUND). */
store_result_t store_open(store_t *store, store_file_t *file, const char *path, store_mode_t mode);
store_result_t store_read_at(store_t *store, store_file_t *file, uint32_t offset, void *out,
                             size_t max, size_t *got);
store_result_t store_write_at(store_t *store, store_file_t *file, uint32_t offset,
                              const void *bytes, size_t length);
store_result_t store_append(store_t *store, store_file_t *file, const void *bytes, size_t length);
store_result_t store_sync(store_t *store, store_file_t *file);
uint32_t store_file_size(store_t *store, store_file_t *file);
store_result_t store_close(store_t *store, store_file_t *file);

/* Called for one entry; false ends the walk. */
typedef bool (*store_visit_t)(void *context, const store_entry_t *entry);

/* Visits the entries of a folder from number |first| on ("." and ".." are not counted). Looking for
 * an entry costs as much as a walk to it: walk once. |visit| must not write. */
store_result_t store_walk(store_t *store, const char *folder, uint32_t first, store_visit_t visit,
                          void *context);

/* Entry number |index| alone. STORE_NOT_FOUND past the end. */
store_result_t store_entry(store_t *store, const char *folder, uint32_t index,
                           store_entry_t *entry);

/* The highest number of a file in /trials; 0 when there is none. */
uint32_t store_newest_trial(store_t *store);

/* Free bytes in whole blocks. Walks the filesystem. */
uint32_t store_free_bytes(store_t *store);

/* Removes the oldest files of /trials (lowest number first), never |keep_trial|, until |bytes| and
 * the reserve are free, then compacts, so that the trial itself need not. STORE_NO_SPACE when there
 * is nothing left to remove. One step removes one file, or compacts and sets |*done|; all of them
 * may take seconds on hardware: not while swimming. */
store_result_t store_make_space_step(store_t *store, uint32_t bytes, uint32_t keep_trial,
                                     bool *done);
store_result_t store_make_space(store_t *store, uint32_t bytes, uint32_t keep_trial);

#endif
