#include "link_fixture.h"
#include "target.h"

static mavlink_heartbeat_t heartbeat_of(state_t state, fault_t fault) {
    mavlink_heartbeat_t fields;
    status.state = state;
    status.fault = fault;
    poll_at(hal.now_us + 1000000);
    peer_collect(HAL_PORT_RADIO);
    mavlink_msg_heartbeat_decode(peer_find(MAVLINK_MSG_ID_HEARTBEAT), &fields);
    return fields;
}

static void test_heartbeat_tells_state_and_arming(void) {
    static const struct {
        state_t state;
        bool armed;
        uint8_t system_status;
    } cases[] = {
        {STATE_BOOT, false, MAV_STATE_BOOT},        {STATE_IDLE, false, MAV_STATE_STANDBY},
        {STATE_ARMED, true, MAV_STATE_ACTIVE},      {STATE_RUNNING, true, MAV_STATE_ACTIVE},
        {STATE_SETTLING, false, MAV_STATE_STANDBY}, {STATE_LEARNING, false, MAV_STATE_STANDBY},
        {STATE_ABORTED, false, MAV_STATE_CRITICAL}, {STATE_FAULT, false, MAV_STATE_CRITICAL},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const mavlink_heartbeat_t heartbeat = heartbeat_of(cases[i].state, FAULT_TILT);
        TEST_ASSERT_EQUAL(MAV_TYPE_GENERIC, heartbeat.type);
        TEST_ASSERT_EQUAL(MAV_AUTOPILOT_GENERIC, heartbeat.autopilot);
        TEST_ASSERT_EQUAL(3, heartbeat.mavlink_version);
        TEST_ASSERT_EQUAL(cases[i].armed ? 0x81 : 0x01, heartbeat.base_mode);
        TEST_ASSERT_EQUAL(cases[i].state, heartbeat.custom_mode);
        TEST_ASSERT_EQUAL(cases[i].system_status, heartbeat.system_status);
    }
}

static uint32_t sent_in_a_minute(hal_port_t port, uint32_t message) {
    uint32_t count = 0;
    for (uint32_t i = 0; i < 3000; i++) {
        if (i % 50 == 0) {
            send_heartbeat(HAL_PORT_RADIO, MAV_TYPE_GCS, PEER_SYSTEM);
        }
        poll_at(hal.now_us + 20000);
        peer_collect(port == HAL_PORT_RADIO ? HAL_PORT_CONSOLE : HAL_PORT_RADIO);
        peer_collect(port);
        count += peer_count(message);
    }
    return count;
}

static void test_rates_where_a_host_is_heard(void) {
    imu.counters.frames = 1;
    TEST_ASSERT_EQUAL(60, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_HEARTBEAT));
    TEST_ASSERT_EQUAL(60, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_TAILBEAT_STATUS));
    TEST_ASSERT_EQUAL(60, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_BATTERY_STATUS));
    TEST_ASSERT_EQUAL(60, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_ATTITUDE));
    TEST_ASSERT_EQUAL(300, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_TAILBEAT_LIVE));
    TEST_ASSERT_EQUAL(12, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_TAILBEAT_HEALTH));
    params.value[PARAM_TLM_RATE_HZ] = 0.0f;
    TEST_ASSERT_EQUAL(0, sent_in_a_minute(HAL_PORT_RADIO, MAVLINK_MSG_ID_TAILBEAT_LIVE));
}

static void test_a_silent_port_gets_heartbeats_only(void) {
    TEST_ASSERT_EQUAL(60, sent_in_a_minute(HAL_PORT_CONSOLE, MAVLINK_MSG_ID_HEARTBEAT));
    TEST_ASSERT_EQUAL(0, sent_in_a_minute(HAL_PORT_CONSOLE, MAVLINK_MSG_ID_TAILBEAT_STATUS));
    TEST_ASSERT_EQUAL(0, sent_in_a_minute(HAL_PORT_CONSOLE, MAVLINK_MSG_ID_TAILBEAT_LIVE));
}

static void test_telemetry_ends_ten_seconds_after_the_last_word(void) {
    poll_at(hal.now_us + OUTBOX_HEARD_US - 1);
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_TAILBEAT_STATUS));
    poll_at(hal.now_us + 1000000);
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_TAILBEAT_STATUS));
    TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_HEARTBEAT));
}

