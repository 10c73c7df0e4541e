/* Header of a MAVLink FTP payload: numbers, reading and writing. Pure. */
#ifndef LINK_FTP_CODEC_H
#define LINK_FTP_CODEC_H

#include <stdbool.h>
#include <stdint.h>

#define FTP_PAYLOAD_BYTES 251u /* of FILE_TRANSFER_PROTOCOL.payload */
#define FTP_HEADER_BYTES 12u
#define FTP_DATA_BYTES 239u

typedef enum {
    FTP_OP_NONE = 0,
    FTP_OP_TERMINATE = 1,
    FTP_OP_RESET = 2,
    FTP_OP_LIST = 3,
    FTP_OP_OPEN_RO = 4,
    FTP_OP_READ = 5,
    FTP_OP_CREATE = 6,
    FTP_OP_WRITE = 7,
    FTP_OP_REMOVE = 8,
    FTP_OP_OPEN_WO = 11,
    FTP_OP_CRC32 = 14,
    FTP_OP_BURST = 15,
    FTP_OP_ACK = 128,
    FTP_OP_NAK = 129
} ftp_opcode_t;

typedef enum {
    FTP_OK = 0,
    FTP_FAIL = 1,
    FTP_FAIL_ERRNO = 2,
    FTP_INVALID_SIZE = 3,
    FTP_INVALID_SESSION = 4,
    FTP_NO_SESSIONS = 5,
    FTP_EOF = 6,
    FTP_UNKNOWN_COMMAND = 7,
    FTP_PROTECTED = 9,
    FTP_NOT_FOUND = 10
} ftp_error_t;

/* A sender. |trusted| is part of who it is: nobody touches a session by a borrowed address. */
typedef struct {
    uint8_t system, component, port;
    bool trusted; /* may write, and takes the session from one that is not */
} ftp_host_t;

bool ftp_same_host(ftp_host_t a, ftp_host_t b);

typedef struct {
    uint16_t seq;
    uint8_t session, opcode, size;
    uint32_t offset;
    const uint8_t *data;
    ftp_host_t host;
} ftp_request_t;

ftp_request_t ftp_decode(const uint8_t *payload, ftp_host_t host);

/* Clears |reply| and makes it the empty ACK of |request|: sequence + 1, session and offset echoed.
 */
void ftp_ack(const ftp_request_t *request, uint8_t *reply);

/* Turns |reply| into a NAK. |error| FTP_FAIL_ERRNO goes out with ENOSPC, the only one we have. */
void ftp_nak(uint8_t *reply, ftp_error_t error);

void ftp_set_size(uint8_t *reply, uint8_t size);
void ftp_set_u32(uint8_t *reply, uint32_t value); /* as the whole data */

typedef struct {
    uint16_t seq;
    uint8_t session;
    uint32_t offset;
    uint8_t size;
    bool complete;
} ftp_burst_packet_t;

/* Writes the header in front of data that is already in place. */
void ftp_put_burst(const ftp_burst_packet_t *packet, uint8_t *reply);

#endif
