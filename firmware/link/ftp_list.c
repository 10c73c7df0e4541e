#include "link/ftp_list.h"

#include "link/ftp_paths.h"

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

/* The root shows its two folders and those records that exist. */
static bool root_line(store_t *store, uint32_t index, line_t *line) {
    static const char *const folders[ROOT_FOLDERS] = {"Dtrials", "Din"};
    if (index < ROOT_FOLDERS) {
        append(line, folders[index]);
        return true;
    }
    uint32_t shown = ROOT_FOLDERS;
    for (uint32_t i = 0; ftp_path_record(i) != NULL; i++) {
        uint32_t size_bytes = 0;
        if (store_size(store, ftp_path_record(i), &size_bytes) != STORE_OK) {
            continue;
        }
        if (shown++ == index) {
            file_line(line, ftp_path_record(i) + 1, size_bytes);
            return true;
        }
    }
    return false;
}

typedef struct {
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

static bool put_entry(void *context, const store_entry_t *entry) {
    listing_t *listing = context;
    line_t line = {0};
    if (entry->directory || ftp_path_in_folder(listing->folder, entry->name) == FTP_PATH_HIDDEN) {
        append(&line, "S");
    } else {
        file_line(&line, entry->name, entry->size_bytes);
    }
    return put(listing, &line);
}

static void put_root(listing_t *listing, store_t *store, uint32_t first) {
    bool fits = true;
    for (uint32_t index = first; fits; index++) {
        line_t line = {0};
        fits = root_line(store, index, &line) && put(listing, &line);
    }
}

ftp_error_t ftp_list(store_t *store, const ftp_request_t *request, uint8_t *reply) {
    char path[STORE_PATH_BYTES];
    listing_t listing = {.folder = ftp_path_parse(request->data, request->size, path),
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
