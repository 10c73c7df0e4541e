#include "link/channel.h"

#include "hal/clock.h"
#include "link/inbound.h"

#include "checksum.h" /* MAVLink's */

#include <string.h>

#define V1_HEADER_BYTES 6u
#define V2_HEADER_BYTES 10u

void channel_init(channel_t *channel, hal_t *hal, hal_port_t port, signing_t *signing) {
    memset(channel, 0, sizeof *channel);
    channel->hal = hal;
    channel->port = port;
    channel->signing = signing;
}

static void drop(channel_t *channel, size_t count) {
    channel->held = (uint16_t)(channel->held - count);
    memmove(channel->window, channel->window + count, channel->held);
}

static void drop_to_start_byte(channel_t *channel) {
    size_t at = 0;
    while (at < channel->held && channel->window[at] != MAVLINK_STX &&
           channel->window[at] != MAVLINK_STX_MAVLINK1) {
        at++;
    }
    drop(channel, at);
}

/* Old senders know no extension fields: the length is the message's, exactly. */
static size_t frame_bytes_v1(const uint8_t *frame) {
    const message_form_t *form = inbound_form(frame[5]);
    return form != NULL && frame[1] == form->min_bytes
               ? V1_HEADER_BYTES + frame[1] + MAVLINK_NUM_CHECKSUM_BYTES
               : 0;
}

static uint32_t id_v2(const uint8_t *frame) {
    return (uint32_t)frame[7] | (uint32_t)frame[8] << 8 | (uint32_t)frame[9] << 16;
}

static size_t frame_bytes_v2(const uint8_t *frame) {
    const bool is_signed = (frame[2] & MAVLINK_IFLAG_SIGNED) != 0;
    if ((frame[2] & ~MAVLINK_IFLAG_SIGNED) != 0 || inbound_form(id_v2(frame)) == NULL) {
        return 0;
    }
    return V2_HEADER_BYTES + (size_t)frame[1] + MAVLINK_NUM_CHECKSUM_BYTES +
           (is_signed ? MAVLINK_SIGNATURE_BLOCK_LEN : 0u);
}

/* Whole length of the frame at the front of the window, at least the length of its header; 0 when
 * no frame can begin like this. */
static size_t frame_bytes(const channel_t *channel) {
    const bool v2 = channel->window[0] == MAVLINK_STX;
    const size_t header = v2 ? V2_HEADER_BYTES : V1_HEADER_BYTES;
    if (channel->held < header) {
        return header;
    }
    return v2 ? frame_bytes_v2(channel->window) : frame_bytes_v1(channel->window);
}

/* CRC-16/MCRF4XX over all of |frame| but its start byte, and the message's own byte. */
static uint16_t checksum_of(const uint8_t *frame, size_t length, uint8_t crc_extra) {
    uint16_t checksum = crc_calculate(frame + 1, (uint16_t)(length - 1));
    crc_accumulate(crc_extra, &checksum);
    return checksum;
}

static void read_header(const uint8_t *frame, bool v2, mavlink_message_t *message) {
    const uint8_t *sender = frame + (v2 ? 4 : 2); /* sequence number, system, component */
    message->magic = frame[0];
    message->len = frame[1];
    message->incompat_flags = v2 ? frame[2] : 0;
    message->compat_flags = v2 ? frame[3] : 0;
    message->seq = sender[0];
    message->sysid = sender[1];
    message->compid = sender[2];
    message->msgid = (v2 ? id_v2(frame) : frame[5]) & 0xFFFFFFu;
}

/* The whole frame at the front of the window; false when its CRC is wrong. What zeros the sender
 * cut off the payload's end, and what extension fields it does not know, are zeros in |message|. */
static bool decode(const channel_t *channel, mavlink_message_t *message) {
    const uint8_t *frame = channel->window;
    const bool v2 = frame[0] == MAVLINK_STX;
    const size_t header = v2 ? V2_HEADER_BYTES : V1_HEADER_BYTES;
    const uint8_t *end = frame + header + frame[1];
    memset(message, 0, sizeof *message);
    read_header(frame, v2, message);
    message->checksum =
        checksum_of(frame, header + frame[1], inbound_form(message->msgid)->crc_extra);
    memcpy(_MAV_PAYLOAD_NON_CONST(message), frame + header, frame[1]);
    memcpy(message->ck, end, sizeof message->ck);
    if ((message->incompat_flags & MAVLINK_IFLAG_SIGNED) != 0) {
        memcpy(message->signature, end + sizeof message->ck, sizeof message->signature);
    }
    return message->checksum == (end[0] | (uint32_t)end[1] << 8);
}

