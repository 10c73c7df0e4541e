#include "link/ftp_files.h"

#include "base/crc.h"
#include "link/ftp_paths.h"
#include "store/trial_log.h"

#include <string.h>

ftp_error_t ftp_files_error(store_result_t result) {
    switch (result) {
    case STORE_OK:
        return FTP_OK;
    case STORE_NOT_FOUND:
        return FTP_NOT_FOUND;
    case STORE_NO_SPACE:
        return FTP_FAIL_ERRNO;
    case STORE_CORRUPT:
    case STORE_IO:
    case STORE_BAD_ARGUMENT:
    default:
        return FTP_FAIL;
    }
}

static bool is_busy(const ftp_conditions_t *conditions, const char *path) {
    char busy[STORE_PATH_BYTES];
    if (conditions->busy_trial == 0) {
        return false;
    }
    trial_log_path(conditions->busy_trial, busy);
    return strcmp(path, busy) == 0;
}

ftp_error_t ftp_files_readable(store_t *store, const ftp_conditions_t *conditions,
                               const ftp_request_t *request, char *path, log_info_t *info) {
    const ftp_path_t kind = ftp_path_parse(request->data, request->size, path);
    *info = (log_info_t){.packed = false};
    if (kind != FTP_PATH_TRIAL && kind != FTP_PATH_PACKED && kind != FTP_PATH_UPLOAD &&
        kind != FTP_PATH_RECORD && kind != FTP_PATH_METADATA) {
        return FTP_NOT_FOUND;
    }
    if (is_busy(conditions, path)) {
        return FTP_PROTECTED;
    }
    return kind == FTP_PATH_TRIAL ? ftp_files_error(log_info(store, path, info)) : FTP_OK;
}

ftp_error_t ftp_files_remove(store_t *store, const ftp_conditions_t *conditions,
                             const ftp_request_t *request) {
    char path[STORE_PATH_BYTES];
    const ftp_path_t kind = ftp_path_parse(request->data, request->size, path);
    if (kind == FTP_PATH_HIDDEN) {
        return FTP_NOT_FOUND;
    }
    if ((kind != FTP_PATH_TRIAL && kind != FTP_PATH_UPLOAD) || conditions->read_only ||
        is_busy(conditions, path)) {
        return FTP_PROTECTED;
    }
    return ftp_files_error(store_remove(store, path));
}

/* To unpack a long log takes longer than the main loop may pause while a trial runs. */
ftp_error_t ftp_files_checksum(store_t *store, const ftp_conditions_t *conditions,
                               log_reader_t *reader, const ftp_request_t *request, uint8_t *reply) {
    char path[STORE_PATH_BYTES];
    log_info_t info;
    uint32_t crc = 0;
    ftp_error_t error = ftp_files_readable(store, conditions, request, path, &info);
    if (info.packed && conditions->read_only) {
        return FTP_PROTECTED;
    }
    const link_file_bytes_t *metadata = ftp_path_metadata(path);
    if (error == FTP_OK && metadata != NULL) {
        crc = crc32_update(0, metadata->bytes, metadata->size);
    } else if (error == FTP_OK) {
        error = ftp_files_error(info.packed ? log_reader_crc32(reader, store, path, &crc)
                                            : store_crc32(store, path, &crc));
    }
    ftp_set_u32(reply, crc);
    return error;
}
