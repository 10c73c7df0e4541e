/* MAVLink's parameter protocol: lists, reads and sets parameters. Main loop only. */
#ifndef LINK_PARAMS_SERVER_H
#define LINK_PARAMS_SERVER_H

#include "link/handlers.h"
#include "link/outbox.h"
#include "link/received.h"

/* Begins as zeros, but for the pointers. */
typedef struct {
    outbox_t *outbox;
    const params_t *params;
    const link_handlers_t *handlers; /* set a parameter */
    uint16_t left[OUTBOX_PORTS];     /* to send of a PARAM_REQUEST_LIST */
} params_server_t;

void params_server_on_request_list(params_server_t *server, const received_t *in);
void params_server_on_request_read(const params_server_t *server, const received_t *in);
void params_server_on_set(const params_server_t *server, const received_t *in);

/* The next parameters of the lists that were asked for, as the lines have room. */
void params_server_stream(params_server_t *server);

#endif
