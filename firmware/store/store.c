#include "store/store.h"

#include "base/crc.h"
#include "store/blockdev.h"
#include "store/bytes.h"

#include <string.h>

#define FOLDER_TRIALS "/trials"
#define FOLDER_IN "/in"
#define CRC_PIECE_BYTES 128u
#define DOT_ENTRIES 2u        /* "." and ".." come first in each folder */
#define GENERATION_TYPE 0x47u /* the attribute of a file that holds its generation */
#define TRIAL_SUFFIX ".ulg"
#define TRIAL_DIGITS_MIN 4u
#define TRIAL_DIGITS_MAX 10u

/* In store_t.raw_taken: littlefs cannot see which blocks are in use. */
#define RAW_NOT_SEEN UINT8_MAX

/* What is read wrong while the supply comes up must not cost a filesystem. */
#define MOUNT_TRIES 3u

static bool path_fits(const char *path, size_t room) { return memchr(path, '\0', room) != NULL; }

static bool ends_with(const char *name, const char *suffix) {
    const size_t name_length = strlen(name);
    const size_t suffix_length = strlen(suffix);
    return name_length > suffix_length && strcmp(name + name_length - suffix_length, suffix) == 0;
}

static void join_path(char out[STORE_PATH_BYTES], const char *folder, const char *name) {
    const size_t folder_length = strcmp(folder, "/") == 0 ? 0 : strlen(folder);
    memcpy(out, folder, folder_length);
    out[folder_length] = '/';
    strcpy(out + folder_length + 1, name);
}

/* A trial's file has its header from its first sync on; until then there is but its name. */
static bool is_leftover(const char *folder, const store_entry_t *entry) {
    const bool unsynced = entry->size_bytes == 0 && strcmp(folder, FOLDER_TRIALS) == 0;
    return !entry->directory && (unsynced || ends_with(entry->name, STORE_NEW_SUFFIX));
}

typedef struct {
    store_t *store;
    const char *folder;
    char path[STORE_PATH_BYTES]; /* of the first leftover; empty: none yet */
} leftover_t;

/* A flipped bit in a file's pointers hides which blocks are free: without that file the store can
 * be written again. */
static bool hides_blocks(store_t *store, const char *path) {
    return store->raw_taken == RAW_NOT_SEEN && !store_is_linked(store, path);
}

static bool note_leftover(void *context, const store_entry_t *entry) {
    leftover_t *leftover = context;
    const char *folder = leftover->folder;
    if (strlen(folder) + 1u + strlen(entry->name) >= STORE_PATH_BYTES) {
        return true;
    }
    join_path(leftover->path, folder, entry->name);
    if (is_leftover(folder, entry) || hides_blocks(leftover->store, leftover->path)) {
        return false;
    }
    leftover->path[0] = '\0';
    return true;
}

/* Removes one leftover of |folder|; true when there was one. */
static bool remove_leftover(store_t *store, const char *folder) {
    leftover_t leftover = {.store = store, .folder = folder};
    (void)store_walk(store, folder, 0, note_leftover, &leftover);
    return leftover.path[0] != '\0' && store_remove(store, leftover.path) == STORE_OK;
}

static store_result_t make_folder(store_t *store, const char *path) {
    const int code = lfs_mkdir(&store->lfs, path);
    return code == LFS_ERR_EXIST ? STORE_OK : store_written(store, code);
}

/* littlefs hands out the raw blocks no more, unless an earlier firmware left files in them: then
 * they stay readable, and blockdev.c refuses to program them. */
static void reserve_raw(store_t *store) {
    lfs_t *lfs = &store->lfs;
    store_usage_t usage;
    store->config.compact_thresh = blockdev_compact_bytes(store->hal);
    store->raw_taken = store_find_usage(store, &usage) ? usage.raw_taken : RAW_NOT_SEEN;
    if (store->raw_taken == 0) {
        lfs->block_count = store_data_blocks(store->hal);
        lfs->lookahead.start %= lfs->block_count;
        lfs->lookahead.next = lfs->lookahead.size = 0;
        lfs->lookahead.ckpoint = (lfs_block_t)lfs->block_count;
    }
}

store_result_t store_finish(store_t *store) {
    static const char *const folders[] = {"/", FOLDER_IN, FOLDER_TRIALS};
    store_result_t result = store_written(store, lfs_fs_mkconsistent(&store->lfs));
    if (result == STORE_OK) {
        result = make_folder(store, FOLDER_IN);
    }
    if (result == STORE_OK) {
        result = make_folder(store, FOLDER_TRIALS);
    }
    memset(store->keep, 0, sizeof store->keep);
    for (size_t f = 0; f < sizeof folders / sizeof folders[0]; f++) {
        for (uint32_t i = 0; i < STORE_BLOCKS_MAX && remove_leftover(store, folders[f]); i++) {
        }
    }
    if (store->raw_taken == RAW_NOT_SEEN) {
        reserve_raw(store);
    }
    return store->mounted ? result : STORE_IO;
}

