#include "link_fixture.h"

static void request_list(uint8_t system) {
    mavlink_message_t message;
    const mavlink_param_request_list_t fields = {.target_system = system, .target_component = 1};
    mavlink_msg_param_request_list_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                 &fields);
    peer_send(HAL_PORT_RADIO, &message);
}

static void test_lists_all_parameters_once(void) {
    bool seen[PARAM_COUNT] = {false};
    request_list(1);
    for (uint32_t i = 0; i < 20; i++) {
        poll();
    }
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(PARAM_COUNT, peer_count(MAVLINK_MSG_ID_PARAM_VALUE));
    for (uint32_t i = 0; i < peer_inbox_count; i++) {
        mavlink_param_value_t value;
        mavlink_msg_param_value_decode(&peer_inbox[i], &value);
        TEST_ASSERT_LESS_THAN(PARAM_COUNT, value.param_index);
        TEST_ASSERT_FALSE(seen[value.param_index]);
        seen[value.param_index] = true;
        TEST_ASSERT_EQUAL(PARAM_COUNT, value.param_count);
        TEST_ASSERT_EQUAL(MAV_PARAM_TYPE_REAL32, value.param_type);
        TEST_ASSERT_EQUAL(
            0, strncmp(value.param_id, param_info((param_t)value.param_index)->name, 16));
        TEST_ASSERT_EQUAL_FLOAT(params.value[value.param_index], value.param_value);
    }
}

static void test_the_list_waits_for_the_line(void) {
    hal.tx_limit = 130; /* less than a PARAM_VALUE and the reserve */
    request_list(0);
    poll();
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_PARAM_VALUE));
    hal.tx_limit = 0;
    for (uint32_t i = 0; i < 20; i++) {
        poll();
    }
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL(PARAM_COUNT, peer_count(MAVLINK_MSG_ID_PARAM_VALUE));
    TEST_ASSERT_EQUAL(0, board.outbox.channel[0].dropped);
}

static void request_read(int16_t index, const char *name) {
    mavlink_message_t message;
    mavlink_param_request_read_t fields = {
        .param_index = index, .target_system = 1, .target_component = 1};
    memcpy(fields.param_id, name, strlen(name));
    mavlink_msg_param_request_read_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                 &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static void expect_value(param_t param, float expected) {
    mavlink_param_value_t value;
    mavlink_msg_param_value_decode(peer_find(MAVLINK_MSG_ID_PARAM_VALUE), &value);
    TEST_ASSERT_EQUAL(param, value.param_index);
    TEST_ASSERT_EQUAL_FLOAT(expected, value.param_value);
}

static void expect_error(uint8_t expected) {
    mavlink_param_error_t error;
    mavlink_msg_param_error_decode(peer_find(MAVLINK_MSG_ID_PARAM_ERROR), &error);
    TEST_ASSERT_EQUAL(expected, error.error);
    TEST_ASSERT_EQUAL(PEER_SYSTEM, error.target_system);
}

static void test_reads_one_parameter(void) {
    request_read(-1, "ILC_GAIN");
    expect_value(PARAM_ILC_GAIN, 4.0f);
    request_read(PARAM_ILC_LEAD, "");
    expect_value(PARAM_ILC_LEAD, 1.0f);
    request_read(-1, "SERVO_SLEW_RAD_S"); /* all 16 characters, no zero */
    expect_value(PARAM_SERVO_SLEW_RAD_S, 0.0f);
    request_read(-1, "NO_SUCH_THING_16");
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
    request_read(PARAM_COUNT, "");
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
    request_read(-2, "ILC_GAIN");
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
}

static void set_param(const char *name, float value) {
    mavlink_message_t message;
    mavlink_param_set_t fields = {.param_value = value,
                                  .target_system = 1,
                                  .target_component = 1,
                                  .param_type = MAV_PARAM_TYPE_REAL32};
    memcpy(fields.param_id, name, strlen(name));
    mavlink_msg_param_set_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message, &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static void test_sets_a_parameter(void) {
    set_param("ILC_GAIN", 5.5f);
    expect_value(PARAM_ILC_GAIN, 5.5f);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_PARAM_ERROR));
    TEST_ASSERT_EQUAL_FLOAT(5.5f, params.value[PARAM_ILC_GAIN]);
}

static void test_a_refused_parameter_stays_and_says_why(void) {
    verdict = FAULT_WRONG_STATE;
    set_param("ILC_GAIN", 5.5f);
    expect_error(MAV_PARAM_ERROR_PERMISSION_DENIED);
    expect_value(PARAM_ILC_GAIN, 4.0f);
    expect_text(MAV_SEVERITY_WARNING, fault_info(FAULT_WRONG_STATE)->meaning);
    verdict = FAULT_NONE;
    set_param("ILC_GAIN", 1e9f);
    expect_error(MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE);
    set_param("ILC_GAIN", NAN);
    expect_error(MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE);
    expect_value(PARAM_ILC_GAIN, 4.0f);
    set_param("NOT_THERE", 1.0f);
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
}

static void test_an_old_name_is_refused_with_the_new_one(void) {
    set_param("LAW_FADE_FROM", 7.0f);
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
    expect_text(MAV_SEVERITY_WARNING, "LAW_FADE_FROM is now ILC_DECR_FROM");
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_PARAM_VALUE));
    TEST_ASSERT_EQUAL_FLOAT(5.0f, params.value[PARAM_ILC_DECR_FROM]);
    request_read(-1, "GLIDE_S");
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
    expect_text(MAV_SEVERITY_WARNING, "GLIDE_S is now COAST_S");
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_PARAM_VALUE));
}

static void test_an_unknown_name_has_no_new_one(void) {
    request_read(-1, "LAW_NONE");
    expect_error(MAV_PARAM_ERROR_DOES_NOT_EXIST);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_STATUSTEXT));
    set_param("LAW_NONE", 1.0f);
    expect_text(MAV_SEVERITY_WARNING, fault_info(FAULT_BAD_PARAM)->meaning);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_lists_all_parameters_once);
    RUN_TEST(test_the_list_waits_for_the_line);
    RUN_TEST(test_reads_one_parameter);
    RUN_TEST(test_sets_a_parameter);
    RUN_TEST(test_a_refused_parameter_stays_and_says_why);
    RUN_TEST(test_an_old_name_is_refused_with_the_new_one);
    RUN_TEST(test_an_unknown_name_has_no_new_one);
    return UNITY_END();
}
