/* A host on the other end of the mocked board's line, made of the generated pack and parse code. */
#ifndef LINK_PEER_H
#define LINK_PEER_H

#include "link/mavlink.h"
#include "mock_hal.h"
#include "unity.h"

#include <string.h>

#define PEER_SYSTEM 255u
#define PEER_COMPONENT 190u
#define PEER_INBOX 256u

static hal_t hal;
static mavlink_status_t peer_tx; /* of the peer's own frames */
static mavlink_message_t peer_inbox[PEER_INBOX];
static uint32_t peer_inbox_count;

static inline void peer_reset(void) {
    mock_hal_init(&hal);
    memset(&peer_tx, 0, sizeof peer_tx);
    peer_inbox_count = 0;
}

static inline void peer_send(hal_port_t port, const mavlink_message_t *message) {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    mock_feed(&hal, port, bytes, mavlink_msg_to_send_buffer(bytes, message));
}

/* Replaces the inbox by all that the board has sent on |port|; every frame must be valid MAVLink 2.
 */
static inline void peer_collect(hal_port_t port) {
    mavlink_message_t parsing;
    mavlink_status_t status;
    memset(&status, 0, sizeof status);
    peer_inbox_count = 0;
    uint8_t byte = 0;
    while (mock_take(&hal, port, &byte, 1) == 1) {
        const uint8_t framing =
            mavlink_frame_char_buffer(&parsing, &status, byte, &peer_inbox[peer_inbox_count], NULL);
        TEST_ASSERT_NOT_EQUAL(MAVLINK_FRAMING_BAD_CRC, framing);
        if (framing == MAVLINK_FRAMING_OK) {
            TEST_ASSERT_EQUAL(MAVLINK_STX, peer_inbox[peer_inbox_count].magic);
            TEST_ASSERT_EQUAL(1, peer_inbox[peer_inbox_count].sysid);
            TEST_ASSERT_EQUAL(1, peer_inbox[peer_inbox_count].compid);
            peer_inbox_count++;
            TEST_ASSERT_LESS_THAN(PEER_INBOX, peer_inbox_count);
        }
    }
    TEST_ASSERT_LESS_OR_EQUAL(MAVLINK_PARSE_STATE_IDLE, status.parse_state);
}

static inline uint32_t peer_count(uint32_t message) {
    uint32_t count = 0;
    for (uint32_t i = 0; i < peer_inbox_count; i++) {
        count += peer_inbox[i].msgid == message ? 1 : 0;
    }
    return count;
}

/* The first such message of the inbox; the test fails when there is none. */
static inline const mavlink_message_t *peer_find(uint32_t message) {
    for (uint32_t i = 0; i < peer_inbox_count; i++) {
        if (peer_inbox[i].msgid == message) {
            return &peer_inbox[i];
        }
    }
    TEST_FAIL_MESSAGE("message not sent");
    return NULL;
}

/* Deterministic noise (xorshift32). */
static inline uint32_t peer_random(uint32_t *state) {
    *state ^= *state << 13;
    *state ^= *state >> 17;
    *state ^= *state << 5;
    return *state;
}

#endif