static bool is_power_of_two(uint32_t value) { return value != 0 && (value & (value - 1u)) == 0; }

/* A page is programmed in whole units, and a block erased in whole units. */
store_result_t store_fits(const hal_t *hal) {
    const hal_flash_geometry_t *flash = hal_flash_geometry(hal);
    if (!is_power_of_two(flash->program_bytes) || !is_power_of_two(flash->erase_bytes) ||
        flash->program_bytes > STORE_PAGE_BYTES || flash->erase_bytes < flash->program_bytes) {
        return STORE_BAD_GEOMETRY;
    }
    return store_blocks(hal) < STORE_BLOCKS_MIN ? STORE_TOO_SMALL : STORE_OK;
}

store_result_t store_renew(store_t *store, hal_t *hal, const uint8_t *keep) {
    memset(store, 0, sizeof *store);
    blockdev_configure(store, hal);
    if (keep != NULL) {
        memcpy(store->keep, keep, sizeof store->keep);
    }
    int code = lfs_format(&store->lfs, &store->config);
    if (code == LFS_ERR_OK) {
        code = lfs_mount(&store->lfs, &store->config);
    }
    store->mounted = store->formatted = code == LFS_ERR_OK;
    if (store->mounted) {
        reserve_raw(store);
    }
    return store_written(store, code);
}

/* The commit that wavers was left out (blockdev.c). Its folder goes to a block that stays as it
 * is, before anything else is written: found the next time, the commit would name blocks that hold
 * other things by then. */
static void settle_wavering(store_t *store, int mounted) {
    if (store_erases_first(store->hal) && store->wavers && mounted == LFS_ERR_OK) {
        (void)lfs_fs_gc(&store->lfs);
    }
}

store_result_t store_find(store_t *store, hal_t *hal) {
    const store_result_t fits = store_fits(hal);
    if (fits != STORE_OK) {
        memset(store, 0, sizeof *store);
        store->hal = hal;
        return fits;
    }
    int code = LFS_ERR_CORRUPT;
    for (uint32_t i = 0; i < MOUNT_TRIES && code == LFS_ERR_CORRUPT; i++) {
        memset(store, 0, sizeof *store);
        blockdev_configure(store, hal);
        code = lfs_mount(&store->lfs, &store->config);
    }
    settle_wavering(store, code);
    store->mounted = code == LFS_ERR_OK;
    struct lfs_info info;
    if (store->mounted && lfs_stat(&store->lfs, FOLDER_TRIALS, &info) == LFS_ERR_NOENT) {
        store_unmount(store);
        code = LFS_ERR_CORRUPT;
    }
    if (store->mounted) {
        reserve_raw(store);
    }
    return store_result(code);
}

store_result_t store_format(store_t *store, hal_t *hal) {
    const store_result_t renewed = store_renew(store, hal, NULL);
    return renewed == STORE_OK ? store_finish(store) : renewed;
}

store_result_t store_mount(store_t *store, hal_t *hal) {
    const store_result_t found = store_find(store, hal);
    if (found == STORE_CORRUPT) {
        return store_format(store, hal);
    }
    return found == STORE_OK ? store_finish(store) : found;
}

void store_unmount(store_t *store) {
    if (store->mounted) {
        (void)lfs_unmount(&store->lfs);
        store->mounted = false;
    }
}

/* What a file is opened with that carries |generation|, in the byte order of its records. */
static struct lfs_file_config marked(struct lfs_attr *mark, uint8_t generation[4]) {
    *mark = (struct lfs_attr){.type = GENERATION_TYPE, .buffer = generation, .size = 4};
    return (struct lfs_file_config){.attrs = mark, .attr_count = 1};
}

static int write_whole(store_t *store, const char *path, const void *bytes, size_t length,
                       uint32_t generation) {
    lfs_file_t file;
    struct lfs_attr mark;
    uint8_t mark_bytes[4];
    struct lfs_file_config config = {0};
    if (generation != 0) {
        (void)bytes_put_u32(mark_bytes, generation);
        config = marked(&mark, mark_bytes);
    }
    const int opened =
        store_open_short(store, &file, &config, path, LFS_O_WRONLY | LFS_O_CREAT | LFS_O_TRUNC);
    if (opened < 0) {
        return opened;
    }
    const lfs_ssize_t written = lfs_file_write(&store->lfs, &file, bytes, (lfs_size_t)length);
    const int closed = lfs_file_close(&store->lfs, &file);
    return written < 0 ? (int)written : closed;
}

store_result_t store_replace(store_t *store, const char *path, const void *bytes, size_t length) {
    return store_replace_marked(store, path, bytes, length, 0);
}

