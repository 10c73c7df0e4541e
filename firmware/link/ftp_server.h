/*
 * MAVLink FTP server: list, read, burst read, write (below /in only), remove, CRC32, reset.
 *
 * Request payload in, reply payload out; knows nothing of ports. One session. The tree it shows is
 * /trials, /in, /reference.bin and /crash.bin; parameters, learned input and keys are not in it.
 */
#ifndef LINK_FTP_SERVER_H
#define LINK_FTP_SERVER_H

#include "store/store.h"

#include <stdbool.h>
#include <stdint.h>

#define FTP_PAYLOAD_BYTES 251u /* of FILE_TRANSFER_PROTOCOL.payload */
#define FTP_DATA_BYTES 239u
#define FTP_IN_FILE_MAX_BYTES 16384u /* largest upload */
#define FTP_BURST_PACKETS 160u       /* per request: the stock client gives up on longer silence */

typedef struct {
    store_t *store;
    store_file_t file;
    bool open, writing;
    uint8_t session;
    uint8_t owner_system, owner_component, owner_port;
    /* burst in progress */
    bool bursting;
    uint8_t burst_size;
    uint16_t burst_seq;
    uint16_t burst_left;
    uint32_t burst_offset;
    /* last reply, repeated when the same request comes again (a lost answer) */
    uint16_t last_seq;
    uint8_t last_opcode, last_system;
    bool have_last;
    uint8_t last_reply[FTP_PAYLOAD_BYTES];
} ftp_server_t;

void ftp_server_init(ftp_server_t *ftp, store_t *store);

/* Answers one request. |reply| holds FTP_PAYLOAD_BYTES. Returns false when there is nothing to send
 * at once (a burst has begun: its packets come from ftp_server_burst). */
bool ftp_server_request(ftp_server_t *ftp, const uint8_t *request, uint8_t system,
                        uint8_t component, uint8_t port, uint8_t *reply);

/* The next packet of a running burst; false when none is due. */
bool ftp_server_burst(ftp_server_t *ftp, uint8_t *reply);

#endif
