#include "link/ftp_server.h"

#include "base/crc.h"
#include "link/ftp_list.h"

#include <string.h>

void ftp_server_init(ftp_server_t *ftp, store_t *store) {
    memset(ftp, 0, sizeof *ftp);
    ftp->session.store = store;
}

static ftp_error_t reset_sessions(ftp_server_t *ftp, const ftp_request_t *request) {
    if (ftp_session_reset(&ftp->session, request->host)) {
        ftp->last.known = false;
    }
    return FTP_OK;
}

static bool writes(uint8_t opcode) {
    return opcode == FTP_OP_CREATE || opcode == FTP_OP_OPEN_WO || opcode == FTP_OP_WRITE ||
           opcode == FTP_OP_REMOVE;
}

static ftp_error_t execute(ftp_server_t *ftp, const ftp_request_t *request, uint8_t *reply) {
    ftp_session_t *session = &ftp->session;
    if (writes(request->opcode) && !request->host.trusted) {
        return FTP_PROTECTED;
    }
    switch (request->opcode) {
    case FTP_OP_NONE:
        return FTP_OK;
    case FTP_OP_TERMINATE:
        return ftp_session_terminate(session, request);
    case FTP_OP_RESET:
        return reset_sessions(ftp, request);
    case FTP_OP_LIST:
        return ftp_list(session->store, request, reply);
    case FTP_OP_OPEN_RO:
        return ftp_session_open_for_reading(session, request, reply);
    case FTP_OP_READ:
        return ftp_session_read(session, request, reply);
    case FTP_OP_CREATE:
    case FTP_OP_OPEN_WO:
        return ftp_session_open_for_writing(session, request);
    case FTP_OP_WRITE:
        return ftp_session_write(session, request);
    case FTP_OP_REMOVE:
        return ftp_files_remove(session->store, &session->conditions, request);
    case FTP_OP_CRC32:
        return ftp_files_checksum(session->store, &session->conditions, &session->reader, request,
                                  reply);
    case FTP_OP_BURST:
        return ftp_burst_begin(&ftp->burst, session, request);
    default:
        return FTP_UNKNOWN_COMMAND;
    }
}

/* Requests whose second execution would differ from the first. */
static bool changes_something(uint8_t opcode) {
    return opcode == FTP_OP_TERMINATE || opcode == FTP_OP_OPEN_RO || writes(opcode);
}

static bool is_repeated(const ftp_server_t *ftp, ftp_host_t host, uint32_t crc) {
    const ftp_change_t *last = &ftp->last;
    return last->known && ftp_same_host(last->host, host) && last->request_crc == crc &&
           ftp->session.conditions.now_us - last->reply_us < FTP_SESSION_SILENT_US;
}

static void remember(ftp_server_t *ftp, ftp_host_t host, uint32_t crc, const uint8_t *reply) {
    ftp_change_t *last = &ftp->last;
    last->known = true;
    last->host = host;
    last->request_crc = crc;
    last->reply_us = ftp->session.conditions.now_us;
    memcpy(last->reply, reply, FTP_SHORT_REPLY_BYTES);
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
    ftp_session_t *session = &ftp->session;
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
        memcpy(reply, ftp->last.reply, FTP_SHORT_REPLY_BYTES);
        return true;
    }
    const ftp_error_t error = execute(ftp, &request, reply);
    if (session->open && ftp_same_host(session->owner, host)) {
        session->last_used_us = session->conditions.now_us;
    }
    if (error != FTP_OK) {
        ftp_nak(reply, error);
    } else if (changes) {
        remember(ftp, host, crc, reply);
    }
    return error != FTP_OK || request.opcode != FTP_OP_BURST;
}

void ftp_server_end_upload(ftp_server_t *ftp) { ftp_session_end_upload(&ftp->session); }

bool ftp_server_burst(ftp_server_t *ftp, uint8_t *reply) {
    const bool due = ftp->session.bursting;
    if (due) {
        ftp_burst_packet(&ftp->burst, &ftp->session, reply);
    }
    return due;
}
