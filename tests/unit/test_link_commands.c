#include "link_fixture.h"

static void test_commands_reach_the_application(void) {
    static const struct {
        uint16_t command;
        float param1;
        link_command_id_t id;
    } cases[] = {
        {MAV_CMD_COMPONENT_ARM_DISARM, 1, LINK_COMMAND_ARM},
        {MAV_CMD_COMPONENT_ARM_DISARM, 0, LINK_COMMAND_DISARM},
        {MAV_CMD_PREFLIGHT_STORAGE, 0, LINK_COMMAND_PARAMS_LOAD},
        {MAV_CMD_PREFLIGHT_STORAGE, 1, LINK_COMMAND_PARAMS_SAVE},
        {MAV_CMD_PREFLIGHT_STORAGE, 2, LINK_COMMAND_PARAMS_RESET},
        {MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1, LINK_COMMAND_REBOOT},
        {TAILBEAT_CMD_TRIAL_START, 7, LINK_COMMAND_START},
        {TAILBEAT_CMD_TRIAL_ABORT, 0, LINK_COMMAND_ABORT},
        {TAILBEAT_CMD_LEARN, 16777216, LINK_COMMAND_LEARN},
        {TAILBEAT_CMD_DISCARD, 7, LINK_COMMAND_DISCARD},
        {TAILBEAT_CMD_RESTORE_BEST, 0, LINK_COMMAND_RESTORE_BEST},
        {TAILBEAT_CMD_CLEAR, 0, LINK_COMMAND_CLEAR},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        send_command(cases[i].command, cases[i].param1, 12.5f);
        TEST_ASSERT_EQUAL(i + 1, commands);
        TEST_ASSERT_EQUAL(cases[i].id, last_command.id);
        TEST_ASSERT_EQUAL(HAL_PORT_RADIO, last_command.port);
        TEST_ASSERT_EQUAL(PEER_SYSTEM, last_command.system);
        TEST_ASSERT_EQUAL(PEER_COMPONENT, last_command.component);
        expect_answer(cases[i].command, MAV_RESULT_ACCEPTED, FAULT_NONE);
        TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_STATUSTEXT));
    }
}

/* A reason that is none stops the tail all the same. */
static void test_an_abort_carries_its_reason(void) {
    static const float others[] = {0.0f, 0.5f, 2.0f, -1.0f, 1e30f, NAN, INFINITY};
    send_command(TAILBEAT_CMD_TRIAL_ABORT, (float)TAILBEAT_ABORT_WALL, 0.0f);
    TEST_ASSERT_EQUAL(LINK_COMMAND_ABORT, last_command.id);
    TEST_ASSERT_TRUE(last_command.wall);
    for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
        send_command(TAILBEAT_CMD_TRIAL_ABORT, others[i], 0.0f);
        TEST_ASSERT_EQUAL(LINK_COMMAND_ABORT, last_command.id);
        TEST_ASSERT_FALSE(last_command.wall);
        expect_answer(TAILBEAT_CMD_TRIAL_ABORT, MAV_RESULT_ACCEPTED, FAULT_NONE);
    }
    send_command(MAV_CMD_COMPONENT_ARM_DISARM, 1.0f, 0.0f);
    TEST_ASSERT_FALSE(last_command.wall);
}

/* Other programs send whatever they like there: they arm as ever. */
static void test_arming_carries_how_long_to_blink(void) {
    static const struct {
        float param3, blink_s;
    } cases[] = {{0.0f, 0.0f},  {5.0f, 5.0f},  {0.25f, 0.25f}, {60.0f, 60.0f},   {60.001f, 0.0f},
                 {-1.0f, 0.0f}, {1e30f, 0.0f}, {NAN, 0.0f},    {INFINITY, 0.0f}, {-INFINITY, 0.0f}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        send_command3(MAV_CMD_COMPONENT_ARM_DISARM, 1.0f, 0.0f, cases[i].param3);
        TEST_ASSERT_EQUAL(LINK_COMMAND_ARM, last_command.id);
        TEST_ASSERT_EQUAL_FLOAT(cases[i].blink_s, last_command.blink_s);
        expect_answer(MAV_CMD_COMPONENT_ARM_DISARM, MAV_RESULT_ACCEPTED, FAULT_NONE);
    }
}

