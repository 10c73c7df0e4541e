/* What ground stations ask for when they connect: the list of modes, and missions. */
#ifndef LINK_DISCOVERY_H
#define LINK_DISCOVERY_H

#include "link/outbox.h"
#include "link/received.h"

/* Begins as zeros, but for the pointer. */
typedef struct {
    outbox_t *outbox;
    uint8_t modes_left[OUTBOX_PORTS]; /* to send of a list of all modes */
} discovery_t;

/* AVAILABLE_MODES number |index|, counted from 1, STATE_COUNT at most; 0 = all of them, which
 * discovery_stream() sends. */
void discovery_send_modes(discovery_t *discovery, channel_t *channel, uint32_t index);
void discovery_stream(discovery_t *discovery);

void discovery_on_mission_request_list(const received_t *in);

#endif
