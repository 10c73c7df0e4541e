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

/* Bytes around a payload of MAVLink 2: header, checksum, signature. */
#define CHANNEL_FRAME_BYTES (MAVLINK_NUM_NON_PAYLOAD_BYTES + MAVLINK_SIGNATURE_BLOCK_LEN)

/* Bytes left free for an answer when something is streamed: the longest one. */
#define CHANNEL_RESERVE_BYTES (MAVLINK_MAX_PACKET_LEN)

typedef struct {
    hal_t *hal;
    hal_port_t port;
    uint8_t sequence;    /* of the next message sent */
    uint16_t held;       /* bytes in |window| */
    bool quiet;          /* the port was found empty since bytes came */
    uint64_t quiet_us;   /* ... first then */
    signing_t *signing;  /* of what is sent; NULL = nobody signs */
    uint32_t bad_frames; /* message that the board reads (inbound.h), wrong CRC */
    uint32_t dropped;    /* messages not sent because the line was full */
    uint8_t window[MAVLINK_MAX_PACKET_LEN]; /* bytes in which a frame is being looked for */
} channel_t;

/* What is sent is signed as |signing| says, which must outlive the channel; NULL = not at all. */
void channel_init(channel_t *channel, hal_t *hal, hal_port_t port, signing_t *signing);

/* Takes bytes until one message is complete. False when the port has no more, or when
 * CHANNEL_CALL_BYTES held none. Takes MAVLink 1 and 2. Behind a start byte that began no good frame
 * the search goes on with the next byte, so damage costs only the frame it hit. A frame of a
 * message that the board does not read cannot be checked; it is dropped and not counted. */
bool channel_receive(channel_t *channel, mavlink_message_t *message);

/* Sends the message with |fields|, the dialect's struct for |form|; false (and counted) when it
 * does not fit into the line. */
bool channel_send(channel_t *channel, const message_form_t *form, const void *fields);

/* Defines form_ of message |NAME|. The dialect's structs lie in memory as they lie on the wire: the
 * core is little-endian, as the wire is. */
_Static_assert(MAVLINK_NEED_BYTE_SWAP == 0, "fields go onto the wire as they are in memory");
#define CHANNEL_FORM(NAME, fields)                                                                 \
    static const message_form_t form_ = MESSAGE_FORM(NAME);                                        \
    _Static_assert(sizeof *(fields) >= MAVLINK_MSG_ID_##NAME##_LEN &&                              \
                       sizeof *(fields) < MAVLINK_MSG_ID_##NAME##_LEN + sizeof(uint64_t),          \
                   "fields of " #NAME ", and padding at most behind them")

/* Sends message |NAME| with |fields|; a line that is full drops it. */
#define CHANNEL_SEND(channel, NAME, fields)                                                        \
    do {                                                                                           \
        CHANNEL_FORM(NAME, fields);                                                                \
        (void)channel_send((channel), &form_, (fields));                                           \
    } while (0)

/* Whether |bytes| more fit into the line. */
bool channel_has_space(const channel_t *channel, size_t bytes);

#endif