static void test_start_carries_trial_and_time(void) {
    send_command(TAILBEAT_CMD_TRIAL_START, 7, 12.5f);
    TEST_ASSERT_EQUAL(7, last_command.trial);
    TEST_ASSERT_EQUAL_FLOAT(12.5f, last_command.issued_s);
    send_command(TAILBEAT_CMD_TRIAL_START, 8, NAN);
    TEST_ASSERT_EQUAL(8, last_command.trial);
    TEST_ASSERT_TRUE(isnan(last_command.issued_s));
}

static void test_values_that_mean_nothing_are_denied(void) {
    static const struct {
        uint16_t command;
        float param1, param2;
    } cases[] = {
        {TAILBEAT_CMD_TRIAL_START, 0, 1},
        {TAILBEAT_CMD_TRIAL_START, -1, 1},
        {TAILBEAT_CMD_TRIAL_START, 1.5f, 1},
        {TAILBEAT_CMD_TRIAL_START, NAN, 1},
        {TAILBEAT_CMD_TRIAL_START, INFINITY, 1},
        {TAILBEAT_CMD_TRIAL_START, 1e30f, 1},
        {TAILBEAT_CMD_TRIAL_START, 1, INFINITY},
        {TAILBEAT_CMD_LEARN, 0, 0},
        {TAILBEAT_CMD_LEARN, NAN, 0},
        {TAILBEAT_CMD_DISCARD, -3, 0},
        {MAV_CMD_COMPONENT_ARM_DISARM, 2, 0},
        {MAV_CMD_COMPONENT_ARM_DISARM, 0.5f, 0},
        {MAV_CMD_COMPONENT_ARM_DISARM, NAN, 0},
        {MAV_CMD_PREFLIGHT_STORAGE, 3, 0},
        {MAV_CMD_PREFLIGHT_STORAGE, -1, 0},
        {MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 0, 0},
        {MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 2, 0},
        {MAV_CMD_REQUEST_MESSAGE, -1, 0},
        {MAV_CMD_REQUEST_MESSAGE, NAN, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        send_command(cases[i].command, cases[i].param1, cases[i].param2);
        expect_answer(cases[i].command, MAV_RESULT_DENIED, FAULT_BAD_DATA);
        expect_text(MAV_SEVERITY_WARNING, fault_info(FAULT_BAD_DATA)->meaning);
    }
    TEST_ASSERT_EQUAL(0, commands);
}

static void test_a_refusal_says_why(void) {
    verdict = FAULT_BATTERY_LOW;
    send_command(MAV_CMD_COMPONENT_ARM_DISARM, 1, 0);
    expect_answer(MAV_CMD_COMPONENT_ARM_DISARM, MAV_RESULT_TEMPORARILY_REJECTED, FAULT_BATTERY_LOW);
    expect_text(MAV_SEVERITY_WARNING, "battery too low to arm");
    verdict = FAULT_BAD_FILE;
    send_command(TAILBEAT_CMD_LEARN, 1, 0);
    expect_answer(TAILBEAT_CMD_LEARN, MAV_RESULT_DENIED, FAULT_BAD_FILE);
}

static void test_unknown_commands_are_unsupported_without_a_text(void) {
    send_command(MAV_CMD_NAV_TAKEOFF, 1, 0);
    expect_answer(MAV_CMD_NAV_TAKEOFF, MAV_RESULT_UNSUPPORTED, FAULT_UNKNOWN_COMMAND);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_STATUSTEXT));
    send_command(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_GPS_RAW_INT, 0);
    expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_UNSUPPORTED, FAULT_UNKNOWN_COMMAND);
}

static void send_command_to(uint8_t system, uint8_t component) {
    mavlink_message_t message;
    const mavlink_command_long_t fields = {
        .command = TAILBEAT_CMD_CLEAR, .target_system = system, .target_component = component};
    mavlink_msg_command_long_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                           &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
}

static void test_commands_for_others_are_not_taken(void) {
    send_command_to(1, 0);
    TEST_ASSERT_EQUAL(1, commands);
    send_command_to(2, 1);
    send_command_to(0, 0);
    send_command_to(0, 1);
    send_command_to(1, 2);
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(1, commands);
    TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_COMMAND_ACK));
}