static void test_a_change_of_status_goes_out_at_once(void) {
    poll_at(hal.now_us + 1000);
    drain();
    TEST_ASSERT_EQUAL(0, peer_inbox_count);
    status.state = STATE_ARMED;
    status.next_trial = 12;
    memory.last_trial = 11;
    poll_at(hal.now_us + 1000);
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(1, peer_inbox_count);
    mavlink_tailbeat_status_t fields;
    mavlink_msg_tailbeat_status_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_STATUS), &fields);
    TEST_ASSERT_EQUAL(STATE_ARMED, fields.state);
    TEST_ASSERT_EQUAL(12, fields.next_trial);
    TEST_ASSERT_EQUAL(11, fields.last_learned_trial);
    TEST_ASSERT_EQUAL(1002, fields.time_boot_ms);
    TEST_ASSERT_TRUE(isnan(fields.best_max_abs_error_m_s));
    status.battery.mv++;
    poll_at(hal.now_us + 1000);
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(0, peer_inbox_count);
}

static void test_battery_and_attitude_for_other_programs(void) {
    uint16_t voltages[10];
    mavlink_attitude_t attitude;
    status.battery.mv = 7654;
    imu.counters.frames = 1;
    imu.last.ypr_deg[0] = 180.0f;
    imu.last.ypr_deg[1] = 45.0f;
    imu.last.ypr_deg[2] = -90.0f;
    imu.last.rate_rad_s[2] = 0.25f;
    poll_at(hal.now_us + 1000000);
    peer_collect(HAL_PORT_RADIO);
    mavlink_msg_battery_status_get_voltages(peer_find(MAVLINK_MSG_ID_BATTERY_STATUS), voltages);
    TEST_ASSERT_EQUAL(7654, voltages[0]);
    TEST_ASSERT_EQUAL(UINT16_MAX, voltages[1]);
    mavlink_msg_attitude_decode(peer_find(MAVLINK_MSG_ID_ATTITUDE), &attitude);
    TEST_ASSERT_EQUAL_FLOAT(3.14159265f, attitude.yaw);
    TEST_ASSERT_EQUAL_FLOAT(0.785398163f, attitude.pitch);
    TEST_ASSERT_EQUAL_FLOAT(-1.57079633f, attitude.roll);
    TEST_ASSERT_EQUAL_FLOAT(0.25f, attitude.yawspeed);
}

static void send_fish_heartbeat(uint8_t type) {
    mavlink_message_t message;
    const mavlink_heartbeat_t fields = {.type = type,
                                        .autopilot = MAV_AUTOPILOT_GENERIC,
                                        .base_mode = MAV_MODE_FLAG_CUSTOM_MODE_ENABLED};
    mavlink_msg_heartbeat_encode_status(2, 1, &peer_tx, &message, &fields);
    peer_send(HAL_PORT_CONSOLE, &message);
}

static void test_hands_heartbeats_on(void) {
    send_heartbeat(HAL_PORT_CONSOLE, MAV_TYPE_GCS, 250);
    poll();
    TEST_ASSERT_EQUAL(2, heartbeats);
    TEST_ASSERT_EQUAL(250, last_heartbeat_system);
    send_fish_heartbeat(MAV_TYPE_GENERIC);
    send_fish_heartbeat(MAV_TYPE_SUBMARINE); /* with earlier firmware */
    poll();
    TEST_ASSERT_EQUAL(2, heartbeats);
    send_heartbeat(HAL_PORT_CONSOLE, MAV_TYPE_GENERIC, 250); /* a script that is no vehicle */
    poll();
    TEST_ASSERT_EQUAL(3, heartbeats);
}

static void test_does_not_listen_to_its_own_echo(void) {
    mavlink_message_t message;
    const mavlink_heartbeat_t fields = {.type = MAV_TYPE_GCS};
    mavlink_msg_heartbeat_encode_status(1, 1, &peer_tx, &message, &fields);
    peer_send(HAL_PORT_CONSOLE, &message);
    poll_at(hal.now_us + 1000000);
    peer_collect(HAL_PORT_CONSOLE);
    TEST_ASSERT_EQUAL(1, heartbeats);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_TAILBEAT_STATUS));
}

static void send_timesync(int64_t tc1, int64_t ts1) {
    mavlink_message_t message;
    const mavlink_timesync_t fields = {.tc1 = tc1, .ts1 = ts1};
    mavlink_msg_timesync_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static void test_timesync(void) {
    mavlink_timesync_t fields;
    hal.now_us = 1500123;
    send_timesync(0, 123456789012345);
    mavlink_msg_timesync_decode(peer_find(MAVLINK_MSG_ID_TIMESYNC), &fields);
    TEST_ASSERT_EQUAL_INT64(1500123000, fields.tc1);
    TEST_ASSERT_EQUAL_INT64(123456789012345, fields.ts1);
    send_timesync(77, 88); /* an answer */
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_TIMESYNC));
}

