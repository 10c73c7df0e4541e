#include "store/blockdev.h"

#include "hal/system.h"

#include <string.h>

#define READ_BYTES 16u
#define READS 8u /* of each piece while mounting: a bit that wavers is missed once in 256 */

/* Folders move to other blocks after so many compactions. A trial costs the root folder's blocks
 * ten times what it costs the average page; with 20 the busiest page sees a fifth more than the p99
 * (tests/unit/test_wear.c) for 0.3 % more writes, and the root leaves the superblocks' pair, which
 * littlefs cannot replace, before that has worn. */
#define BLOCK_CYCLES 20
/* Before a trial every metadata block more than half full is compacted, so that fewer compactions
 * fall into the swim. */
#define COMPACT_PART 2u

/* What a folder uses of a large block at most. Reading a folder, and the more so compacting it,
 * takes long when it is full of old commits. */
#define FOLDER_MAX_BYTES 4096u

/* No file lives inside a folder's metadata: a record in a block of its own outlives the root
 * folder, which shares its pair of blocks with the superblock, and can be found again by its first
 * bytes. */
#define INLINE_NONE ((lfs_size_t)-1)

/* Reads in one call of the store. Metadata that is damaged where its CRC does not tell can be a
 * ring, which littlefs walks for ever: such a store is given up, at once and for all calls to come,
 * before the watchdog bites. On a sound filesystem 3000 random calls read 28 000 times at most; one
 * filled to the brim with files of a block each needs 37 600. */
#define READS_MAX 60000u
#define READS_MAX_BLOCKS 128u /* of such a store; with more blocks they grow as the square */

/* The store is mounted and looked through before the main loop feeds the watchdog. Hence a feed
 * every FEED_READS reads: 0.3 s on the slowest clock (12 MHz), 0.05 s on the usual one. Feeding
 * ends some reads after the mount, so that a board that reads for ever is restarted.
 */
#define FEED_READS 256u
#define FED_READS_MAX 4u /* times as many as one call may read */

static uint32_t flash_offset(const store_t *store, lfs_block_t block, lfs_off_t offset) {
    return block * store_block_bytes(store->hal) + offset;
}

bool blockdev_is_blank(const store_t *store, uint32_t block) {
    return (store->blank[block / 8u] & 1u << block % 8u) != 0u;
}

static void set_blank(store_t *store, uint32_t block, bool blank) {
    const uint8_t bit = (uint8_t)(1u << block % 8u);
    uint8_t *const eight = &store->blank[block / 8u];
    *eight = (uint8_t)(blank ? *eight | bit : *eight & ~bit);
}

static bool erase_units(const store_t *store, uint32_t block) {
    const uint32_t unit = hal_flash_geometry(store->hal)->erase_bytes;
    for (uint32_t done = 0; done < store_block_bytes(store->hal); done += unit) {
        if (!hal_flash_erase(store->hal, flash_offset(store, block, done))) {
            return false;
        }
    }
    return true;
}

bool blockdev_erase(store_t *store, uint32_t block) {
    if (!store_erases_first(store->hal) || blockdev_is_blank(store, block)) {
        return true;
    }
    if (store->erase_forbidden) {
        store->erases_refused++;
        return false;
    }
    const bool erased = erase_units(store, block);
    set_blank(store, block, erased);
    return erased;
}

bool blockdev_program(store_t *store, uint32_t offset, const uint8_t *page) {
    const uint32_t unit = hal_flash_geometry(store->hal)->program_bytes;
    if (store_erases_first(store->hal)) {
        set_blank(store, offset / store_block_bytes(store->hal), false);
    }
    for (uint32_t done = 0; done < STORE_PAGE_BYTES; done += unit) {
        if (!hal_flash_program(store->hal, offset + done, page + done)) {
            return false;
        }
    }
    return true;
}

/* Whether what was read at |at| reads otherwise now; |*where| it does so first. */
static bool wavers(hal_t *hal, uint32_t at, const uint8_t *read, uint32_t length, uint32_t *where) {
    uint8_t again[READ_BYTES];
    for (uint32_t done = 0; done < READS * length; done += READ_BYTES) {
        const uint32_t in_read = done % length;
        if (hal_flash_read(hal, at + in_read, again, READ_BYTES) &&
            memcmp(again, read + in_read, READ_BYTES) != 0) {
            *where = at + in_read;
            return true;
        }
    }
    return false;
}

/* A cut in the midst of a page write may leave bits that read now so, now so: littlefs would see a
 * commit, build on it, and not see it the next time. It is the page of a commit that nobody was
 * told of, so either will do; a commit never shares a page with another. Where programming erases,
 * every such page that the mount looks at is made to stay as it was read. */
static void refresh_page(store_t *store, uint32_t at) {
    uint8_t *const page = store->file_cache; /* no file is open yet */
    const uint32_t begin = at - at % STORE_PAGE_BYTES;
    if (hal_flash_read(store->hal, begin, page, STORE_PAGE_BYTES)) {
        (void)blockdev_program(store, begin, page);
    }
}

/* A page cannot be written again where its block must be erased first: there what was read of it
 * becomes zeros, so that the commit is left out, and store_find moves its folder. */