static void send_commit(float file, int32_t length, int32_t crc) {
    mavlink_message_t message;
    const mavlink_command_int_t fields = {.command = TAILBEAT_CMD_COMMIT,
                                          .param1 = file,
                                          .x = length,
                                          .y = crc,
                                          .target_system = 1,
                                          .target_component = 1};
    mavlink_msg_command_int_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static void test_commit_comes_as_command_int(void) {
    send_commit(1, 172, (int32_t)0xFEDCBA98u);
    expect_answer(TAILBEAT_CMD_COMMIT, MAV_RESULT_ACCEPTED, FAULT_NONE);
    TEST_ASSERT_EQUAL(LINK_COMMAND_COMMIT, last_command.id);
    TEST_ASSERT_EQUAL(VAULT_UPLOAD_AMPLITUDES, last_command.file);
    TEST_ASSERT_EQUAL(172, last_command.length_bytes);
    TEST_ASSERT_EQUAL_HEX32(0xFEDCBA98u, last_command.crc);
    send_commit(4, 172, 0);
    expect_answer(TAILBEAT_CMD_COMMIT, MAV_RESULT_DENIED, FAULT_BAD_DATA);
    send_commit(0, -1, 0);
    expect_answer(TAILBEAT_CMD_COMMIT, MAV_RESULT_DENIED, FAULT_BAD_DATA);
    send_command(TAILBEAT_CMD_COMMIT, 0, 0);
    expect_answer(TAILBEAT_CMD_COMMIT, MAV_RESULT_COMMAND_INT_ONLY, FAULT_BAD_FORMAT);
    TEST_ASSERT_EQUAL(1, commands);
}

static void test_reports_its_version(void) {
    mavlink_autopilot_version_t fields;
    send_command(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_AUTOPILOT_VERSION, 0);
    TEST_ASSERT_EQUAL(MAVLINK_MSG_ID_COMMAND_ACK, peer_inbox[0].msgid);
    expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_ACCEPTED, FAULT_NONE);
    mavlink_msg_autopilot_version_decode(peer_find(MAVLINK_MSG_ID_AUTOPILOT_VERSION), &fields);
    TEST_ASSERT_EQUAL_HEX32(0x22028, fields.capabilities);
    TEST_ASSERT_EQUAL_HEX32(0x00010000, fields.flight_sw_version);
    TEST_ASSERT_EQUAL(2, fields.board_version);
    TEST_ASSERT_EQUAL(2, fields.product_id);
    TEST_ASSERT_EQUAL_MEMORY("mocked-board-001\0\0", fields.uid2, 18);
    char expected[51];
    snprintf(expected, sizeof expected, "tailbeat %.40s", link_build_id());
    expect_text(MAV_SEVERITY_INFO, expected);
    char hash[9] = "";
    memcpy(hash, fields.flight_custom_version, 8);
    TEST_ASSERT_NOT_NULL(strstr(link_build_id(), hash));
}

static void test_messages_on_request(void) {
    static const uint32_t messages[] = {
        MAVLINK_MSG_ID_HEARTBEAT, MAVLINK_MSG_ID_TAILBEAT_STATUS, MAVLINK_MSG_ID_TAILBEAT_HEALTH,
        MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT, MAVLINK_MSG_ID_BATTERY_STATUS};
    for (size_t i = 0; i < sizeof messages / sizeof messages[0]; i++) {
        send_command(MAV_CMD_REQUEST_MESSAGE, (float)messages[i], 0);
        expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_ACCEPTED, FAULT_NONE);
        TEST_ASSERT_EQUAL(1, peer_count(messages[i]));
    }
}

static void test_health_counts(void) {
    mavlink_tailbeat_health_t fields;
    hal.serial_errors[HAL_PORT_RADIO].overruns = 3;
    hal.serial_errors[HAL_PORT_IMU].overruns = 4;
    hal.reset_cause = HAL_RESET_WATCHDOG;
    board.outbox.channel[0].bad_frames = 1;
    board.outbox.channel[1].bad_frames = 2;
    store.failures = 9;
    status.speed_counters = (speed_counters_t){10, 1, 2, 3};
    send_command(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_TAILBEAT_HEALTH, 0);
    mavlink_msg_tailbeat_health_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_HEALTH), &fields);
    TEST_ASSERT_EQUAL(7, fields.serial_overruns);
    TEST_ASSERT_EQUAL(3, fields.link_bad_frames);
    TEST_ASSERT_EQUAL(10, fields.vision_accepted);
    TEST_ASSERT_EQUAL(6, fields.vision_rejected);
    TEST_ASSERT_EQUAL(9, fields.store_failures);
    TEST_ASSERT_EQUAL(store_free_bytes(&store), fields.store_free_bytes);
    TEST_ASSERT_EQUAL(HAL_RESET_WATCHDOG, fields.reset_cause);
}