static void send_vision(float speed, float variance) {
    mavlink_message_t message;
    const mavlink_vision_speed_estimate_t fields = {
        .usec = 123456, .x = speed, .covariance = {variance}};
    mavlink_msg_vision_speed_estimate_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                    &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
}

static void test_vision(void) {
    send_vision(0.05f, 0.0004f);
    TEST_ASSERT_EQUAL(1, visions);
    TEST_ASSERT_EQUAL_UINT64(123456, last_vision.time_us);
    TEST_ASSERT_EQUAL_FLOAT(0.05f, last_vision.speed_m_s);
    TEST_ASSERT_EQUAL_FLOAT(0.02f, last_vision.sigma_m_s);
    static const float not_given[] = {NAN, 0.0f, -1.0f, INFINITY};
    for (size_t i = 0; i < sizeof not_given / sizeof not_given[0]; i++) {
        send_vision(0.05f, not_given[i]);
        TEST_ASSERT_TRUE(isnan(last_vision.sigma_m_s));
    }
}

static void test_reports_a_beat_and_a_learning_step(void) {
    const link_beat_t beat = {.trial = 4,
                              .beat = 2,
                              .amplitude_rad = 0.3f,
                              .speed = {0.04f, 0.001f, 10, true},
                              .saturated = true};
    const link_learn_report_t report = {
        .trial = 4,
        .iteration = 3,
        .report = {.law = {.max_abs_error_m_s = 0.02f, .measured_beats = 40}, .rolled_back = true},
        .best_max_abs_error_m_s = 0.01f};
    link_beat(&board.outbox, &beat);
    learned = report;
    link_learned(&board.outbox, &learned);
    peer_collect(HAL_PORT_RADIO);
    mavlink_tailbeat_beat_t beat_fields;
    mavlink_msg_tailbeat_beat_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_BEAT), &beat_fields);
    TEST_ASSERT_EQUAL(3, beat_fields.flags);
    TEST_ASSERT_EQUAL(10, beat_fields.samples);
    mavlink_tailbeat_learn_report_t learned;
    mavlink_msg_tailbeat_learn_report_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT),
                                             &learned);
    TEST_ASSERT_EQUAL(4, learned.trial);
    TEST_ASSERT_EQUAL(TAILBEAT_LEARN_ROLLED_BACK, learned.flags);
    TEST_ASSERT_EQUAL_FLOAT(0.01f, learned.best_max_abs_error_m_s);
    peer_collect(HAL_PORT_CONSOLE);
    TEST_ASSERT_EQUAL(0, peer_inbox_count);
    send_command(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT, 0);
    mavlink_msg_tailbeat_learn_report_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT),
                                             &learned);
    TEST_ASSERT_EQUAL(4, learned.trial);
}

static void test_a_long_text_is_cut(void) {
    outbox_text(&board.outbox, MAV_SEVERITY_ERROR,
                "0123456789012345678901234567890123456789012345678901234567890");
    peer_collect(HAL_PORT_CONSOLE);
    expect_text(MAV_SEVERITY_ERROR, "0123456789012345678901234567890123456789012345678");
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_STATUSTEXT));
}

static void send_ftp(uint8_t opcode, uint16_t seq, uint8_t session, const char *path) {
    mavlink_message_t message;
    mavlink_file_transfer_protocol_t fields = {.target_system = 1, .target_component = 1};
    bytes_put_u16(fields.payload, seq);
    fields.payload[2] = session;
    fields.payload[3] = opcode;
    fields.payload[4] = path == NULL ? 239 : (uint8_t)strlen(path);
    if (path != NULL) {
        memcpy(fields.payload + 12, path, strlen(path));
    }
    mavlink_msg_file_transfer_protocol_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx,
                                                     &message, &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static uint8_t open_big_file(void) {
    static uint8_t bytes[20 * 239];
    memset(bytes, 'x', sizeof bytes);
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&store, "/trials/0001.ulg", bytes, sizeof bytes));
    send_ftp(4, 1, 0, "/trials/0001.ulg");
    uint8_t payload[FTP_PAYLOAD_BYTES];
    mavlink_msg_file_transfer_protocol_get_payload(peer_find(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL),
                                                   payload);
    TEST_ASSERT_EQUAL(128, payload[3]);
    return payload[2];
}

