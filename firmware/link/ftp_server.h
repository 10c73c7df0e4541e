/*
 * MAVLink FTP server: list, read, burst read, write (below /in only), remove, CRC32, reset.
 *
 * Request payload in, reply payload out; knows nothing of ports. The tree it shows is in
 * ftp_paths.h, whose session it is in ftp_session.h. ResetSessions closes the session that the
 * sender might take, its own too, and is always acknowledged. Who is not trusted does not write or
 * remove (Protected). A request that changes something and comes again, because its answer was
 * lost, gets the same answer and is not executed twice; ResetSessions is executed every time.
 * OpenFileWO does what CreateFile does: the file starts anew. Main loop only; writing may take as
 * long as the store's writes do.
 */
#ifndef LINK_FTP_SERVER_H
#define LINK_FTP_SERVER_H

#include "link/ftp_burst.h"

#define FTP_SHORT_REPLY_BYTES 16u /* header and 4 bytes: the answer to a changing request */

/* Last request that changed something, and its answer. */
typedef struct {
    bool known;
    ftp_host_t host;
    uint32_t request_crc;
    uint64_t reply_us;
    uint8_t reply[FTP_SHORT_REPLY_BYTES];
} ftp_change_t;

typedef struct {
    ftp_burst_t burst;
    ftp_change_t last;
    ftp_session_t session;
} ftp_server_t;

void ftp_server_init(ftp_server_t *ftp, store_t *store);

/* Answers one request. |request| and |reply| hold FTP_PAYLOAD_BYTES. Returns false when there is
 * nothing to send at once: a burst has begun (its packets come from ftp_server_burst), or the
 * request is itself an answer. */
bool ftp_server_request(ftp_server_t *ftp, ftp_host_t host, const uint8_t *request, uint8_t *reply);

/* Whether only a trusted host may ask for this. */
bool ftp_server_needs_trust(const uint8_t *request);

/* Answers any request with Protected; returns as ftp_server_request. */
bool ftp_server_refuse(const uint8_t *request, uint8_t *reply);

/* Ends an upload that is under way: a trial begins, during which nothing may be written. */
void ftp_server_end_upload(ftp_server_t *ftp);

/* The next packet of a running burst, for |ftp->session.owner|; false when none is due. */
bool ftp_server_burst(ftp_server_t *ftp, uint8_t *reply);

#endif
