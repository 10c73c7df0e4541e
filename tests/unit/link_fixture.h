/* A link on the mocked board with a recording application above it and a host on the radio. */
#ifndef LINK_FIXTURE_H
#define LINK_FIXTURE_H

#include "base/crc.h"
#include "link/link.h"
#include "link_peer.h"
#include "store/bytes.h"

#include <math.h>
#include <stdio.h>

static store_t store;
static params_t params;
static link_t board;
static link_status_t status;
static memory_t memory;
static imu_t imu;
static link_learn_report_t learned; /* the last one */

/* What the application's side was asked. */
static link_command_t last_command;
static uint32_t commands, visions, heartbeats, key_settings;
static fault_t verdict; /* on the next command or parameter */
static link_vision_t last_vision;
static uint8_t last_heartbeat_system;

static inline fault_t on_command(void *context, const link_command_t *command) {
    TEST_ASSERT_EQUAL_PTR(&board, context);
    last_command = *command;
    commands++;
    return verdict;
}

static inline fault_t on_param_set(void *context, param_t param, float value) {
    (void)context;
    TEST_ASSERT_TRUE(isfinite(value));
    if (verdict != FAULT_NONE) {
        return verdict;
    }
    return params_set(&params, param, value) == PARAM_OK ? FAULT_NONE : FAULT_BAD_PARAM;
}

static inline void on_vision(void *context, const link_vision_t *sample) {
    (void)context;
    last_vision = *sample;
    visions++;
}

static inline fault_t on_set_key(void *context, const uint8_t *key, uint64_t time) {
    (void)context;
    (void)key;
    (void)time;
    key_settings++;
    return verdict;
}

static inline void on_heartbeat(void *context, hal_port_t port, uint8_t system, uint8_t component) {
    (void)context;
    TEST_ASSERT_TRUE(port == HAL_PORT_RADIO || port == HAL_PORT_CONSOLE);
    TEST_ASSERT_EQUAL(PEER_COMPONENT, component);
    last_heartbeat_system = system;
    heartbeats++;
}

static inline void poll_at(uint64_t now_us) {
    hal.now_us = now_us;
    link_poll(&board, &status);
}

static inline void poll(void) { poll_at(hal.now_us); }

static inline void drain(void) {
    peer_collect(HAL_PORT_CONSOLE);
    peer_collect(HAL_PORT_RADIO);
}

static inline void send_heartbeat(hal_port_t port, uint8_t type, uint8_t system) {
    mavlink_message_t message;
    const mavlink_heartbeat_t fields = {.type = type, .autopilot = MAV_AUTOPILOT_INVALID};
    mavlink_msg_heartbeat_encode_status(system, PEER_COMPONENT, &peer_tx, &message, &fields);
    peer_send(port, &message);
}

/* Starts with a host heard on the radio, nothing due, nothing in the inbox. */
void setUp(void) {
    const link_handlers_t handlers = {
        .context = &board,
        .command = on_command,
        .param_set = on_param_set,
        .vision = on_vision,
        .set_key = on_set_key,
        .heartbeat = on_heartbeat,
    };
    peer_reset();
    memset(&store, 0, sizeof store);
    memset(&status, 0, sizeof status);
    memset(&memory, 0, sizeof memory);
    memset(&imu, 0, sizeof imu);
    memset(&learned, 0, sizeof learned);
    TEST_ASSERT_EQUAL(STORE_OK, store_mount(&store, &hal));
    params_reset(&params);
    status.state = STATE_IDLE;
    status.memory = &memory;
    status.learned = &learned;
    status.imu = &imu;
    status.speed_m_s = NAN;
    link_init(&board, &hal, &store, &params, &handlers);
    verdict = FAULT_NONE;
    commands = visions = heartbeats = key_settings = 0;
    send_heartbeat(HAL_PORT_RADIO, MAV_TYPE_GCS, PEER_SYSTEM);
    poll_at(1000000);
    drain();
}

void tearDown(void) {}

static inline void send_command3(uint16_t command, float param1, float param2, float param3) {
    mavlink_message_t message;
    const mavlink_command_long_t fields = {.command = command,
                                           .param1 = param1,
                                           .param2 = param2,
                                           .param3 = param3,
                                           .target_system = 1,
                                           .target_component = 1};
    mavlink_msg_command_long_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                           &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static inline void send_command(uint16_t command, float param1, float param2) {
    send_command3(command, param1, param2, 0.0f);
}

static inline void expect_answer(uint16_t command, uint8_t result, fault_t fault) {
    const mavlink_message_t *message = peer_find(MAVLINK_MSG_ID_COMMAND_ACK);
    mavlink_command_ack_t ack;
    mavlink_msg_command_ack_decode(message, &ack);
    TEST_ASSERT_EQUAL(command, ack.command);
    TEST_ASSERT_EQUAL(result, ack.result);
    TEST_ASSERT_EQUAL(fault, ack.result_param2);
    TEST_ASSERT_EQUAL(PEER_SYSTEM, ack.target_system);
    TEST_ASSERT_EQUAL(PEER_COMPONENT, ack.target_component);
}

static inline void expect_text(uint8_t severity, const char *expected) {
    char text[51] = "";
    const mavlink_message_t *message = peer_find(MAVLINK_MSG_ID_STATUSTEXT);
    mavlink_msg_statustext_get_text(message, text);
    TEST_ASSERT_EQUAL_STRING(expected, text);
    TEST_ASSERT_EQUAL(severity, mavlink_msg_statustext_get_severity(message));
}

#endif
