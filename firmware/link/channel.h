/* One MAVLink byte stream: bytes to messages and back. Holds no protocol knowledge beyond framing.
 */
#ifndef LINK_CHANNEL_H
#define LINK_CHANNEL_H

#include "hal/serial.h"
#include "link/mavlink.h"

#include <stdbool.h>
#include <stdint.h>

#define CHANNEL_CHUNK_BYTES 64u
#define CHANNEL_CALL_BYTES 1024u /* most that one call of channel_receive takes in */

typedef struct {
    hal_t *hal;
    hal_port_t port;
    mavlink_message_t rx_message; /* parser's own */
    mavlink_status_t rx_status;
    mavlink_status_t tx_status;         /* sequence number; later the signing state */
    uint8_t chunk[CHANNEL_CHUNK_BYTES]; /* taken out of the port, not yet parsed */
    uint8_t chunk_held, chunk_used;
    uint32_t bad_frames; /* known message, wrong CRC */
    uint32_t dropped;    /* messages not sent because the line was full */
} channel_t;

void channel_init(channel_t *channel, hal_t *hal, hal_port_t port);

/* Takes bytes until one message is complete. False when the port has no more, or when
 * CHANNEL_CALL_BYTES held none. Takes MAVLink 1 and 2. A frame of a message that the dialect does
 * not know cannot be checked; it is dropped and not counted. */
bool channel_receive(channel_t *channel, mavlink_message_t *message);

/* Sends a packed message; false (and counted) when it does not fit into the line. */
bool channel_send(channel_t *channel, const mavlink_message_t *message);

/* Whether |bytes| more fit into the line. */
bool channel_has_space(const channel_t *channel, size_t bytes);

#endif
