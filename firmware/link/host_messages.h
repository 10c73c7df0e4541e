/* What hosts send without being asked: HEARTBEAT, TIMESYNC, and the camera's speed samples. */
#ifndef LINK_HOST_MESSAGES_H
#define LINK_HOST_MESSAGES_H

#include "link/handlers.h"
#include "link/outbox.h"
#include "link/received.h"

void host_messages_on_heartbeat(const link_handlers_t *handlers, const received_t *in);
void host_messages_on_timesync(hal_t *hal, const received_t *in);
void host_messages_on_vision(outbox_t *outbox, const link_handlers_t *handlers,
                             const received_t *in);

#endif
