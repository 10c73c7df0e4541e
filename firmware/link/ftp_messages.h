/* FILE_TRANSFER_PROTOCOL messages: requests to the FTP server, its answers and bursts. */
#ifndef LINK_FTP_MESSAGES_H
#define LINK_FTP_MESSAGES_H

#include "link/ftp_server.h"
#include "link/outbox.h"
#include "link/received.h"

void ftp_messages_on_request(ftp_server_t *ftp, outbox_t *outbox, const received_t *in);

/* Packets of a running burst, as the line has room. */
void ftp_messages_stream(ftp_server_t *ftp, outbox_t *outbox);

/* The port whose line a file has to itself; OUTBOX_PORTS = none. A burst has it if a trusted host
 * asked for it, and no trial is open. */
uint32_t ftp_messages_filled_port(const ftp_server_t *ftp);

#endif
