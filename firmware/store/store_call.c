#include "store/store_call.h"

bool store_begin(store_t *store) {
    store->reads = 0;
    store->pages_failed = 0;
    return store->mounted;
}

/* littlefs visits the blocks of a folder more than once. */
static int note_block(void *context, lfs_block_t block) {
    store_usage_t *usage = context;
    const uint8_t bit = (uint8_t)(1u << block % 8u);
    if (block >= usage->blocks || (usage->seen[block / 8u] & bit) != 0u) {
        return LFS_ERR_OK;
    }
    usage->seen[block / 8u] |= bit;
    if (block < usage->data_blocks) {
        usage->data++;
    } else {
        usage->raw_taken |= (uint8_t)(1u << (block - usage->data_blocks));
    }
    return LFS_ERR_OK;
}

bool store_find_usage(store_t *store, store_usage_t *usage) {
    *usage = (store_usage_t){.blocks = store_blocks(store->hal),
                             .data_blocks = store_data_blocks(store->hal)};
    return store_begin(store) && lfs_fs_traverse(&store->lfs, note_block, usage) >= 0;
}

store_result_t store_result(int code) {
    if (code >= 0) {
        return STORE_OK;
    }
    switch (code) {
    case LFS_ERR_NOENT:
        return STORE_NOT_FOUND;
    case LFS_ERR_NOSPC:
    case LFS_ERR_NAMETOOLONG: /* littlefs's word for no space for a new name; lengths are checked */
        return STORE_NO_SPACE;
    case LFS_ERR_CORRUPT:
        return STORE_CORRUPT;
    case LFS_ERR_EXIST:
    case LFS_ERR_NOTDIR:
    case LFS_ERR_ISDIR:
    case LFS_ERR_NOTEMPTY:
    case LFS_ERR_INVAL:
    case LFS_ERR_FBIG:
        return STORE_BAD_ARGUMENT;
    default:
        return STORE_IO;
    }
}

/* littlefs tries every free block and then says there is no space. That is so when more blocks are
 * free than any one call may write, or no more than pages failed. */
static bool pages_refused(store_t *store) {
    if (store->pages_failed == 0) {
        return false;
    }
    const uint32_t free_blocks = store_free_bytes(store) / store_block_bytes(store->hal);
    return free_blocks >= STORE_RESERVE_BLOCKS || store->pages_failed >= free_blocks;
}

bool store_take_damage(store_t *store) {
    const bool hurt = store->hurt;
    store->hurt = false;
    return hurt;
}

store_result_t store_written(store_t *store, int code) {
    store_result_t result = store_result(code);
    if (result == STORE_NO_SPACE || result == STORE_CORRUPT || result == STORE_IO) {
        store->failures++;
    }
    if (result == STORE_NO_SPACE) { /* littlefs keeps the page it had begun and stumbles over it */
        store->lfs.pcache.block = (lfs_block_t)-1;
        result = pages_refused(store) ? STORE_IO : STORE_NO_SPACE;
    }
    store->hurt = store->hurt || result == STORE_CORRUPT || result == STORE_IO;
    return result;
}

int store_open_short(store_t *store, lfs_file_t *file, struct lfs_file_config *config,
                     const char *path, int flags) {
    config->buffer = store->file_cache;
    return lfs_file_opencfg(&store->lfs, file, path, flags, config);
}

/* Number of a file's last block. Block n begins with as many pointers as n has factors of two, and
 * one more; block 0 with none. */
static uint32_t last_block(uint32_t size_bytes, uint32_t block_bytes) {
    uint32_t number = 0;
    for (uint32_t room = block_bytes; room < size_bytes && number < STORE_BLOCKS_MAX;) {
        number++;
        room += block_bytes - 4u * ((uint32_t)__builtin_ctz(number) + 1u);
    }
    return number;
}

bool store_is_linked(store_t *store, const char *path) {
    lfs_file_t file;
    struct lfs_file_config config = {0};
    if (store_open_short(store, &file, &config, path, LFS_O_RDONLY) < 0) {
        return true;
    }
    lfs_block_t block = file.ctz.head;
    const bool in_folder = (file.flags & LFS_F_INLINE) != 0;
    uint32_t number = in_folder ? 0 : last_block(file.ctz.size, store_block_bytes(store->hal));
    (void)lfs_file_close(&store->lfs, &file);
    while (number > 0 && block < store->lfs.block_count) {
        lfs_block_t before[2];
        const uint32_t step = 2u - number % 2u;
        if (store->config.read(&store->config, block, 0, before, step * sizeof before[0]) < 0) {
            return true;
        }
        block = before[step - 1u];
        number -= step;
    }
    return in_folder || block < store->lfs.block_count;
}

bool store_find_free(store_t *store, uint32_t *bytes) {
    store_usage_t usage;
    const bool found = store_find_usage(store, &usage);
    *bytes = found ? (usage.data_blocks - usage.data) * store_block_bytes(store->hal) : 0;
    return found;
}

uint32_t store_free_bytes(store_t *store) {
    uint32_t bytes = 0;
    (void)store_find_free(store, &bytes);
    return bytes;
}
