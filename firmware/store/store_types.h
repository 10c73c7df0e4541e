/* The store's structs, and what it is made of on the board's flash; its functions are in store.h.
 */
#ifndef STORE_STORE_TYPES_H
#define STORE_STORE_TYPES_H

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
#define STORE_OWN_BLOCKS 4u /* of these, for what the board itself must store */

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

#endif
