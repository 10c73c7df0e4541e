/*
 * Logs of trials as the ULog they are, packed or not (packed.h; earlier firmware did not pack).
 * Main loop only.
 */
#ifndef STORE_LOG_READER_H
#define STORE_LOG_READER_H

#include "store/store.h"
#include "store/unpacker.h"

typedef struct {
    bool packed;
    uint32_t ulog_bytes;
} log_info_t;

store_result_t log_info(store_t *store, const char *path, log_info_t *info);

/* Reads an open file. */
typedef struct {
    store_t *store;
    store_file_t *file;
    uint32_t size; /* bytes that can be read: of the ULog when unpacking, else of the file */
    bool unpacks;
    unpacker_t unpacker;
} log_reader_t;

/* |file| is open for reading; it is unpacked if |info| says that it is packed. */
void log_reader_begin(log_reader_t *reader, store_t *store, store_file_t *file,
                      const log_info_t *info);

/* As store_read_at. */
store_result_t log_reader_read(log_reader_t *reader, uint32_t offset, void *out, size_t max,
                               size_t *got);

/* CRC-32 of the ULog that is packed at |path|, which may be another file than |reader| reads. That
 * takes its own up anew. */
store_result_t log_reader_crc32(log_reader_t *reader, store_t *store, const char *path,
                                uint32_t *crc);

#endif
