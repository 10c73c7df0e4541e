#include "link/ftp_burst.h"

#include <string.h>

ftp_error_t ftp_burst_begin(ftp_burst_t *burst, ftp_session_t *session,
                            const ftp_request_t *request) {
    const ftp_error_t error = ftp_session_may_read(session, request);
    if (error != FTP_INVALID_SESSION) {
        session->bursting = error == FTP_OK;
    }
    if (error == FTP_OK) {
        burst->size = ftp_session_wanted_bytes(request);
        burst->seq = (uint16_t)(request->seq + 1u);
        burst->left = FTP_BURST_PACKETS;
        burst->offset = request->offset;
    }
    return error;
}

void ftp_burst_packet(ftp_burst_t *burst, ftp_session_t *session, uint8_t *reply) {
    memset(reply, 0, FTP_PAYLOAD_BYTES);
    size_t got = 0;
    const store_result_t result =
        ftp_session_read_at(session, burst->offset, reply + FTP_HEADER_BYTES, burst->size, &got);
    const uint32_t next = burst->offset + (uint32_t)got;
    burst->left--;
    const bool failed = result != STORE_OK || got == 0;
    const ftp_burst_packet_t packet = {
        .seq = burst->seq++,
        .session = session->number,
        .offset = burst->offset,
        .size = (uint8_t)got,
        .complete = failed || burst->left == 0 || next >= ftp_session_bytes(session),
    };
    ftp_put_burst(&packet, reply);
    if (failed) {
        ftp_nak(reply, result != STORE_OK ? FTP_FAIL : FTP_EOF);
    }
    session->bursting = !packet.complete;
    burst->offset = next;
    session->last_used_us = session->conditions.now_us;
}
