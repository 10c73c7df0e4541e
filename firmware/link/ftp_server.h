/*
 * MAVLink FTP server: list, read, burst read, write (below /in only), remove, CRC32, reset.
 *
 * Request payload in, reply payload out; knows nothing of ports. The tree it shows is in
 * ftp_paths.h. One session. Its owner is the host that opened it; another host's open takes it over
 * once the owner has been silent for FTP_SESSION_SILENT_US, until then it is refused
 * (NoSessionsAvailable); a trusted host takes it from one that is not at once. ResetSessions closes
 * the session that the sender might take, its own too, and is always acknowledged. While read_only
 * an upload's session stays as it is: its end would be written. Who is not trusted does not write
 * or remove (Protected). A request that changes something and comes again, because its answer was
 * lost, gets the same answer and is not executed twice; ResetSessions is executed every time. The
 * session gets the number its open request carries: pymavlink's client sends the first blocks of an
 * upload under that number before it has seen the answer. A burst's last packet, because of
 * FTP_BURST_PACKETS or of the file's end, has burst_complete set; a request at or beyond the end is
 * answered by NAK EOF. OpenFileWO does what CreateFile does: the file starts anew. Blocks of an
 * upload may come in any order below FTP_IN_FILE_MAX_BYTES; a block that never comes leaves zeros,
 * which the CRC finds. A trial's log is unpacked while it is read, unless it is opened by the name
 * of its stored bytes (ftp_paths.h). What looks like one of the board's own records is refused
 * (Fail), and so are writes at 1 to 3 bytes from the begin. Main loop only; writing may take as
 * long as the store's writes do.
 */
#ifndef LINK_FTP_SERVER_H
#define LINK_FTP_SERVER_H

#include "link/metadata.h"
#include "store/log_reader.h"

#include <stdbool.h>
#include <stdint.h>

#define FTP_PAYLOAD_BYTES 251u /* of FILE_TRANSFER_PROTOCOL.payload */
#define FTP_HEADER_BYTES 12u
#define FTP_DATA_BYTES 239u
#define FTP_IN_FILE_MAX_BYTES 16384u /* largest upload */
#define FTP_BURST_PACKETS 160u       /* per request: the stock client gives up on longer silence */
#define FTP_SESSION_SILENT_US 5000000u
#define FTP_SHORT_REPLY_BYTES 16u /* header and 4 bytes: the answer to a changing request */

/* A sender. |trusted| is part of who it is: nobody touches a session by a borrowed address. */
typedef struct {
    uint8_t system, component, port;
    bool trusted; /* may write, and takes the session from one that is not */
} ftp_host_t;

/* What the server has to know of the board; the caller sets it before each call. */
typedef struct {
    uint64_t now_us;
    bool read_only;      /* no request may write flash now */
    uint32_t busy_trial; /* its file is being written and is not opened; 0 = none */
} ftp_conditions_t;

typedef struct {
    store_t *store;
    ftp_conditions_t conditions;
    store_file_t file;
    log_reader_t reader;               /* of |file|, while it is read */
    const link_file_bytes_t *metadata; /* what is read instead; NULL = |file| */
    bool open, writing;
    uint8_t session;
    ftp_host_t owner;
    uint64_t last_used_us; /* by the owner */
    /* burst in progress */
    bool bursting;
    uint8_t burst_size;
    uint16_t burst_seq;
    uint16_t burst_left;
    uint32_t burst_offset;
    /* last request that changed something, and its answer */
    bool have_last;
    ftp_host_t last_host;
    uint32_t last_request_crc;
    uint64_t last_reply_us;
    uint8_t last_reply[FTP_SHORT_REPLY_BYTES];
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

/* The next packet of a running burst, for |ftp->owner|; false when none is due. */
bool ftp_server_burst(ftp_server_t *ftp, uint8_t *reply);

#endif
