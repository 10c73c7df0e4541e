#include "link/ftp_server.h"

#include "base/crc.h"
#include "link/ftp_codec.h"
#include "link/ftp_list.h"
#include "link/ftp_paths.h"
#include "store/records.h"
#include "store/trial_log.h"

#include <string.h>

void ftp_server_init(ftp_server_t *ftp, store_t *store) {
    memset(ftp, 0, sizeof *ftp);
    ftp->store = store;
}

static bool same_host(ftp_host_t a, ftp_host_t b) {
    return a.system == b.system && a.component == b.component && a.port == b.port &&
           a.trusted == b.trusted;
}

static ftp_error_t from_store(store_result_t result) {
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

static bool is_busy(const ftp_server_t *ftp, const char *path) {
    char busy[STORE_PATH_BYTES];
    if (ftp->conditions.busy_trial == 0) {
        return false;
    }
    trial_log_path(ftp->conditions.busy_trial, busy);
    return strcmp(path, busy) == 0;
}

static ftp_error_t close_session(ftp_server_t *ftp) {
    if (!ftp->open) {
        return FTP_OK;
    }
    ftp->open = false;
    ftp->bursting = false;
    return ftp->metadata != NULL ? FTP_OK : from_store(store_close(ftp->store, &ftp->file));
}

static bool is_silent(const ftp_server_t *ftp) {
    return !ftp->bursting && ftp->conditions.now_us - ftp->last_used_us >= FTP_SESSION_SILENT_US;
}

/* An upload's end is written; it waits for a time at which requests may write. */
static bool must_stay(const ftp_server_t *ftp) {
    return ftp->open && ftp->writing && ftp->conditions.read_only;
}

/* Whether the sender may close or take the session. */
static bool may_take(const ftp_server_t *ftp, ftp_host_t host) {
    return !must_stay(ftp) && (!ftp->open || same_host(ftp->owner, host) || is_silent(ftp) ||
                               (host.trusted && !ftp->owner.trusted));
}

static bool owns_session(const ftp_server_t *ftp, const ftp_request_t *request) {
    return ftp->open && ftp->session == request->session && same_host(ftp->owner, request->host);
}

static ftp_error_t open_session(ftp_server_t *ftp, const ftp_request_t *request, const char *path,
                                store_mode_t mode) {
    if (!may_take(ftp, request->host)) {
        return FTP_NO_SESSIONS;
    }
    (void)close_session(ftp);
    ftp->metadata = mode == STORE_READ ? ftp_path_metadata(path) : NULL;
    const ftp_error_t error =
        ftp->metadata != NULL ? FTP_OK : from_store(store_open(ftp->store, &ftp->file, path, mode));
    if (error == FTP_OK) {
        ftp->open = true;
        ftp->writing = mode != STORE_READ;
        ftp->owner = request->host;
        ftp->session = request->session;
    }
    return error;
}

/* The file that is to be read: |path| in the store, and whether it is to be unpacked. */
static ftp_error_t readable(const ftp_server_t *ftp, const ftp_request_t *request, char *path,
                            log_info_t *info) {
    const ftp_path_t kind = ftp_path_parse(request->data, request->size, path);
    *info = (log_info_t){.packed = false};
    if (kind != FTP_PATH_TRIAL && kind != FTP_PATH_PACKED && kind != FTP_PATH_UPLOAD &&
        kind != FTP_PATH_RECORD && kind != FTP_PATH_METADATA) {
        return FTP_NOT_FOUND;
    }
    if (is_busy(ftp, path)) {
        return FTP_PROTECTED;
    }
    return kind == FTP_PATH_TRIAL ? from_store(log_info(ftp->store, path, info)) : FTP_OK;
}

static uint32_t readable_bytes(const ftp_server_t *ftp) {
    return ftp->metadata != NULL ? ftp->metadata->size : ftp->reader.size;
}

/* As store_read_at, from what is open for reading; |offset| is below its end. */
static store_result_t read_bytes(ftp_server_t *ftp, uint32_t offset, uint8_t *out, size_t max,
                                 size_t *got) {
    if (ftp->metadata == NULL) {
        return log_reader_read(&ftp->reader, offset, out, max, got);
    }
    const size_t rest = ftp->metadata->size - offset;
    *got = rest < max ? rest : max;
    memcpy(out, ftp->metadata->bytes + offset, *got);
    return STORE_OK;
}

static ftp_error_t open_for_reading(ftp_server_t *ftp, const ftp_request_t *request,
                                    uint8_t *reply) {
    char path[STORE_PATH_BYTES];
    log_info_t info;
    ftp_error_t error = readable(ftp, request, path, &info);
    if (error == FTP_OK) {
        error = open_session(ftp, request, path, STORE_READ);
    }
    if (error == FTP_OK && ftp->metadata == NULL) {
        log_reader_begin(&ftp->reader, ftp->store, &ftp->file, &info);
    }
    ftp_set_u32(reply, readable_bytes(ftp));
    return error;
}

static ftp_error_t open_for_writing(ftp_server_t *ftp, const ftp_request_t *request) {
    char path[STORE_PATH_BYTES];
    const ftp_path_t kind = ftp_path_parse(request->data, request->size, path);
    if (kind != FTP_PATH_UPLOAD || ftp->conditions.read_only) {
        return FTP_PROTECTED;
    }
    return open_session(ftp, request, path, STORE_WRITE_NEW);
}

/* A request for 0 bytes leaves the amount to us. */
static uint8_t wanted_bytes(const ftp_request_t *request) {
    return request->size == 0 ? (uint8_t)FTP_DATA_BYTES : request->size;
}

static ftp_error_t read_file(ftp_server_t *ftp, const ftp_request_t *request, uint8_t *reply) {
    if (!owns_session(ftp, request) || ftp->writing) {
        return FTP_INVALID_SESSION;
    }
    if (request->offset >= readable_bytes(ftp)) {
        return FTP_EOF;
    }
    size_t got = 0;
    const store_result_t result =
        read_bytes(ftp, request->offset, reply + FTP_HEADER_BYTES, wanted_bytes(request), &got);
    ftp_set_size(reply, (uint8_t)got);
    return from_store(result);
}

static ftp_error_t begin_burst(ftp_server_t *ftp, const ftp_request_t *request) {
    if (!owns_session(ftp, request) || ftp->writing) {
        return FTP_INVALID_SESSION;
    }
    ftp->bursting = false;
    if (request->offset >= readable_bytes(ftp)) {
        return FTP_EOF;
    }
    ftp->bursting = true;
    ftp->burst_size = wanted_bytes(request);
    ftp->burst_seq = (uint16_t)(request->seq + 1u);
    ftp->burst_left = FTP_BURST_PACKETS;
    ftp->burst_offset = request->offset;
    return FTP_OK;
}

/* An upload must not look like a record that only the board writes: when the store is salvaged it
 * would be believed. Records are told by their first four bytes. */
static bool poses(const ftp_request_t *request) {
    const bool split = request->offset > 0 && request->offset < RECORD_MAGIC_BYTES;
    return split || (request->offset == 0 && request->size >= RECORD_MAGIC_BYTES &&
                     record_is_internal(request->data));
}

static ftp_error_t write_file(ftp_server_t *ftp, const ftp_request_t *request) {
    if (!owns_session(ftp, request) || !ftp->writing) {
        return FTP_INVALID_SESSION;
    }
    if (ftp->conditions.read_only) {
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
    return from_store(
        store_write_at(ftp->store, &ftp->file, request->offset, request->data, request->size));
}

static ftp_error_t remove_file(ftp_server_t *ftp, const ftp_request_t *request) {
    char path[STORE_PATH_BYTES];
    const ftp_path_t kind = ftp_path_parse(request->data, request->size, path);
    if (kind == FTP_PATH_HIDDEN) {
        return FTP_NOT_FOUND;
    }
    if ((kind != FTP_PATH_TRIAL && kind != FTP_PATH_UPLOAD) || ftp->conditions.read_only ||
        is_busy(ftp, path)) {
        return FTP_PROTECTED;
    }
    return from_store(store_remove(ftp->store, path));
}

/* To unpack a long log takes longer than the main loop may pause while the fish swims. */
static ftp_error_t checksum(ftp_server_t *ftp, const ftp_request_t *request, uint8_t *reply) {
    char path[STORE_PATH_BYTES];
    log_info_t info;
    uint32_t crc = 0;
    ftp_error_t error = readable(ftp, request, path, &info);
    if (info.packed && ftp->conditions.read_only) {
        return FTP_PROTECTED;
    }
    const link_file_bytes_t *metadata = ftp_path_metadata(path);
    if (error == FTP_OK && metadata != NULL) {
        crc = crc32_update(0, metadata->bytes, metadata->size);
    } else if (error == FTP_OK) {
        error = from_store(info.packed ? log_reader_crc32(&ftp->reader, ftp->store, path, &crc)
                                       : store_crc32(ftp->store, path, &crc));
    }
    ftp_set_u32(reply, crc);
    return error;
}

static ftp_error_t terminate(ftp_server_t *ftp, const ftp_request_t *request) {
    if (!owns_session(ftp, request)) {
        return FTP_INVALID_SESSION;
    }
    return must_stay(ftp) ? FTP_PROTECTED : close_session(ftp);
}

static ftp_error_t reset_sessions(ftp_server_t *ftp, const ftp_request_t *request) {
    if (may_take(ftp, request->host)) {
        ftp->have_last = false;
        (void)close_session(ftp);
    }
    return FTP_OK;
}

static bool writes(uint8_t opcode) {
    return opcode == FTP_OP_CREATE || opcode == FTP_OP_OPEN_WO || opcode == FTP_OP_WRITE ||
           opcode == FTP_OP_REMOVE;
}

static ftp_error_t execute(ftp_server_t *ftp, const ftp_request_t *request, uint8_t *reply) {
    if (writes(request->opcode) && !request->host.trusted) {
        return FTP_PROTECTED;
    }
    switch (request->opcode) {
    case FTP_OP_NONE:
        return FTP_OK;
    case FTP_OP_TERMINATE:
        return terminate(ftp, request);
    case FTP_OP_RESET:
        return reset_sessions(ftp, request);
    case FTP_OP_LIST:
        return ftp_list(ftp->store, request, reply);
    case FTP_OP_OPEN_RO:
        return open_for_reading(ftp, request, reply);
    case FTP_OP_READ:
        return read_file(ftp, request, reply);
    case FTP_OP_CREATE:
    case FTP_OP_OPEN_WO:
        return open_for_writing(ftp, request);
    case FTP_OP_WRITE:
        return write_file(ftp, request);
    case FTP_OP_REMOVE:
        return remove_file(ftp, request);
    case FTP_OP_CRC32:
        return checksum(ftp, request, reply);
    case FTP_OP_BURST:
        return begin_burst(ftp, request);
    default:
        return FTP_UNKNOWN_COMMAND;
    }
}

/* Requests whose second execution would differ from the first. */
static bool changes_something(uint8_t opcode) {
    return opcode == FTP_OP_TERMINATE || opcode == FTP_OP_OPEN_RO || writes(opcode);
}

static bool is_repeated(const ftp_server_t *ftp, ftp_host_t host, uint32_t crc) {
    return ftp->have_last && same_host(ftp->last_host, host) && ftp->last_request_crc == crc &&
           ftp->conditions.now_us - ftp->last_reply_us < FTP_SESSION_SILENT_US;
}

static void remember(ftp_server_t *ftp, ftp_host_t host, uint32_t crc, const uint8_t *reply) {
    ftp->have_last = true;
    ftp->last_host = host;
    ftp->last_request_crc = crc;
    ftp->last_reply_us = ftp->conditions.now_us;
    memcpy(ftp->last_reply, reply, FTP_SHORT_REPLY_BYTES);
}

static bool is_answer(const ftp_request_t *request) {
    return request->opcode == FTP_OP_ACK || request->opcode == FTP_OP_NAK;
}

bool ftp_server_needs_trust(const uint8_t *payload) {
    return writes(ftp_decode(payload, (ftp_host_t){0}).opcode);
}

bool ftp_server_refuse(const uint8_t *payload, uint8_t *reply) {
    const ftp_request_t request = ftp_decode(payload, (ftp_host_t){0});
    ftp_ack(&request, reply);
    ftp_nak(reply, FTP_PROTECTED);
    return !is_answer(&request);
}

bool ftp_server_request(ftp_server_t *ftp, ftp_host_t host, const uint8_t *payload,
                        uint8_t *reply) {
    const ftp_request_t request = ftp_decode(payload, host);
    if (is_answer(&request)) {
        return false;
    }
    ftp_ack(&request, reply);
    if (request.size > FTP_DATA_BYTES) {
        ftp_nak(reply, FTP_INVALID_SIZE);
        return true;
    }
    const bool changes = changes_something(request.opcode);
    const uint32_t crc =
        changes ? crc32_update(0, payload, FTP_HEADER_BYTES + (size_t)request.size) : 0;
    if (changes && is_repeated(ftp, host, crc)) {
        memcpy(reply, ftp->last_reply, FTP_SHORT_REPLY_BYTES);
        return true;
    }
    const ftp_error_t error = execute(ftp, &request, reply);
    if (ftp->open && same_host(ftp->owner, host)) {
        ftp->last_used_us = ftp->conditions.now_us;
    }
    if (error != FTP_OK) {
        ftp_nak(reply, error);
    } else if (changes) {
        remember(ftp, host, crc, reply);
    }
    return error != FTP_OK || request.opcode != FTP_OP_BURST;
}

void ftp_server_end_upload(ftp_server_t *ftp) {
    if (ftp->writing && !must_stay(ftp)) {
        (void)close_session(ftp);
    }
}

bool ftp_server_burst(ftp_server_t *ftp, uint8_t *reply) {
    if (!ftp->bursting) {
        return false;
    }
    memset(reply, 0, FTP_PAYLOAD_BYTES);
    size_t got = 0;
    const store_result_t result =
        read_bytes(ftp, ftp->burst_offset, reply + FTP_HEADER_BYTES, ftp->burst_size, &got);
    const uint32_t next = ftp->burst_offset + (uint32_t)got;
    ftp->burst_left--;
    const bool failed = result != STORE_OK || got == 0;
    const ftp_burst_packet_t packet = {
        .seq = ftp->burst_seq++,
        .session = ftp->session,
        .offset = ftp->burst_offset,
        .size = (uint8_t)got,
        .complete = failed || ftp->burst_left == 0 || next >= readable_bytes(ftp),
    };
    ftp_put_burst(&packet, reply);
    if (failed) {
        ftp_nak(reply, result != STORE_OK ? FTP_FAIL : FTP_EOF);
    }
    ftp->bursting = !packet.complete;
    ftp->burst_offset = next;
    ftp->last_used_us = ftp->conditions.now_us;
    return true;
}
