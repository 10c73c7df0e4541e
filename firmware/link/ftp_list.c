#include "link/ftp_list.h"

#include "link/ftp_paths.h"
#include "store/log_reader.h"

#include <string.h>

#define ROOT_FOLDERS 2u
#define DECIMAL_BYTES 11u /* of a uint32_t, with its final zero */
#define ENTRY_BYTES (1u + STORE_PATH_BYTES + 1u + DECIMAL_BYTES)

/* One entry with its final zero. */
typedef struct {
    char text[ENTRY_BYTES];
    uint8_t length;
} line_t;

static void append(line_t *line, const char *text) {
    const size_t length = strlen(text);
    memcpy(line->text + line->length, text, length);
    line->length = (uint8_t)(line->length + length);
}

static void append_decimal(line_t *line, uint32_t value) {
    char digits[DECIMAL_BYTES];
    uint32_t at = DECIMAL_BYTES - 1;
    digits[at] = '\0';
    do {
        digits[--at] = (char)('0' + value % 10u);
        value /= 10u;
    } while (value != 0);
    append(line, digits + at);
}

static void file_line(line_t *line, const char *name, uint32_t size_bytes) {
    append(line, "F");
    append(line, name);
    append(line, "\t");
    append_decimal(line, size_bytes);
}

typedef struct {
    store_t *store;
    ftp_path_t folder;
    uint8_t *out; /* data of the reply */
    uint8_t used;
} listing_t;

/* Adds the line, with its final zero; false when it does not fit. */
static bool put(listing_t *listing, const line_t *line) {
    const uint8_t length = (uint8_t)(line->length + 1u);
    if (length > FTP_DATA_BYTES - listing->used) {
        return false;
    }
    memcpy(listing->out + listing->used, line->text, length);
    listing->used = (uint8_t)(listing->used + length);
    return true;
}

/* Of a log the length of its ULog; as it is stored when it cannot be read. */
static uint32_t size_of(const listing_t *listing, const store_entry_t *entry) {
    static const char folder[] = "/trials/";
    char path[sizeof folder + STORE_PATH_BYTES];
    log_info_t info;
    strcpy(path, folder);
    strcat(path, entry->name);
    const bool told =
        listing->folder == FTP_PATH_TRIALS && log_info(listing->store, path, &info) == STORE_OK;
    return told ? info.ulog_bytes : entry->size_bytes;
}

static bool put_entry(void *context, const store_entry_t *entry) {
    listing_t *listing = context;
    line_t line = {0};
    if (entry->directory || ftp_path_in_folder(listing->folder, entry->name) == FTP_PATH_HIDDEN) {
        append(&line, "S");
    } else {
        file_line(&line, entry->name, size_of(listing, entry));
    }
    return put(listing, &line);
}

/* Line number |*shown| of the root, unless it is one before |first|; false when it does not fit. */
static bool put_root_line(listing_t *listing, const line_t *line, uint32_t first, uint32_t *shown) {
    return (*shown)++ < first || put(listing, line);
}

/* The root shows its two folders and those records that exist. */
static void put_root(listing_t *listing, store_t *store, uint32_t first) {
    static const char *const folders[ROOT_FOLDERS] = {"Dtrials", "Din"};
    uint32_t shown = 0;
    bool fits = true;
    for (uint32_t i = 0; i < ROOT_FOLDERS && fits; i++) {
        line_t line = {0};
        append(&line, folders[i]);
        fits = put_root_line(listing, &line, first, &shown);
    }
    for (uint32_t i = 0; ftp_path_record(i) != NULL && fits; i++) {
        const char *path = ftp_path_record(i);
        uint32_t size_bytes = 0;
        if (store_size(store, path, &size_bytes) == STORE_OK) {
            line_t line = {0};
            file_line(&line, path + 1, size_bytes);
            fits = put_root_line(listing, &line, first, &shown);
        }
    }
}

ftp_error_t ftp_list(store_t *store, const ftp_request_t *request, uint8_t *reply) {
    char path[STORE_PATH_BYTES];
    listing_t listing = {.store = store,
                         .folder = ftp_path_parse(request->data, request->size, path),
                         .out = reply + FTP_HEADER_BYTES};
    switch (listing.folder) {
    case FTP_PATH_ROOT:
        put_root(&listing, store, request->offset);
        break;
    case FTP_PATH_TRIALS:
    case FTP_PATH_IN:
        (void)store_walk(store, path, request->offset, put_entry, &listing);
        break;
    default:
        return FTP_NOT_FOUND;
    }
    ftp_set_size(reply, listing.used);
    return listing.used == 0 ? FTP_EOF : FTP_OK;
}
