#include "store/log_reader.h"

#include "base/crc.h"
#include "store/store_call.h"

#define CRC_PIECE_BYTES 128u

/* A file that is open for one call. */
typedef struct {
    store_t *store;
    lfs_file_t file;
    struct lfs_file_config config;
} short_file_t;

static size_t read_short(void *context, uint32_t offset, uint8_t *out, size_t length) {
    short_file_t *const file = context;
    lfs_t *const lfs = &file->store->lfs;
    if (lfs_file_seek(lfs, &file->file, (lfs_soff_t)offset, LFS_SEEK_SET) < 0) {
        return 0;
    }
    const lfs_ssize_t got = lfs_file_read(lfs, &file->file, out, (lfs_size_t)length);
    return got < 0 ? 0 : (size_t)got;
}

static packed_file_t packed_file(short_file_t *file) {
    return (packed_file_t){.read = read_short,
                           .context = file,
                           .size = (uint32_t)lfs_file_size(&file->store->lfs, &file->file)};
}

static store_result_t open_file(store_t *store, short_file_t *file, const char *path) {
    if (!store_begin(store)) {
        return STORE_IO;
    }
    file->store = store;
    file->config = (struct lfs_file_config){0};
    return store_result(store_open_short(store, &file->file, &file->config, path, LFS_O_RDONLY));
}

static void close_file(short_file_t *file) { (void)lfs_file_close(&file->store->lfs, &file->file); }

store_result_t log_info(store_t *store, const char *path, log_info_t *info) {
    short_file_t file;
    const store_result_t opened = open_file(store, &file, path);
    if (opened != STORE_OK) {
        return opened;
    }
    const packed_file_t source = packed_file(&file);
    uint8_t header[PACKED_HEADER_BYTES];
    info->packed =
        read_short(&file, 0, header, sizeof header) == sizeof header && unpacker_knows(header);
    info->ulog_bytes = info->packed ? unpacker_size(&source) : source.size;
    close_file(&file);
    return STORE_OK;
}

static size_t read_open(void *context, uint32_t offset, uint8_t *out, size_t length) {
    const log_reader_t *const reader = context;
    size_t got = 0;
    (void)store_read_at(reader->store, reader->file, offset, out, length, &got);
    return got;
}

void log_reader_begin(log_reader_t *reader, store_t *store, store_file_t *file,
                      const log_info_t *info) {
    reader->store = store;
    reader->file = file;
    reader->size = store_file_size(store, file);
    reader->unpacks = info->packed;
    if (reader->unpacks) {
        const packed_file_t source = {read_open, reader, reader->size};
        unpacker_begin(&reader->unpacker, &source);
        reader->size = info->ulog_bytes;
    }
}

store_result_t log_reader_read(log_reader_t *reader, uint32_t offset, void *out, size_t max,
                               size_t *got) {
    if (!reader->unpacks || reader->file->gone) {
        return store_read_at(reader->store, reader->file, offset, out, max, got);
    }
    *got = unpacker_read(&reader->unpacker, offset, out, max);
    return STORE_OK;
}

static uint32_t unpacked_crc32(unpacker_t *unpacker) {
    uint8_t piece[CRC_PIECE_BYTES];
    uint32_t crc = 0;
    uint32_t offset = 0;
    size_t got = 0;
    do {
        got = unpacker_read(unpacker, offset, piece, sizeof piece);
        crc = crc32_update(crc, piece, got);
        offset += (uint32_t)got;
    } while (got > 0);
    return crc;
}

store_result_t log_reader_crc32(log_reader_t *reader, store_t *store, const char *path,
                                uint32_t *crc) {
    short_file_t file;
    const store_result_t opened = open_file(store, &file, path);
    if (opened == STORE_OK) {
        const packed_file_t session = reader->unpacker.file;
        const packed_file_t source = packed_file(&file);
        unpacker_begin(&reader->unpacker, &source);
        *crc = unpacked_crc32(&reader->unpacker);
        unpacker_begin(&reader->unpacker, &session);
        close_file(&file);
    }
    return opened;
}
