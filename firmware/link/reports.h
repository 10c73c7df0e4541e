/* Messages about the board as link_status_t describes it, one function each. */
#ifndef LINK_REPORTS_H
#define LINK_REPORTS_H

#include "link/outbox.h"
#include "link/status.h"
#include "store/store.h"

typedef struct {
    outbox_t *outbox;
    store_t *store;
    const link_status_t *status; /* of this poll */
} reports_t;

typedef void (*reports_send_t)(const reports_t *reports, channel_t *channel);

void reports_heartbeat(const reports_t *reports, channel_t *channel);
void reports_status(const reports_t *reports, channel_t *channel);
void reports_battery(const reports_t *reports, channel_t *channel);
void reports_sys_status(const reports_t *reports, channel_t *channel);
void reports_attitude(const reports_t *reports, channel_t *channel);
void reports_live(const reports_t *reports, channel_t *channel);
void reports_learned(const reports_t *reports, channel_t *channel); /* the last one again */

/* What reports_status() sends. */
mavlink_tailbeat_status_t reports_status_message(const reports_t *reports);

#endif
