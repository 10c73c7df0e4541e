/*
 * The FTP server's one session: a file that is open for one host.
 *
 * Its owner is the host that opened it; another host's open takes it over once the owner has been
 * silent for FTP_SESSION_SILENT_US, until then it is refused (NoSessionsAvailable); a trusted host
 * takes it from one that is not at once. While conditions.read_only an upload's session stays as it
 * is: its end would be written. The session gets the number its open request carries: pymavlink's
 * client sends the first blocks of an upload under that number before it has seen the answer.
 * Blocks of an upload may come in any order below FTP_IN_FILE_MAX_BYTES; a block that never comes
 * leaves zeros, which the CRC finds. A trial's log is unpacked while it is read, unless it is
 * opened by the name of its stored bytes (ftp_paths.h). What looks like one of the board's own
 * records is refused (Fail), and so are writes at 1 to 3 bytes from the begin. Main loop only.
 */
#ifndef LINK_FTP_SESSION_H
#define LINK_FTP_SESSION_H

#include "link/ftp_files.h"
#include "link/metadata.h"

#define FTP_IN_FILE_MAX_BYTES 16384u /* largest upload */
#define FTP_SESSION_SILENT_US 5000000u

typedef struct {
    store_t *store;
    ftp_host_t owner;
    uint8_t number;
    bool open, writing;
    bool bursting;                     /* packets of a burst are due (ftp_burst.h) */
    const link_file_bytes_t *metadata; /* what is read instead of |file|; NULL = |file| */
    ftp_conditions_t conditions;
    uint64_t last_used_us; /* by the owner */
    store_file_t file;
    log_reader_t reader; /* of |file|, while it is read */
} ftp_session_t;

/* The answers to requests; |reply| already is the empty ACK. */
ftp_error_t ftp_session_open_for_reading(ftp_session_t *session, const ftp_request_t *request,
                                         uint8_t *reply);
ftp_error_t ftp_session_open_for_writing(ftp_session_t *session, const ftp_request_t *request);
ftp_error_t ftp_session_read(ftp_session_t *session, const ftp_request_t *request, uint8_t *reply);
ftp_error_t ftp_session_write(ftp_session_t *session, const ftp_request_t *request);
ftp_error_t ftp_session_terminate(ftp_session_t *session, const ftp_request_t *request);

/* Closes the session that |host| might take, its own too; false = it may not take it. */
bool ftp_session_reset(ftp_session_t *session, ftp_host_t host);

/* Ends an upload that is under way, if it may be written now. */
void ftp_session_end_upload(ftp_session_t *session);

/* For bursts. Whether |request| may read at its offset; the bytes that can be read in all; and as
 * store_read_at, |offset| being below the end. */
ftp_error_t ftp_session_may_read(const ftp_session_t *session, const ftp_request_t *request);
uint32_t ftp_session_bytes(const ftp_session_t *session);
store_result_t ftp_session_read_at(ftp_session_t *session, uint32_t offset, uint8_t *out,
                                   size_t max, size_t *got);

/* Bytes that |request| asks for; a request for 0 leaves the amount to us. */
uint8_t ftp_session_wanted_bytes(const ftp_request_t *request);

#endif
