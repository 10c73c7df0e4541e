#include "link/ftp_codec.h"

#include "store/bytes.h"

#include <string.h>

#define AT_SEQ 0
#define AT_SESSION 2
#define AT_OPCODE 3
#define AT_SIZE 4
#define AT_REQ_OPCODE 5
#define AT_BURST_COMPLETE 6
#define AT_OFFSET 8
#define AT_DATA FTP_HEADER_BYTES

#define NO_SPACE_ERRNO 28u /* ENOSPC */

bool ftp_same_host(ftp_host_t a, ftp_host_t b) {
    uint32_t bytes_a, bytes_b;
    _Static_assert(sizeof a == sizeof bytes_a, "no padding, which would differ");
    memcpy(&bytes_a, &a, sizeof bytes_a);
    memcpy(&bytes_b, &b, sizeof bytes_b);
    return bytes_a == bytes_b;
}

ftp_request_t ftp_decode(const uint8_t *payload, ftp_host_t host) {
    return (ftp_request_t){
        .seq = bytes_get_u16(payload + AT_SEQ),
        .session = payload[AT_SESSION],
        .opcode = payload[AT_OPCODE],
        .size = payload[AT_SIZE],
        .offset = bytes_get_u32(payload + AT_OFFSET),
        .data = payload + AT_DATA,
        .host = host,
    };
}

void ftp_ack(const ftp_request_t *request, uint8_t *reply) {
    memset(reply, 0, FTP_PAYLOAD_BYTES);
    bytes_put_u16(reply + AT_SEQ, (uint16_t)(request->seq + 1u));
    reply[AT_SESSION] = request->session;
    reply[AT_OPCODE] = FTP_OP_ACK;
    reply[AT_REQ_OPCODE] = request->opcode;
    bytes_put_u32(reply + AT_OFFSET, request->offset);
}

void ftp_nak(uint8_t *reply, ftp_error_t error) {
    memset(reply + AT_DATA, 0, FTP_DATA_BYTES);
    reply[AT_OPCODE] = FTP_OP_NAK;
    reply[AT_SIZE] = 1;
    reply[AT_DATA] = (uint8_t)error;
    if (error == FTP_FAIL_ERRNO) {
        reply[AT_SIZE] = 2;
        reply[AT_DATA + 1] = NO_SPACE_ERRNO;
    }
}

void ftp_set_size(uint8_t *reply, uint8_t size) { reply[AT_SIZE] = size; }

void ftp_set_u32(uint8_t *reply, uint32_t value) {
    bytes_put_u32(reply + AT_DATA, value);
    reply[AT_SIZE] = 4;
}

void ftp_put_burst(const ftp_burst_packet_t *packet, uint8_t *reply) {
    bytes_put_u16(reply + AT_SEQ, packet->seq);
    reply[AT_SESSION] = packet->session;
    reply[AT_OPCODE] = FTP_OP_ACK;
    reply[AT_SIZE] = packet->size;
    reply[AT_REQ_OPCODE] = FTP_OP_BURST;
    reply[AT_BURST_COMPLETE] = packet->complete ? 1 : 0;
    bytes_put_u32(reply + AT_OFFSET, packet->offset);
}