/* littlefs commits a file that was there already as a whole, when it is closed: old or new. A new
 * one is there, empty, before that, and needs another name meanwhile. */
store_result_t store_replace_marked(store_t *store, const char *path, const void *bytes,
                                    size_t length, uint32_t generation) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    if (!path_fits(path, STORE_PATH_BYTES - STORE_NEW_SUFFIX_BYTES)) {
        return STORE_BAD_ARGUMENT;
    }
    char fresh[STORE_PATH_BYTES];
    struct lfs_info info;
    const bool there = generation != 0 && lfs_stat(&store->lfs, path, &info) >= 0;
    strcpy(fresh, path);
    strcat(fresh, there ? "" : STORE_NEW_SUFFIX);
    int code = write_whole(store, fresh, bytes, length, generation);
    if (code >= 0) {
        store_lose_reader(store, path);
        code = there ? code : lfs_rename(&store->lfs, fresh, path);
    }
    if (code < 0 && !there) {
        (void)lfs_remove(&store->lfs, fresh);
    }
    return store_written(store, code);
}

store_result_t store_load(store_t *store, const char *path, void *out, size_t length) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    lfs_file_t file;
    struct lfs_file_config config = {0};
    const int opened = store_open_short(store, &file, &config, path, LFS_O_RDONLY);
    if (opened < 0) {
        return store_result(opened);
    }
    store_result_t result = STORE_CORRUPT;
    if ((size_t)lfs_file_size(&store->lfs, &file) == length) {
        const lfs_ssize_t got = lfs_file_read(&store->lfs, &file, out, (lfs_size_t)length);
        result = got < 0                 ? store_result((int)got)
                 : (size_t)got == length ? STORE_OK
                                         : STORE_CORRUPT;
    }
    (void)lfs_file_close(&store->lfs, &file);
    return result;
}

store_result_t store_generation(store_t *store, const char *path, uint32_t *generation) {
    *generation = 0;
    if (!store_begin(store)) {
        return STORE_IO;
    }
    lfs_file_t file;
    struct lfs_attr mark;
    uint8_t mark_bytes[4] = {0};
    struct lfs_file_config config = marked(&mark, mark_bytes);
    const int opened = store_open_short(store, &file, &config, path, LFS_O_RDONLY);
    if (opened >= 0) {
        *generation = bytes_get_u32(mark_bytes);
        (void)lfs_file_close(&store->lfs, &file);
    }
    return store_result(opened);
}

store_result_t store_size(store_t *store, const char *path, uint32_t *size_bytes) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    struct lfs_info info;
    const int code = lfs_stat(&store->lfs, path, &info);
    if (code < 0) {
        return store_result(code);
    }
    if (info.type != LFS_TYPE_REG) {
        return STORE_BAD_ARGUMENT;
    }
    *size_bytes = info.size;
    return STORE_OK;
}

store_result_t store_remove(store_t *store, const char *path) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    store_lose_reader(store, path);
    return store_written(store, lfs_remove(&store->lfs, path));
}

store_result_t store_crc32(store_t *store, const char *path, uint32_t *crc) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    lfs_file_t file;
    struct lfs_file_config config = {0};
    const int opened = store_open_short(store, &file, &config, path, LFS_O_RDONLY);
    if (opened < 0) {
        return store_result(opened);
    }
    uint32_t sum = 0;
    lfs_ssize_t got = 0;
    const lfs_soff_t size = lfs_file_size(&store->lfs, &file);
    for (lfs_soff_t done = 0; done < size && got >= 0; done += (lfs_soff_t)CRC_PIECE_BYTES) {
        uint8_t piece[CRC_PIECE_BYTES];
        got = lfs_file_read(&store->lfs, &file, piece, sizeof piece);
        sum = got > 0 ? crc32_update(sum, piece, (size_t)got) : sum;
    }
    (void)lfs_file_close(&store->lfs, &file);
    if (got < 0) {
        return store_result((int)got);
    }
    *crc = sum;
    return STORE_OK;
}

static void fill_entry(const struct lfs_info *info, store_entry_t *entry) {
    const size_t length = strlen(info->name);
    memset(entry, 0, sizeof *entry);
    memcpy(entry->name, info->name, length < STORE_PATH_BYTES ? length : STORE_PATH_BYTES - 1u);
    entry->directory = info->type == LFS_TYPE_DIR;
    entry->size_bytes = entry->directory ? 0 : info->size;
}

