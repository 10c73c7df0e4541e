/* Commands of hosts: authenticated, handed to the application, answered. Main loop only. */
#ifndef LINK_COMMANDS_H
#define LINK_COMMANDS_H

#include "link/ftp_server.h"
#include "link/handlers.h"
#include "link/message_requests.h"
#include "link/outbox.h"

typedef struct {
    outbox_t *outbox;
    const link_handlers_t *handlers;
    ftp_server_t *ftp; /* a trial that starts ends an upload */
    message_requests_t requests;
} commands_t;

void commands_on_long(const commands_t *commands, const received_t *in);
void commands_on_int(const commands_t *commands, const received_t *in);

#endif
