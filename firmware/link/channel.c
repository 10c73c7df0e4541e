#include "link/channel.h"

#include "hal/clock.h"

#include <string.h>

#define V1_HEADER_BYTES 6u
#define V2_HEADER_BYTES 10u

void channel_init(channel_t *channel, hal_t *hal, hal_port_t port) {
    memset(channel, 0, sizeof *channel);
    channel->hal = hal;
    channel->port = port;
}

void channel_sign(channel_t *channel, signing_t *signing) {
    channel->signing = signing;
    channel->tx_status.signing = &signing->out;
}

mavlink_status_t *channel_packing(channel_t *channel) {
    if (channel->signing != NULL) {
        signing_before_send(channel->signing, hal_time_us(channel->hal));
    }
    return &channel->tx_status;
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
    const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(frame[5]);
    return entry != NULL && frame[1] == entry->min_msg_len
               ? V1_HEADER_BYTES + frame[1] + MAVLINK_NUM_CHECKSUM_BYTES
               : 0;
}

static size_t frame_bytes_v2(const uint8_t *frame) {
    const uint32_t id = (uint32_t)frame[7] | (uint32_t)frame[8] << 8 | (uint32_t)frame[9] << 16;
    const bool is_signed = (frame[2] & MAVLINK_IFLAG_SIGNED) != 0;
    if ((frame[2] & ~MAVLINK_IFLAG_SIGNED) != 0 || mavlink_get_msg_entry(id) == NULL) {
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

static bool decode(const channel_t *channel, size_t length, mavlink_message_t *message) {
    mavlink_message_t parsed;
    mavlink_status_t status;
    uint8_t framing = MAVLINK_FRAMING_INCOMPLETE;
    memset(&parsed, 0, sizeof parsed);
    memset(&status, 0, sizeof status);
    for (size_t i = 0; i < length; i++) {
        framing = mavlink_frame_char_buffer(&parsed, &status, channel->window[i], message, NULL);
    }
    return framing == MAVLINK_FRAMING_OK;
}

/* Looks through the window; what cannot be a frame is dropped. False when it takes more bytes. */
static bool find_message(channel_t *channel, mavlink_message_t *message) {
    for (drop_to_start_byte(channel); channel->held > 0; drop_to_start_byte(channel)) {
        const size_t length = frame_bytes(channel);
        if (length > channel->held) {
            return false;
        }
        if (length != 0 && decode(channel, length, message)) {
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
    if (taken > 0) {
        channel->last_byte_us = hal_time_us(channel->hal);
    }
    return taken;
}

static bool frame_stopped_coming(const channel_t *channel) {
    return channel->held > 0 &&
           hal_time_us(channel->hal) - channel->last_byte_us > CHANNEL_SILENCE_US;
}

bool channel_receive(channel_t *channel, mavlink_message_t *message) {
    size_t taken = 0;
    while (taken < CHANNEL_CALL_BYTES) {
        if (find_message(channel, message)) {
            return true;
        }
        const bool stopped = frame_stopped_coming(channel);
        const size_t more = fill(channel, CHANNEL_CALL_BYTES - taken);
        taken += more;
        if (more == 0 && !stopped) {
            return false;
        }
        if (stopped) {
            drop(channel, 1);
        }
    }
    return false;
}

bool channel_send(channel_t *channel, const mavlink_message_t *message) {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    const size_t length = mavlink_msg_to_send_buffer(bytes, message);
    if (hal_serial_write(channel->hal, channel->port, bytes, length) != length) {
        channel->dropped++;
        return false;
    }
    return true;
}

bool channel_has_space(const channel_t *channel, size_t bytes) {
    return hal_serial_write_space(channel->hal, channel->port) >= bytes;
}
