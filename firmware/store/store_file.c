#include "store/store_file.h"

#include "base/panic.h"
#include "store/store_call.h"

#include <string.h>

store_result_t store_open(store_t *store, store_file_t *file, const char *path, store_mode_t mode) {
    static const int flags[] = {[STORE_READ] = LFS_O_RDONLY,
                                [STORE_WRITE_NEW] = LFS_O_RDWR | LFS_O_CREAT | LFS_O_TRUNC,
                                [STORE_APPEND] = LFS_O_RDWR};
    memset(file, 0, sizeof *file);
    if (!store_begin(store)) {
        return STORE_IO;
    }
    if (memchr(path, '\0', STORE_PATH_BYTES) == NULL) {
        return STORE_BAD_ARGUMENT;
    }
    file->config.buffer = file->cache;
    const int code = lfs_file_opencfg(&store->lfs, &file->file, path, flags[mode], &file->config);
    file->open = code == LFS_ERR_OK;
    if (file->open && mode == STORE_READ) {
        REQUIRE(store->reader == NULL);
        store->reader = file;
        strcpy(store->reader_path, path);
    }
    return mode == STORE_READ ? store_result(code) : store_written(store, code);
}

void store_lose_reader(store_t *store, const char *path) {
    if (store->reader != NULL && strcmp(store->reader_path, path) == 0) {
        store->reader->gone = true;
    }
}

store_result_t store_read_at(store_t *store, store_file_t *file, uint32_t offset, void *out,
                             size_t max, size_t *got) {
    REQUIRE(file->open);
    (void)store_begin(store);
    *got = 0;
    if (file->gone) {
        return STORE_NOT_FOUND;
    }
    if (offset >= store_file_size(store, file)) {
        return STORE_OK;
    }
    const lfs_soff_t sought =
        lfs_file_seek(&store->lfs, &file->file, (lfs_soff_t)offset, LFS_SEEK_SET);
    if (sought < 0) {
        return store_result((int)sought);
    }
    const lfs_ssize_t read = lfs_file_read(&store->lfs, &file->file, out, (lfs_size_t)max);
    if (read < 0) {
        return store_result((int)read);
    }
    *got = (size_t)read;
    return STORE_OK;
}

static store_result_t write_from(store_t *store, store_file_t *file, lfs_soff_t offset, int whence,
                                 const void *bytes, size_t length) {
    const lfs_soff_t sought = lfs_file_seek(&store->lfs, &file->file, offset, whence);
    if (sought < 0) {
        return store_written(store, (int)sought);
    }
    const lfs_ssize_t written = lfs_file_write(&store->lfs, &file->file, bytes, (lfs_size_t)length);
    return store_written(store, (int)written);
}

/* Looked at where a block begins: the look walks the filesystem. */
static bool leaves_own_blocks(store_t *store, uint32_t offset, size_t length) {
    const uint32_t block = store_block_bytes(store->hal);
    const uint32_t in_block = offset % block;
    return (in_block != 0 && in_block + length <= block) ||
           store_free_bytes(store) > STORE_OWN_BLOCKS * block;
}

store_result_t store_write_at(store_t *store, store_file_t *file, uint32_t offset,
                              const void *bytes, size_t length) {
    REQUIRE(file->open);
    (void)store_begin(store);
    if (offset > STORE_BYTES_MAX || length > STORE_BYTES_MAX) {
        return STORE_BAD_ARGUMENT;
    }
    if (!leaves_own_blocks(store, offset, length)) {
        return STORE_NO_SPACE;
    }
    return write_from(store, file, (lfs_soff_t)offset, LFS_SEEK_SET, bytes, length);
}

store_result_t store_append(store_t *store, store_file_t *file, const void *bytes, size_t length) {
    REQUIRE(file->open);
    (void)store_begin(store);
    return write_from(store, file, 0, LFS_SEEK_END, bytes, length);
}

store_result_t store_sync(store_t *store, store_file_t *file) {
    REQUIRE(file->open);
    (void)store_begin(store);
    return store_written(store, lfs_file_sync(&store->lfs, &file->file));
}

uint32_t store_file_size(store_t *store, store_file_t *file) {
    REQUIRE(file->open);
    (void)store_begin(store);
    const lfs_soff_t size = lfs_file_size(&store->lfs, &file->file);
    return size < 0 ? 0 : (uint32_t)size;
}

store_result_t store_close(store_t *store, store_file_t *file) {
    REQUIRE(file->open);
    (void)store_begin(store);
    file->open = false;
    if (store->reader == file) {
        store->reader = NULL;
    }
    return store_written(store, lfs_file_close(&store->lfs, &file->file));
}
