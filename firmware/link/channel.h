/* One MAVLink byte stream: bytes to messages and back. Holds no protocol knowledge beyond framing.
 */
#ifndef LINK_CHANNEL_H
#define LINK_CHANNEL_H

#include "hal/serial.h"
#include "link/mavlink.h"
#include "link/signing.h"

#include <stdbool.h>
#include <stdint.h>

#define CHANNEL_CALL_BYTES 1024u /* most that one call of channel_receive takes in */

/* A frame that stops coming for this long is given up: longer than the gaps between the packets of
 * a Bluetooth link, shorter than a host waits before it repeats a request. */
#define CHANNEL_SILENCE_US 300000u

typedef struct {
    hal_t *hal;
    hal_port_t port;
    uint8_t window[MAVLINK_MAX_PACKET_LEN]; /* bytes in which a frame is being looked for */
    uint16_t held;
    uint64_t last_byte_us;
    uint8_t sequence;    /* of the next message sent */
    signing_t *signing;  /* of what is sent; NULL = nobody signs */
    uint32_t bad_frames; /* message that the board reads (inbound.h), wrong CRC */
    uint32_t dropped;    /* messages not sent because the line was full */
} channel_t;

void channel_init(channel_t *channel, hal_t *hal, hal_port_t port);

/* From now on what is sent is signed as |signing| says, which must outlive the channel. */
void channel_sign(channel_t *channel, signing_t *signing);

/* Takes bytes until one message is complete. False when the port has no more, or when
 * CHANNEL_CALL_BYTES held none. Takes MAVLink 1 and 2. Behind a start byte that began no good frame
 * the search goes on with the next byte, so damage costs only the frame it hit. A frame of a
 * message that the board does not read cannot be checked; it is dropped and not counted. */
bool channel_receive(channel_t *channel, mavlink_message_t *message);

/* Sends the message with |fields|, the dialect's struct for |form|; false (and counted) when it
 * does not fit into the line. */
bool channel_send(channel_t *channel, const message_form_t *form, const void *fields);

/* Whether |bytes| more fit into the line. */
bool channel_has_space(const channel_t *channel, size_t bytes);

#endif
