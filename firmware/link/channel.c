#include "link/channel.h"

#include <string.h>

void channel_init(channel_t *channel, hal_t *hal, hal_port_t port) {
    memset(channel, 0, sizeof *channel);
    channel->hal = hal;
    channel->port = port;
}

static bool next_byte(channel_t *channel, uint8_t *byte) {
    if (channel->chunk_used == channel->chunk_held) {
        channel->chunk_used = 0;
        channel->chunk_held = (uint8_t)hal_serial_read(channel->hal, channel->port, channel->chunk,
                                                       CHANNEL_CHUNK_BYTES);
        if (channel->chunk_held == 0) {
            return false;
        }
    }
    *byte = channel->chunk[channel->chunk_used++];
    return true;
}

static uint8_t parse(channel_t *channel, uint8_t byte, mavlink_message_t *message) {
    return mavlink_frame_char_buffer(&channel->rx_message, &channel->rx_status, byte, message,
                                     NULL);
}

/* When bytes were lost, the byte taken for the end of the bad frame may begin the next one. */
static void reject(channel_t *channel, uint8_t last_byte, mavlink_message_t *message) {
    if (mavlink_get_msg_entry(channel->rx_message.msgid) != NULL) {
        channel->bad_frames++;
    }
    (void)parse(channel, last_byte, message);
}

bool channel_receive(channel_t *channel, mavlink_message_t *message) {
    for (uint32_t taken = 0; taken < CHANNEL_CALL_BYTES; taken++) {
        uint8_t byte = 0;
        if (!next_byte(channel, &byte)) {
            return false;
        }
        const uint8_t framing = parse(channel, byte, message);
        if (framing == MAVLINK_FRAMING_OK) {
            return true;
        }
        if (framing != MAVLINK_FRAMING_INCOMPLETE) {
            reject(channel, byte, message);
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
