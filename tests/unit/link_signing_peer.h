/* A keyed board, and somebody who speaks to it: the right key or a wrong one, in time or not. */
#ifndef LINK_SIGNING_PEER_H
#define LINK_SIGNING_PEER_H

#include "link/ftp_codec.h"
#include "link/link.h"
#include "link_fixture.h"

#define CLOCK 0x0123456789A0u

static const uint8_t key[SIGNING_KEY_BYTES] = {1, 2, 3, 4, 5, 6, 7, 8};
static mavlink_signing_t sender;
static hal_port_t port;

typedef enum { UNSIGNED, OLD_PROTOCOL, WRONG, STALE, AHEAD, RIGHT, SENDERS } sender_t;
static sender_t now_is;

/* In front of the board's own clock, which a right frame takes along. */
static uint64_t next_time(void) { return signing_clock(&board.outbox.signing, hal.now_us) + 1u; }

static void become(sender_t kind) {
    now_is = kind;
    memset(&sender, 0, sizeof sender);
    memcpy(sender.secret_key, key, sizeof key);
    sender.flags = kind == UNSIGNED ? 0 : MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    sender.link_id = 7;
    sender.timestamp = next_time();
    sender.secret_key[31] ^= kind == WRONG ? 1 : 0;
    if (kind == STALE) {
        sender.timestamp = CLOCK - 1000u;
    } else if (kind == AHEAD) {
        sender.timestamp = board.outbox.signing.mark + 1u;
    }
    peer_tx.signing = &sender;
    peer_tx.flags = kind == OLD_PROTOCOL ? MAVLINK_STATUS_FLAG_OUT_MAVLINK1 : 0;
}

static void lock_board(void) {
    signing_set_key(&board.outbox.signing, key, CLOCK, hal.now_us);
    signing_mark(&board.outbox.signing, CLOCK + SIGNING_RESERVE_TICKS);
}

/* A second later, so that a refusal is told as text again. */
static void exchange(const mavlink_message_t *message) {
    hal.now_us += 1100000;
    poll();
    drain();
    peer_send(port, message);
    poll();
    peer_collect(port);
    if (now_is == RIGHT) {
        sender.timestamp = next_time();
    }
}

static void say_command(uint16_t command) {
    mavlink_message_t message;
    const mavlink_command_long_t fields = {
        .command = command, .param1 = 1.0f, .target_system = 1, .target_component = 1};
    mavlink_msg_command_long_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                           &fields);
    exchange(&message);
}

static void say_command_int(void) {
    mavlink_message_t message;
    const mavlink_command_int_t fields = {
        .command = TAILBEAT_CMD_COMMIT, .target_system = 1, .target_component = 1};
    mavlink_msg_command_int_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    exchange(&message);
}

static void say_param_set(float value) {
    mavlink_message_t message;
    const mavlink_param_set_t fields = {.param_value = value,
                                        .target_system = 1,
                                        .target_component = 1,
                                        .param_id = "ILC_LEAD",
                                        .param_type = MAV_PARAM_TYPE_REAL32};
    mavlink_msg_param_set_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    exchange(&message);
}

static void say_vision(void) {
    mavlink_message_t message;
    const mavlink_vision_speed_estimate_t fields = {.usec = 1, .x = 0.1f};
    mavlink_msg_vision_speed_estimate_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                    &fields);
    exchange(&message);
}

static void say_heartbeat(void) {
    mavlink_message_t message;
    const mavlink_heartbeat_t fields = {.type = MAV_TYPE_GCS};
    mavlink_msg_heartbeat_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    exchange(&message);
}

static void say_timesync(void) {
    mavlink_message_t message;
    const mavlink_timesync_t fields = {.ts1 = 5};
    mavlink_msg_timesync_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    exchange(&message);
}

static void say_param_read(void) {
    mavlink_message_t message;
    const mavlink_param_request_read_t fields = {
        .param_index = -1, .target_system = 1, .target_component = 1, .param_id = "ILC_LEAD"};
    mavlink_msg_param_request_read_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                 &fields);
    exchange(&message);
}

static void say_mission_list(void) {
    mavlink_message_t message;
    const mavlink_mission_request_list_t fields = {.target_system = 1, .target_component = 1};
    mavlink_msg_mission_request_list_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                   &fields);
    exchange(&message);
}

static void say_setup(const uint8_t *new_key, uint64_t time) {
    mavlink_message_t message;
    mavlink_msg_setup_signing_pack_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, 1, 1,
                                          new_key, time);
    exchange(&message);
}

/* Returns the opcode of the answer; 0 = none. |error| is its first data byte. */
static uint8_t say_ftp(uint8_t opcode, const char *path, uint8_t *error) {
    static uint16_t seq = 0;
    mavlink_message_t message;
    uint8_t payload[FTP_PAYLOAD_BYTES] = {0};
    seq = (uint16_t)(seq + 2u);
    bytes_put_u16(payload, seq);
    payload[2] = 9; /* session */
    payload[3] = opcode;
    payload[4] = (uint8_t)strlen(path);
    memcpy(payload + FTP_HEADER_BYTES, path, strlen(path));
    mavlink_msg_file_transfer_protocol_pack_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                   0, 1, 1, payload);
    exchange(&message);
    if (peer_count(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL) == 0) {
        return 0;
    }
    mavlink_file_transfer_protocol_t reply;
    mavlink_msg_file_transfer_protocol_decode(peer_find(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL),
                                              &reply);
    TEST_ASSERT_EQUAL_UINT16(seq + 1u, bytes_get_u16(reply.payload));
    *error = reply.payload[FTP_HEADER_BYTES];
    return reply.payload[3];
}

static bool has_text(const char *expected) {
    for (uint32_t i = 0; i < peer_inbox_count; i++) {
        char text[51] = "";
        if (peer_inbox[i].msgid == MAVLINK_MSG_ID_STATUSTEXT) {
            mavlink_msg_statustext_get_text(&peer_inbox[i], text);
            if (strcmp(text, expected) == 0) {
                return true;
            }
        }
    }
    return false;
}

#endif