store_result_t store_walk(store_t *store, const char *folder, uint32_t first, store_visit_t visit,
                          void *context) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    if (first > STORE_BYTES_MAX) {
        return STORE_OK;
    }
    lfs_dir_t dir;
    const int opened = lfs_dir_open(&store->lfs, &dir, folder);
    if (opened < 0) {
        return store_result(opened);
    }
    store_entry_t entry;
    struct lfs_info info;
    int more = lfs_dir_seek(&store->lfs, &dir, first + DOT_ENTRIES);
    if (more == LFS_ERR_INVAL) { /* past the end */
        more = 0;
    } else if (more == LFS_ERR_OK) {
        more = lfs_dir_read(&store->lfs, &dir, &info);
    }
    while (more > 0) {
        fill_entry(&info, &entry);
        more = visit(context, &entry) ? lfs_dir_read(&store->lfs, &dir, &info) : 0;
    }
    (void)lfs_dir_close(&store->lfs, &dir);
    return more < 0 ? store_result(more) : STORE_OK;
}

static bool take_entry(void *context, const store_entry_t *entry) {
    *(store_entry_t *)context = *entry;
    return false;
}

store_result_t store_entry(store_t *store, const char *folder, uint32_t index,
                           store_entry_t *entry) {
    entry->name[0] = '\0';
    const store_result_t result = store_walk(store, folder, index, take_entry, entry);
    return result == STORE_OK && entry->name[0] == '\0' ? STORE_NOT_FOUND : result;
}

bool store_raw_taken(const store_t *store, uint32_t block) {
    return (store->raw_taken & 1u << (block - store_data_blocks(store->hal))) != 0u;
}

store_result_t store_rewrite_folders(store_t *store) {
    int code = store_begin(store) ? LFS_ERR_OK : LFS_ERR_IO;
    store->config.compact_thresh = 1; /* every block of a folder is fuller than that */
    for (uint32_t i = 0; i < 2u && code >= 0; i++) {
        code = lfs_fs_gc(&store->lfs);
    }
    store->config.compact_thresh = blockdev_compact_bytes(store->hal);
    return store_written(store, code);
}

/* "0042.ulg" -> 42. */
static bool trial_number(const char *name, uint32_t *number) {
    uint64_t value = 0;
    size_t digits = 0;
    while (digits <= TRIAL_DIGITS_MAX && name[digits] >= '0' && name[digits] <= '9') {
        value = value * 10u + (uint64_t)(name[digits] - '0');
        digits++;
    }
    if (digits < TRIAL_DIGITS_MIN || digits > TRIAL_DIGITS_MAX || value > UINT32_MAX ||
        strcmp(name + digits, TRIAL_SUFFIX) != 0) {
        return false;
    }
    *number = (uint32_t)value;
    return true;
}

/* What a walk through the trials looks for. */
typedef struct {
    uint32_t keep, oldest, newest;
    bool found;
    char name[STORE_PATH_BYTES]; /* of the oldest */
} trial_span_t;

static bool note_trial(void *context, const store_entry_t *entry) {
    trial_span_t *span = context;
    uint32_t number = 0;
    if (entry->directory || !trial_number(entry->name, &number)) {
        return true;
    }
    span->newest = number > span->newest ? number : span->newest;
    if (number != span->keep && (!span->found || number < span->oldest)) {
        span->found = true;
        span->oldest = number;
        strcpy(span->name, entry->name);
    }
    return true;
}

static store_result_t remove_oldest_trial(store_t *store, uint32_t keep_trial) {
    trial_span_t span = {.keep = keep_trial};
    char path[STORE_PATH_BYTES];
    (void)store_walk(store, FOLDER_TRIALS, 0, note_trial, &span);
    if (!span.found) {
        return STORE_NO_SPACE;
    }
    join_path(path, FOLDER_TRIALS, span.name);
    return store_remove(store, path);
}

uint32_t store_newest_trial(store_t *store) {
    trial_span_t span = {0};
    (void)store_walk(store, FOLDER_TRIALS, 0, note_trial, &span);
    return span.newest;
}

store_result_t store_make_space_step(store_t *store, uint32_t bytes, uint32_t keep_trial,
                                     bool *done) {
    *done = false;
    if (!store_begin(store)) {
        return STORE_IO;
    }
    if (bytes > STORE_BYTES_MAX) {
        return STORE_NO_SPACE;
    }
    uint32_t free_bytes = 0;
    if (!store_find_free(store, &free_bytes)) {
        return STORE_IO; /* a log is damaged: taking others away would free nothing */
    }
    if (free_bytes < bytes + STORE_RESERVE_BLOCKS * store_block_bytes(store->hal)) {
        return remove_oldest_trial(store, keep_trial);
    }
    *done = true;
    return store_written(store, lfs_fs_gc(&store->lfs));
}

store_result_t store_make_space(store_t *store, uint32_t bytes, uint32_t keep_trial) {
    store_result_t result = STORE_OK;
    bool done = false;
    for (uint32_t i = 0; i <= 2u * STORE_BLOCKS_MAX && result == STORE_OK && !done; i++) {
        result = store_make_space_step(store, bytes, keep_trial, &done);
    }
    return result != STORE_OK || done ? result : STORE_NO_SPACE;
}
