/* A message taken in, where, and whether its sender is authenticated. */
#ifndef LINK_RECEIVED_H
#define LINK_RECEIVED_H

#include "link/channel.h"

#include <string.h>

/* What zeros the sender cut off |message| are there again, so that its fields can be read in place;
 * those of 64 bits are not aligned, and are read from a copy of all |fields|. */
#define RECEIVED_COPY(in, fields) memcpy(fields, _MAV_PAYLOAD((in)->message), sizeof *(fields))

typedef struct {
    channel_t *channel;
    const mavlink_message_t *message;
    signing_verdict_t verdict;
} received_t;

/* Whether a message to |system| and |component| is for this board; 0 = everybody. */
bool received_is_ours(uint8_t system, uint8_t component);

/* Whether a host asks this board alone for it, and not everybody on the line. */
bool received_is_ours_alone(uint8_t system, uint8_t component);

#endif