static void test_ftp_bursts_as_the_line_allows(void) {
    const uint8_t session = open_big_file();
    hal.tx_limit = 300; /* room for a packet, but not for the reserve */
    send_ftp(15, 2, session, NULL);
    poll();
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL));
    hal.tx_limit = LINK_LINE_MIN_BYTES - 1u; /* room for a whole block asked for meanwhile */
    send_ftp(5, 3, session, NULL);
    TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL));
    TEST_ASSERT_TRUE(board.ftp.session.bursting);
    hal.tx_limit = LINK_LINE_MIN_BYTES;
    uint32_t packets = 0;
    for (uint32_t i = 0; i < 30; i++) {
        poll();
        peer_collect(HAL_PORT_RADIO);
        packets += peer_count(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL);
    }
    TEST_ASSERT_EQUAL(20, packets);
    TEST_ASSERT_EQUAL(0, board.outbox.channel[0].dropped);
}

static void test_ftp_answers_its_asker(void) {
    send_ftp(3, 1, 0, "/");
    mavlink_file_transfer_protocol_t fields;
    mavlink_msg_file_transfer_protocol_decode(peer_find(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL),
                                              &fields);
    TEST_ASSERT_EQUAL(PEER_SYSTEM, fields.target_system);
    TEST_ASSERT_EQUAL(PEER_COMPONENT, fields.target_component);
    TEST_ASSERT_EQUAL(0, fields.target_network);
    peer_collect(HAL_PORT_CONSOLE);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL));
}

static void test_no_upload_while_a_trial_is_open(void) {
    uint8_t payload[FTP_PAYLOAD_BYTES];
    status.state = STATE_ABORTED;
    status.open_trial = 3;
    send_ftp(6, 1, 0, "/in/speeds.bin");
    mavlink_msg_file_transfer_protocol_get_payload(peer_find(MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL),
                                                   payload);
    TEST_ASSERT_EQUAL(129, payload[3]);
    TEST_ASSERT_EQUAL(9, payload[12]);
}

static void test_a_full_line_loses_messages_not_the_link(void) {
    hal.tx_limit = 5;
    poll_at(hal.now_us + 1000000);
    TEST_ASSERT_GREATER_THAN(0, board.outbox.channel[0].dropped);
    hal.tx_limit = 0;
    send_command(TAILBEAT_CMD_CLEAR, 0, 0);
    expect_answer(TAILBEAT_CMD_CLEAR, MAV_RESULT_ACCEPTED, FAULT_NONE);
}

/* Valid frames of every message we take, with random contents. */
static void test_random_contents_in_valid_frames(void) {
    static const uint32_t messages[] = {0, 23, 20, 21, 75, 76, 103, 110, 111};
    uint32_t random = 99;
    for (uint32_t i = 0; i < TIMES(20000u, 2000u); i++) {
        mavlink_message_t message;
        memset(&message, 0, sizeof message);
        message.msgid = messages[peer_random(&random) % 9] & 0xFFFFFFu;
        const mavlink_msg_entry_t *entry = mavlink_get_msg_entry(message.msgid);
        uint8_t *payload = (uint8_t *)_MAV_PAYLOAD_NON_CONST(&message);
        for (uint32_t k = 0; k < entry->max_msg_len; k++) {
            payload[k] = (uint8_t)(peer_random(&random) % 3 == 0 ? 1 : peer_random(&random));
        }
        mavlink_finalize_message_buffer(&message, PEER_SYSTEM, PEER_COMPONENT, &peer_tx,
                                        entry->min_msg_len, entry->max_msg_len, entry->crc_extra);
        peer_send(HAL_PORT_RADIO, &message);
        poll_at(hal.now_us + 1000);
        hal.tx[0].head = hal.tx[0].tail = 0;
        hal.tx[1].head = hal.tx[1].tail = 0;
    }
    TEST_ASSERT_EQUAL(0, board.outbox.channel[0].bad_frames);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_heartbeat_tells_state_and_arming);
    RUN_TEST(test_rates_where_a_host_is_heard);
    RUN_TEST(test_a_silent_port_gets_heartbeats_only);
    RUN_TEST(test_telemetry_ends_ten_seconds_after_the_last_word);
    RUN_TEST(test_a_change_of_status_goes_out_at_once);
    RUN_TEST(test_battery_and_attitude_for_other_programs);
    RUN_TEST(test_hands_heartbeats_on);
    RUN_TEST(test_does_not_listen_to_its_own_echo);
    RUN_TEST(test_timesync);
    RUN_TEST(test_vision);
    RUN_TEST(test_reports_a_beat_and_a_learning_step);
    RUN_TEST(test_a_long_text_is_cut);
    RUN_TEST(test_ftp_bursts_as_the_line_allows);
    RUN_TEST(test_ftp_answers_its_asker);
    RUN_TEST(test_no_upload_while_a_trial_is_open);
    RUN_TEST(test_a_full_line_loses_messages_not_the_link);
    RUN_TEST(test_random_contents_in_valid_frames);
    return UNITY_END();
}
