/* Requests that need an authenticated sender (signing.h), and new keys. */
#ifndef LINK_TRUST_H
#define LINK_TRUST_H

#include "link/handlers.h"
#include "link/outbox.h"
#include "link/received.h"

/* FAULT_NONE when the sender is trusted; else why not, counted and sent as text (once a second at
 * most). */
fault_t trust_refusal(outbox_t *outbox, const received_t *in);

void trust_on_setup_signing(outbox_t *outbox, const link_handlers_t *handlers,
                            const received_t *in);

#endif
