#include "link/ftp_paths.h"

#include <stdbool.h>
#include <string.h>

static const char *const records[] = {
    "/reference.bin", "/crash.bin", "/past0.bin", "/past1.bin", "/past2.bin",
    "/past3.bin",     "/past4.bin", "/past5.bin", "/past6.bin", "/past7.bin",
};
static const char *const uploads[] = {"reference.bin", "amplitudes.bin", "speeds.bin",
                                      "learned.bin"};

#define COUNT(array) (sizeof(array) / sizeof((array)[0]))

const char *ftp_path_record(uint32_t index) {
    return index < COUNT(records) ? records[index] : NULL;
}

static bool name_char(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' ||
           c == '_' || c == '-';
}

/* One path component that cannot lead anywhere else. */
static bool plain_name(const char *name) {
    if (name[0] == '\0' || name[0] == '.') {
        return false;
    }
    for (uint32_t i = 0; name[i] != '\0'; i++) {
        if (!name_char(name[i])) {
            return false;
        }
    }
    return true;
}

ftp_path_t ftp_path_in_folder(ftp_path_t folder, const char *name) {
    if (!plain_name(name)) {
        return FTP_PATH_HIDDEN;
    }
    if (folder == FTP_PATH_TRIALS) {
        return FTP_PATH_TRIAL;
    }
    for (uint32_t i = 0; folder == FTP_PATH_IN && i < COUNT(uploads); i++) {
        if (strcmp(name, uploads[i]) == 0) {
            return FTP_PATH_UPLOAD;
        }
    }
    return FTP_PATH_HIDDEN;
}

static ftp_path_t classify(const char *path) {
    static const char trials[] = "/trials/", in[] = "/in/";
    if (strcmp(path, "/") == 0) {
        return FTP_PATH_ROOT;
    }
    if (strcmp(path, "/trials") == 0) {
        return FTP_PATH_TRIALS;
    }
    if (strcmp(path, "/in") == 0) {
        return FTP_PATH_IN;
    }
    if (strncmp(path, trials, sizeof trials - 1) == 0) {
        return ftp_path_in_folder(FTP_PATH_TRIALS, path + sizeof trials - 1);
    }
    if (strncmp(path, in, sizeof in - 1) == 0) {
        return ftp_path_in_folder(FTP_PATH_IN, path + sizeof in - 1);
    }
    for (uint32_t i = 0; i < COUNT(records); i++) {
        if (strcmp(path, records[i]) == 0) {
            return FTP_PATH_RECORD;
        }
    }
    return ftp_path_metadata(path) != NULL ? FTP_PATH_METADATA : FTP_PATH_HIDDEN;
}

const link_file_bytes_t *ftp_path_metadata(const char *path) {
    for (uint32_t i = 0; i < LINK_METADATA_FILES; i++) {
        if (strcmp(path, link_metadata[i].path) == 0) {
            return &link_metadata[i];
        }
    }
    return NULL;
}

ftp_path_t ftp_path_parse(const uint8_t *bytes, uint8_t length, char *path) {
    uint32_t used = 0;
    path[used++] = '/';
    const uint8_t first = length > 0 && bytes[0] == '/' ? 1 : 0;
    for (uint32_t i = first; i < length && bytes[i] != 0; i++) {
        if (used + 1 >= STORE_PATH_BYTES) {
            path[used] = '\0';
            return FTP_PATH_HIDDEN;
        }
        path[used++] = (char)bytes[i];
    }
    if (used > 1 && path[used - 1] == '/') {
        used--;
    }
    path[used] = '\0';
    const ftp_path_t kind = classify(path);
    if (kind == FTP_PATH_TRIAL && strcmp(path + used - 4u, ".ulz") == 0) {
        path[used - 1u] = 'g';
        return FTP_PATH_PACKED;
    }
    return kind;
}
