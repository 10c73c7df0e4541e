#include "store/blockdev.h"

#include "store/bytes.h"

#define READ_BYTES 16
/* Metadata blocks move on after so many erasures: the chip promises 10 000 per page. */
#define BLOCK_CYCLES 500
/* Before a trial every metadata block more than half full is compacted, so that fewer compactions
 * fall into the swim. */
#define COMPACT_BYTES (STORE_BLOCK_BYTES / 2u)

#define SUPERBLOCKS 2u
#define MAGIC "littlefs"
#define MAGIC_OFFSET 8u
#define MAGIC_BYTES 8u
#define TAG_BYTES 4u
#define TAG_INVALID 0x80000000u
#define TAG_KIND 0x78000000u
#define TAG_KIND_CRC 0x50000000u
#define TAG_LENGTH 0x3FFu
#define TAG_LENGTH_DELETED 0x3FFu

static uint32_t flash_offset(lfs_block_t block, lfs_off_t offset) {
    return block * STORE_BLOCK_BYTES + offset;
}

static int read_block(const struct lfs_config *config, lfs_block_t block, lfs_off_t offset,
                      void *out, lfs_size_t length) {
    hal_t *hal = config->context;
    return hal_flash_read(hal, flash_offset(block, offset), out, length) ? LFS_ERR_OK : LFS_ERR_IO;
}

/* A page that does not take its data makes littlefs put the data into another block. */
static int program_block(const struct lfs_config *config, lfs_block_t block, lfs_off_t offset,
                         const void *bytes, lfs_size_t length) {
    hal_t *hal = config->context;
    const uint8_t *page = bytes;
    for (lfs_size_t done = 0; done < length; done += HAL_FLASH_PAGE_BYTES) {
        if (!hal_flash_write_page(hal, flash_offset(block, offset + done), page + done)) {
            return LFS_ERR_CORRUPT;
        }
    }
    return LFS_ERR_OK;
}

/* A page write erases the page itself, and littlefs leaves open what an erased block holds. */
static int erase_block(const struct lfs_config *config, lfs_block_t block) {
    (void)config;
    (void)block;
    return LFS_ERR_OK;
}

static int sync_device(const struct lfs_config *config) {
    (void)config;
    return LFS_ERR_OK;
}

void blockdev_configure(store_t *store, hal_t *hal) {
    store->hal = hal;
    store->config = (struct lfs_config){.context = hal,
                                        .read = read_block,
                                        .prog = program_block,
                                        .erase = erase_block,
                                        .sync = sync_device,
                                        .read_size = READ_BYTES,
                                        .prog_size = HAL_FLASH_PAGE_BYTES,
                                        .block_size = STORE_BLOCK_BYTES,
                                        .block_count = STORE_BLOCKS,
                                        .block_cycles = BLOCK_CYCLES,
                                        .cache_size = STORE_CACHE_BYTES,
                                        .lookahead_size = STORE_LOOKAHEAD_BYTES,
                                        .compact_thresh = COMPACT_BYTES,
                                        .read_buffer = store->read_cache,
                                        .prog_buffer = store->program_cache,
                                        .lookahead_buffer = store->lookahead};
}

static uint32_t get_big_endian(const uint8_t *at) {
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

/* CRC of |length| bytes of flash; |*last| receives the last four of them. */
static uint32_t crc_flash(hal_t *hal, uint32_t crc, uint32_t offset, uint32_t length,
                          uint8_t last[TAG_BYTES]) {
    for (uint32_t done = 0; done < length; done += TAG_BYTES) {
        const uint32_t piece = length - done < TAG_BYTES ? length - done : TAG_BYTES;
        (void)hal_flash_read(hal, offset + done, last, piece);
        crc = lfs_crc(crc, last, piece);
    }
    return crc;
}

/* Walks the tags of a block's first commit up to its CRC (littlefs SPEC.md, "Metadata blocks"). */
static bool first_commit_valid(hal_t *hal, uint32_t base) {
    uint8_t bytes[TAG_BYTES] = {0};
    uint32_t tag = 0xFFFFFFFFu;
    uint32_t crc = crc_flash(hal, 0xFFFFFFFFu, base, TAG_BYTES, bytes); /* revision count */
    uint32_t offset = TAG_BYTES;
    while (offset + 2u * TAG_BYTES <= STORE_BLOCK_BYTES) {
        crc = crc_flash(hal, crc, base + offset, TAG_BYTES, bytes);
        tag ^= get_big_endian(bytes);
        offset += TAG_BYTES;
        if ((tag & TAG_INVALID) != 0u) {
            return false;
        }
        if ((tag & TAG_KIND) == TAG_KIND_CRC) {
            return hal_flash_read(hal, base + offset, bytes, TAG_BYTES) &&
                   crc == bytes_get_u32(bytes);
        }
        const uint32_t length = (tag & TAG_LENGTH) == TAG_LENGTH_DELETED ? 0u : tag & TAG_LENGTH;
        if (length > STORE_BLOCK_BYTES - offset) {
            return false;
        }
        crc = crc_flash(hal, crc, base + offset, length, bytes);
        offset += length;
    }
    return false;
}

bool blockdev_superblock_readable(hal_t *hal) {
    for (uint32_t block = 0; block < SUPERBLOCKS; block++) {
        uint8_t magic[MAGIC_BYTES];
        if (hal_flash_read(hal, flash_offset(block, MAGIC_OFFSET), magic, sizeof magic) &&
            memcmp(magic, MAGIC, MAGIC_BYTES) == 0 &&
            first_commit_valid(hal, flash_offset(block, 0))) {
            return true;
        }
    }
    return false;
}
