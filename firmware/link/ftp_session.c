#include "link/ftp_session.h"

#include "link/ftp_paths.h"
#include "store/records.h"

#include <string.h>

static ftp_error_t close_session(ftp_session_t *session) {
    if (!session->open) {
        return FTP_OK;
    }
    session->open = false;
    session->bursting = false;
    return session->metadata != NULL ? FTP_OK
                                     : ftp_files_error(store_close(session->store, &session->file));
}

static bool is_silent(const ftp_session_t *session) {
    return !session->bursting &&
           session->conditions.now_us - session->last_used_us >= FTP_SESSION_SILENT_US;
}

/* An upload's end is written; it waits for a time at which requests may write. */
static bool must_stay(const ftp_session_t *session) {
    return session->open && session->writing && session->conditions.read_only;
}

/* Whether the sender may close or take the session. */
static bool may_take(const ftp_session_t *session, ftp_host_t host) {
    return !must_stay(session) && (!session->open || ftp_same_host(session->owner, host) ||
                                   is_silent(session) || (host.trusted && !session->owner.trusted));
}

static bool owns_session(const ftp_session_t *session, const ftp_request_t *request) {
    return session->open && session->number == request->session &&
           ftp_same_host(session->owner, request->host);
}

static ftp_error_t open_session(ftp_session_t *session, const ftp_request_t *request,
                                const char *path, store_mode_t mode) {
    if (!may_take(session, request->host)) {
        return FTP_NO_SESSIONS;
    }
    (void)close_session(session);
    session->metadata = mode == STORE_READ ? ftp_path_metadata(path) : NULL;
    const ftp_error_t error =
        session->metadata != NULL
            ? FTP_OK
            : ftp_files_error(store_open(session->store, &session->file, path, mode));
    if (error == FTP_OK) {
        session->open = true;
        session->writing = mode != STORE_READ;
        session->owner = request->host;
        session->number = request->session;
    }
    return error;
}

uint32_t ftp_session_bytes(const ftp_session_t *session) {
    return session->metadata != NULL ? session->metadata->size : session->reader.size;
}

store_result_t ftp_session_read_at(ftp_session_t *session, uint32_t offset, uint8_t *out,
                                   size_t max, size_t *got) {
    if (session->metadata == NULL) {
        return log_reader_read(&session->reader, offset, out, max, got);
    }
    const size_t rest = session->metadata->size - offset;
    *got = rest < max ? rest : max;
    memcpy(out, session->metadata->bytes + offset, *got);
    return STORE_OK;
}

ftp_error_t ftp_session_open_for_reading(ftp_session_t *session, const ftp_request_t *request,
                                         uint8_t *reply) {
    char path[STORE_PATH_BYTES];
    log_info_t info;
    ftp_error_t error =
        ftp_files_readable(session->store, &session->conditions, request, path, &info);
    if (error == FTP_OK) {
        error = open_session(session, request, path, STORE_READ);
    }
    if (error == FTP_OK && session->metadata == NULL) {
        log_reader_begin(&session->reader, session->store, &session->file, &info);
    }
    ftp_set_u32(reply, ftp_session_bytes(session));
    return error;
}

ftp_error_t ftp_session_open_for_writing(ftp_session_t *session, const ftp_request_t *request) {
    char path[STORE_PATH_BYTES];
    const ftp_path_t kind = ftp_path_parse(request->data, request->size, path);
    if (kind != FTP_PATH_UPLOAD || session->conditions.read_only) {
        return FTP_PROTECTED;
    }
    return open_session(session, request, path, STORE_WRITE_NEW);
}

uint8_t ftp_session_wanted_bytes(const ftp_request_t *request) {
    return request->size == 0 ? (uint8_t)FTP_DATA_BYTES : request->size;
}

ftp_error_t ftp_session_may_read(const ftp_session_t *session, const ftp_request_t *request) {
    if (!owns_session(session, request) || session->writing) {
        return FTP_INVALID_SESSION;
    }
    return request->offset >= ftp_session_bytes(session) ? FTP_EOF : FTP_OK;
}

ftp_error_t ftp_session_read(ftp_session_t *session, const ftp_request_t *request, uint8_t *reply) {
    const ftp_error_t error = ftp_session_may_read(session, request);
    if (error != FTP_OK) {
        return error;
    }
    size_t got = 0;
    const store_result_t result =
        ftp_session_read_at(session, request->offset, reply + FTP_HEADER_BYTES,
                            ftp_session_wanted_bytes(request), &got);
    ftp_set_size(reply, (uint8_t)got);
    return ftp_files_error(result);
}

/* An upload must not look like a record that only the board writes: salvage would take it for one.
 * Records are recognised by their first four bytes. */
static bool poses(const ftp_request_t *request) {
    const bool split = request->offset > 0 && request->offset < RECORD_MAGIC_BYTES;
    return split || (request->offset == 0 && request->size >= RECORD_MAGIC_BYTES &&
                     record_is_internal(request->data));
}

ftp_error_t ftp_session_write(ftp_session_t *session, const ftp_request_t *request) {
    if (!owns_session(session, request) || !session->writing) {
        return FTP_INVALID_SESSION;
    }
    if (session->conditions.read_only) {
        return FTP_PROTECTED;
    }
    if (request->size == 0) {
        return FTP_INVALID_SIZE;
    }
    if (poses(request)) {
        return FTP_FAIL;
    }
    if (request->offset > FTP_IN_FILE_MAX_BYTES - request->size) {
        return FTP_FAIL_ERRNO;
    }
    return ftp_files_error(store_write_at(session->store, &session->file, request->offset,
                                          request->data, request->size));
}

ftp_error_t ftp_session_terminate(ftp_session_t *session, const ftp_request_t *request) {
    if (!owns_session(session, request)) {
        return FTP_INVALID_SESSION;
    }
    return must_stay(session) ? FTP_PROTECTED : close_session(session);
}

bool ftp_session_reset(ftp_session_t *session, ftp_host_t host) {
    const bool takes = may_take(session, host);
    if (takes) {
        (void)close_session(session);
    }
    return takes;
}

void ftp_session_end_upload(ftp_session_t *session) {
    if (session->writing && !must_stay(session)) {
        (void)close_session(session);
    }
}
