/*
 * Bursts of the FTP server: packets of one file without a request for each. A burst's last packet,
 * because of FTP_BURST_PACKETS or of the file's end, has burst_complete set; a request at or beyond
 * the end is answered by NAK EOF.
 */
#ifndef LINK_FTP_BURST_H
#define LINK_FTP_BURST_H

#include "link/ftp_session.h"

#define FTP_BURST_PACKETS 160u /* per request: the stock client gives up on longer silence */

/* Runs while session.bursting. */
typedef struct {
    uint8_t size;
    uint16_t seq;
    uint16_t left;
    uint32_t offset;
} ftp_burst_t;

ftp_error_t ftp_burst_begin(ftp_burst_t *burst, ftp_session_t *session,
                            const ftp_request_t *request);

/* The next packet of a running burst into |reply|. */
void ftp_burst_packet(ftp_burst_t *burst, ftp_session_t *session, uint8_t *reply);

#endif