static mavlink_tailbeat_amplitudes_t request_set(float first, float set) {
    mavlink_tailbeat_amplitudes_t piece;
    send_command3(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES, first, set);
    mavlink_msg_tailbeat_amplitudes_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES), &piece);
    return piece;
}

static mavlink_tailbeat_amplitudes_t request_amplitudes(float first) {
    return request_set(first, TAILBEAT_AMPLITUDE_SET_NEXT);
}

static void test_the_sets_of_amplitudes(void) {
    memory.beats = 40;
    memory.iteration = 3;
    memory.best_iteration = 2;
    memory.amplitude_rad[33] = 0.1f;
    memory.best_rad[33] = 0.2f;
    memory.visits[33] = 255;
    TEST_ASSERT_EQUAL_FLOAT(0.1f, request_set(32, TAILBEAT_AMPLITUDE_SET_NEXT).amplitude_rad[1]);
    mavlink_tailbeat_amplitudes_t piece = request_set(32, TAILBEAT_AMPLITUDE_SET_BEST);
    TEST_ASSERT_EQUAL_FLOAT(0.2f, piece.amplitude_rad[1]);
    TEST_ASSERT_EQUAL(2, piece.iteration);
    piece = request_set(32, TAILBEAT_AMPLITUDE_SET_VISITS);
    TEST_ASSERT_EQUAL_FLOAT(255.0f, piece.amplitude_rad[1]);
    TEST_ASSERT_EQUAL(TAILBEAT_AMPLITUDE_SET_VISITS, piece.set);
    TEST_ASSERT_EQUAL(3, piece.iteration);
    memory.peaks = (judge_peaks_t){.count = 1, .beat = {33}, .error_m_s = {0.03f}};
    piece = request_set(32, TAILBEAT_AMPLITUDE_SET_PEAKS);
    TEST_ASSERT_EQUAL_FLOAT(0.03f, piece.amplitude_rad[1]);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, piece.amplitude_rad[0]);
    send_command3(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES, 0,
                  TAILBEAT_AMPLITUDE_SET_PEAKS + 1);
    expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_DENIED, FAULT_BAD_DATA);
}

static void test_amplitudes_in_pieces(void) {
    mavlink_tailbeat_amplitudes_t piece = request_amplitudes(0);
    TEST_ASSERT_EQUAL(0, piece.count); /* no reference yet */
    memory.beats = 40;
    memory.iteration = 3;
    memory.reference_crc = 0x12345678;
    for (uint32_t i = 0; i < 40; i++) {
        memory.amplitude_rad[i] = 0.01f * (float)i;
    }
    piece = request_amplitudes(0);
    TEST_ASSERT_EQUAL(32, piece.count);
    TEST_ASSERT_EQUAL(40, piece.beats);
    TEST_ASSERT_EQUAL(3, piece.iteration);
    TEST_ASSERT_EQUAL_HEX32(0x12345678, piece.reference_crc);
    TEST_ASSERT_EQUAL_FLOAT(0.31f, piece.amplitude_rad[31]);
    piece = request_amplitudes(32);
    TEST_ASSERT_EQUAL(8, piece.count);
    TEST_ASSERT_EQUAL(32, piece.first);
    TEST_ASSERT_EQUAL_FLOAT(0.39f, piece.amplitude_rad[7]);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, piece.amplitude_rad[8]);
    send_command(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES, 40);
    expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_DENIED, FAULT_BAD_DATA);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_commands_reach_the_application);
    RUN_TEST(test_an_abort_carries_its_reason);
    RUN_TEST(test_arming_carries_how_long_to_blink);
    RUN_TEST(test_start_carries_trial_and_time);
    RUN_TEST(test_values_that_mean_nothing_are_denied);
    RUN_TEST(test_a_refusal_says_why);
    RUN_TEST(test_unknown_commands_are_unsupported_without_a_text);
    RUN_TEST(test_commands_for_others_are_not_taken);
    RUN_TEST(test_commit_comes_as_command_int);
    RUN_TEST(test_reports_its_version);
    RUN_TEST(test_messages_on_request);
    RUN_TEST(test_health_counts);
    RUN_TEST(test_the_sets_of_amplitudes);
    RUN_TEST(test_amplitudes_in_pieces);
    return UNITY_END();
}