/* Looks through the window; what cannot be a frame is dropped. False when it takes more bytes. */
static bool find_message(channel_t *channel, mavlink_message_t *message) {
    for (drop_to_start_byte(channel); channel->held > 0; drop_to_start_byte(channel)) {
        const size_t length = frame_bytes(channel);
        if (length > channel->held) {
            return false;
        }
        if (length != 0 && decode(channel, message)) {
            drop(channel, length);
            return true;
        }
        channel->bad_frames += length != 0 ? 1u : 0u;
        drop(channel, 1);
    }
    return false;
}

/* Takes at most |max| bytes out of the port into the window. Returns how many. */
static size_t fill(channel_t *channel, size_t max) {
    const size_t room = sizeof channel->window - channel->held;
    const size_t taken = hal_serial_read(channel->hal, channel->port,
                                         channel->window + channel->held, max < room ? max : room);
    channel->held = (uint16_t)(channel->held + taken);
    if (taken == 0 && !channel->quiet) {
        channel->quiet_us = hal_time_us(channel->hal);
    }
    channel->quiet = taken == 0;
    return taken;
}

/* Counted from a look at the port: the rest of a frame may have come while nobody looked. */
static bool frame_stopped_coming(const channel_t *channel) {
    return channel->held > 0 && channel->quiet &&
           hal_time_us(channel->hal) - channel->quiet_us > CHANNEL_SILENCE_US;
}

bool channel_receive(channel_t *channel, mavlink_message_t *message) {
    size_t taken = 0;
    while (taken < CHANNEL_CALL_BYTES) {
        if (find_message(channel, message)) {
            return true;
        }
        const size_t more = fill(channel, CHANNEL_CALL_BYTES - taken);
        taken += more;
        if (frame_stopped_coming(channel)) {
            drop(channel, 1);
        } else if (more == 0) {
            return false;
        }
    }
    return false;
}

static size_t trimmed(const uint8_t *payload, size_t length) {
    while (length > 1 && payload[length - 1] == 0) {
        length--;
    }
    return length;
}

/* Appends the signature to the |length| bytes of |frame|, CRC included; returns its bytes. */
static size_t sign(signing_t *signing, uint8_t *frame, size_t length) {
    return mavlink_sign_packet(&signing->out, frame + length, frame, V2_HEADER_BYTES,
                               frame + V2_HEADER_BYTES, frame[1], frame + length - 2);
}

/* Writes a whole frame into |frame|; returns its length. */
static size_t encode(channel_t *channel, const message_form_t *form, const void *fields,
                     uint8_t frame[MAVLINK_MAX_PACKET_LEN]) {
    signing_t *signing = channel->signing;
    const bool signs = signing != NULL && signing->keyed;
    const uint8_t payload_bytes = (uint8_t)trimmed(fields, form->max_bytes);
    const uint8_t header[V2_HEADER_BYTES] = {
        MAVLINK_STX,
        payload_bytes,
        signs ? MAVLINK_IFLAG_SIGNED : 0,
        0,
        channel->sequence++,
        LINK_SYSTEM,
        LINK_COMPONENT,
        (uint8_t)(form->id & 0xFFu),
        (uint8_t)(form->id >> 8 & 0xFFu),
        (uint8_t)(form->id >> 16 & 0xFFu),
    };
    memcpy(frame, header, sizeof header);
    memcpy(frame + sizeof header, fields, payload_bytes);
    size_t length = sizeof header + payload_bytes;
    const uint16_t checksum = checksum_of(frame, length, form->crc_extra);
    frame[length++] = (uint8_t)(checksum & 0xFFu);
    frame[length++] = (uint8_t)(checksum >> 8);
    if (signs) {
        signing_before_send(signing, hal_time_us(channel->hal));
        length += sign(signing, frame, length);
    }
    return length;
}

bool channel_send(channel_t *channel, const message_form_t *form, const void *fields) {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    const size_t length = encode(channel, form, fields, bytes);
    if (hal_serial_write(channel->hal, channel->port, bytes, length) != length) {
        channel->dropped++;
        return false;
    }
    return true;
}

bool channel_has_space(const channel_t *channel, size_t bytes) {
    return hal_serial_write_space(channel->hal, channel->port) >= bytes;
}