static void blot_wavering(store_t *store, uint32_t at, uint8_t *read, uint32_t length) {
    uint32_t where = 0;
    for (uint32_t done = 0, part = 0; done < length; done += part) {
        const uint32_t in_page = STORE_PAGE_BYTES - (at + done) % STORE_PAGE_BYTES;
        part = in_page < length - done ? in_page : length - done;
        if (wavers(store->hal, at + done, read + done, part, &where)) {
            memset(read + done, 0, part);
            store->wavers = true;
        }
    }
}

static uint32_t reads_max(const store_t *store) {
    const uint32_t blocks = store_blocks(store->hal);
    return READS_MAX * blocks / READS_MAX_BLOCKS * blocks / READS_MAX_BLOCKS;
}

static void feed_watchdog(store_t *store, uint32_t most) {
    if (store->fed_reads < FED_READS_MAX * most && ++store->fed_reads % FEED_READS == 0) {
        hal_watchdog_feed(store->hal);
    }
}

static int read_block(const struct lfs_config *config, lfs_block_t block, lfs_off_t offset,
                      void *out, lfs_size_t length) {
    store_t *store = config->context;
    const uint32_t at = flash_offset(store, block, offset);
    const uint32_t most = reads_max(store);
    if (store->reads >= most) {
        store->mounted = false;
        return LFS_ERR_IO;
    }
    store->reads++;
    feed_watchdog(store, most);
    if (!hal_flash_read(store->hal, at, out, length)) {
        return LFS_ERR_IO;
    }
    if (store->mounted) {
        return LFS_ERR_OK;
    }
    uint32_t where = at;
    if (store_erases_first(store->hal)) {
        blot_wavering(store, at, out, length);
    } else if (wavers(store->hal, at, out, length, &where)) {
        refresh_page(store, where);
        return hal_flash_read(store->hal, at, out, length) ? LFS_ERR_OK : LFS_ERR_IO;
    }
    return LFS_ERR_OK;
}

static bool may_write(const store_t *store, lfs_block_t block) {
    return block < store_data_blocks(store->hal) &&
           (store->keep[block / 8u] & 1u << block % 8u) == 0u;
}

/* A page that does not take its data makes littlefs put the data into another block; so do the raw
 * blocks, which are not its own. */
static int program_block(const struct lfs_config *config, lfs_block_t block, lfs_off_t offset,
                         const void *bytes, lfs_size_t length) {
    store_t *store = config->context;
    const uint8_t *page = bytes;
    if (!may_write(store, block)) {
        return LFS_ERR_CORRUPT;
    }
    for (lfs_size_t done = 0; done < length; done += STORE_PAGE_BYTES) {
        if (!blockdev_program(store, flash_offset(store, block, offset + done), page + done)) {
            store->pages_failed++;
            return LFS_ERR_CORRUPT;
        }
    }
    return LFS_ERR_OK;
}

/* Where programming erases there is nothing to do: littlefs leaves open what an erased block holds.
 * Elsewhere a block that cannot be erased is a bad one, and littlefs takes another. */
static int erase_block(const struct lfs_config *config, lfs_block_t block) {
    store_t *store = config->context;
    if (!store_erases_first(store->hal)) {
        return LFS_ERR_OK;
    }
    if (!may_write(store, block)) {
        return LFS_ERR_CORRUPT;
    }
    const bool erased = blockdev_erase(store, block);
    if (!erased && !store->erase_forbidden) {
        store->pages_failed++;
    }
    return erased ? LFS_ERR_OK : LFS_ERR_CORRUPT;
}

static int sync_device(const struct lfs_config *config) {
    (void)config;
    return LFS_ERR_OK;
}

static lfs_size_t folder_bytes(const hal_t *hal) {
    const uint32_t block_bytes = store_block_bytes(hal);
    return block_bytes < FOLDER_MAX_BYTES ? block_bytes : FOLDER_MAX_BYTES;
}

lfs_size_t blockdev_compact_bytes(const hal_t *hal) { return folder_bytes(hal) / COMPACT_PART; }

void blockdev_configure(store_t *store, hal_t *hal) {
    const uint32_t block_bytes = store_block_bytes(hal);
    store->hal = hal;
    store->config = (struct lfs_config){.context = store,
                                        .read = read_block,
                                        .prog = program_block,
                                        .erase = erase_block,
                                        .sync = sync_device,
                                        .read_size = READ_BYTES,
                                        .prog_size = STORE_PAGE_BYTES,
                                        .block_size = block_bytes,
                                        .block_count = store_blocks(hal),
                                        .block_cycles = BLOCK_CYCLES,
                                        .cache_size = STORE_CACHE_BYTES,
                                        .lookahead_size = STORE_LOOKAHEAD_BYTES,
                                        .compact_thresh = block_bytes / COMPACT_PART,
                                        .metadata_max = folder_bytes(hal),
                                        .inline_max = INLINE_NONE,
                                        .read_buffer = store->read_cache,
                                        .prog_buffer = store->program_cache,
                                        .lookahead_buffer = store->lookahead};
}
