/* What ground stations ask when they connect, and the rates they choose. */
#include "base/crc.h"
#include "link/metadata.h"
#include "link_fixture.h"

static void ask_for(uint32_t message, float index) {
    send_command(MAV_CMD_REQUEST_MESSAGE, (float)message, index);
}

static void test_where_the_parameters_are_described(void) {
    mavlink_component_metadata_t fields;
    ask_for(MAVLINK_MSG_ID_COMPONENT_METADATA, 0);
    expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_ACCEPTED, FAULT_NONE);
    mavlink_msg_component_metadata_decode(peer_find(MAVLINK_MSG_ID_COMPONENT_METADATA), &fields);
    TEST_ASSERT_EQUAL_STRING("mftp:///general.json", fields.uri);
    const link_file_bytes_t *general = &link_metadata[0];
    TEST_ASSERT_EQUAL_HEX32(crc32_update(0, general->bytes, general->size), fields.file_crc);
}

static void test_each_state_is_a_mode(void) {
    mavlink_available_modes_t fields;
    for (uint32_t mode = 0; mode < STATE_COUNT; mode++) {
        ask_for(MAVLINK_MSG_ID_AVAILABLE_MODES, (float)(mode + 1u));
        TEST_ASSERT_EQUAL(1, peer_count(MAVLINK_MSG_ID_AVAILABLE_MODES));
        mavlink_msg_available_modes_decode(peer_find(MAVLINK_MSG_ID_AVAILABLE_MODES), &fields);
        TEST_ASSERT_EQUAL(STATE_COUNT, fields.number_modes);
        TEST_ASSERT_EQUAL(mode + 1u, fields.mode_index);
        TEST_ASSERT_EQUAL(mode, fields.custom_mode);
        TEST_ASSERT_EQUAL_STRING(state_name((state_t)mode), fields.mode_name);
    }
}

static void test_all_modes_at_once(void) {
    ask_for(MAVLINK_MSG_ID_AVAILABLE_MODES, 0);
    TEST_ASSERT_EQUAL(STATE_COUNT, peer_count(MAVLINK_MSG_ID_AVAILABLE_MODES));
}

/* QGroundControl waits for the last mode without a time-out. */
static void test_all_modes_come_through_a_line_that_is_nearly_full(void) {
    uint32_t modes = 0;
    hal.tx_limit = 150; /* the answer and one mode */
    ask_for(MAVLINK_MSG_ID_AVAILABLE_MODES, 0);
    for (uint32_t i = 0; i < 3 * STATE_COUNT; i++) {
        modes += peer_count(MAVLINK_MSG_ID_AVAILABLE_MODES);
        poll();
        peer_collect(HAL_PORT_RADIO);
    }
    TEST_ASSERT_EQUAL(STATE_COUNT, modes);
    TEST_ASSERT_EQUAL(0, board.outbox.channel[0].dropped);
}

static void test_there_are_no_more_modes(void) {
    ask_for(MAVLINK_MSG_ID_AVAILABLE_MODES, STATE_COUNT + 1);
    expect_answer(MAV_CMD_REQUEST_MESSAGE, MAV_RESULT_DENIED, FAULT_BAD_DATA);
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_AVAILABLE_MODES));
}

static void request_list(uint8_t system, uint8_t type) {
    mavlink_message_t message;
    const mavlink_mission_request_list_t fields = {
        .target_system = system, .target_component = 1, .mission_type = type};
    mavlink_msg_mission_request_list_encode_status(PEER_SYSTEM, PEER_COMPONENT, &peer_tx, &message,
                                                   &fields);
    peer_send(HAL_PORT_RADIO, &message);
    poll();
    peer_collect(HAL_PORT_RADIO);
}

static void test_missions_fence_and_rally_points_are_empty(void) {
    mavlink_mission_count_t fields;
    for (uint8_t type = 0; type < 3; type++) {
        request_list(1, type);
        mavlink_msg_mission_count_decode(peer_find(MAVLINK_MSG_ID_MISSION_COUNT), &fields);
        TEST_ASSERT_EQUAL(0, fields.count);
        TEST_ASSERT_EQUAL(type, fields.mission_type);
        TEST_ASSERT_EQUAL(PEER_SYSTEM, fields.target_system);
        TEST_ASSERT_EQUAL(PEER_COMPONENT, fields.target_component);
    }
    request_list(2, 0); /* another vehicle */
    TEST_ASSERT_EQUAL(0, peer_count(MAVLINK_MSG_ID_MISSION_COUNT));
}

static mavlink_sys_status_t system_status(void) {
    mavlink_sys_status_t fields;
    ask_for(MAVLINK_MSG_ID_SYS_STATUS, 0);
    mavlink_msg_sys_status_decode(peer_find(MAVLINK_MSG_ID_SYS_STATUS), &fields);
    return fields;
}

static void test_system_status_tells_battery_and_imu(void) {
    status.battery.mv = 7654;
    TEST_ASSERT_EQUAL(7654, system_status().voltage_battery);
    TEST_ASSERT_EQUAL(-1, system_status().battery_remaining);
    const uint32_t all = system_status().onboard_control_sensors_present;
    imu.driver.problem = IMU_PROBLEM_NONE;
    TEST_ASSERT_EQUAL_HEX32(all, system_status().onboard_control_sensors_health & all);
    imu.driver.problem = IMU_PROBLEM_SILENT;
    TEST_ASSERT_EQUAL_HEX32(MAV_SYS_STATUS_SENSOR_BATTERY,
                            system_status().onboard_control_sensors_health & all);
    status.battery.at_limit = true;
    TEST_ASSERT_EQUAL_HEX32(MAV_SYS_STATUS_GEOFENCE,
                            system_status().onboard_control_sensors_health);
    TEST_ASSERT_EQUAL(UINT16_MAX, system_status().voltage_battery);
}

static void set_interval(uint32_t message, float interval_us) {
    send_command(MAV_CMD_SET_MESSAGE_INTERVAL, (float)message, interval_us);
}

static uint32_t sent_in_ten_seconds(uint32_t message) {
    uint32_t count = 0;
    for (uint32_t i = 0; i < 500; i++) {
        if (i % 50 == 0) {
            send_heartbeat(HAL_PORT_RADIO, MAV_TYPE_GCS, PEER_SYSTEM);
        }
        poll_at(hal.now_us + 20000);
        peer_collect(HAL_PORT_RADIO);
        count += peer_count(message);
    }
    return count;
}

static void test_rates_of_a_hosts_choice(void) {
    static const struct {
        uint32_t message, usual;
    } cases[] = {{MAVLINK_MSG_ID_ATTITUDE, 10},
                 {MAVLINK_MSG_ID_BATTERY_STATUS, 10},
                 {MAVLINK_MSG_ID_TAILBEAT_LIVE, 50}};
    imu.counters.frames = 1;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        set_interval(cases[i].message, 100000.0f);
        expect_answer(MAV_CMD_SET_MESSAGE_INTERVAL, MAV_RESULT_ACCEPTED, FAULT_NONE);
        TEST_ASSERT_EQUAL(100, sent_in_ten_seconds(cases[i].message));
        set_interval(cases[i].message, -1.0f);
        TEST_ASSERT_EQUAL(0, sent_in_ten_seconds(cases[i].message));
        set_interval(cases[i].message, 0.0f);
        TEST_ASSERT_EQUAL(cases[i].usual, sent_in_ten_seconds(cases[i].message));
    }
}

static void test_a_rate_ends_with_the_host_that_chose_it(void) {
    set_interval(MAVLINK_MSG_ID_TAILBEAT_LIVE, -1.0f);
    TEST_ASSERT_EQUAL(0, sent_in_ten_seconds(MAVLINK_MSG_ID_TAILBEAT_LIVE));
    poll_at(hal.now_us + OUTBOX_HEARD_US);
    drain();
    TEST_ASSERT_EQUAL(50, sent_in_ten_seconds(MAVLINK_MSG_ID_TAILBEAT_LIVE));
}

static void test_without_an_imu_there_is_no_attitude(void) {
    set_interval(MAVLINK_MSG_ID_ATTITUDE, 100000.0f);
    expect_answer(MAV_CMD_SET_MESSAGE_INTERVAL, MAV_RESULT_ACCEPTED, FAULT_NONE);
    TEST_ASSERT_EQUAL(0, sent_in_ten_seconds(MAVLINK_MSG_ID_ATTITUDE));
}

static void test_senseless_rates_are_refused(void) {
    static const float senseless[] = {-2.0f, 19999.0f, 1.1e7f, NAN};
    for (size_t i = 0; i < sizeof senseless / sizeof senseless[0]; i++) {
        drain();
        set_interval(MAVLINK_MSG_ID_ATTITUDE, senseless[i]);
        expect_answer(MAV_CMD_SET_MESSAGE_INTERVAL, MAV_RESULT_DENIED, FAULT_BAD_DATA);
    }
    imu.counters.frames = 1;
    TEST_ASSERT_EQUAL(10, sent_in_ten_seconds(MAVLINK_MSG_ID_ATTITUDE));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_where_the_parameters_are_described);
    RUN_TEST(test_each_state_is_a_mode);
    RUN_TEST(test_all_modes_at_once);
    RUN_TEST(test_all_modes_come_through_a_line_that_is_nearly_full);
    RUN_TEST(test_there_are_no_more_modes);
    RUN_TEST(test_missions_fence_and_rally_points_are_empty);
    RUN_TEST(test_system_status_tells_battery_and_imu);
    RUN_TEST(test_rates_of_a_hosts_choice);
    RUN_TEST(test_a_rate_ends_with_the_host_that_chose_it);
    RUN_TEST(test_without_an_imu_there_is_no_attitude);
    RUN_TEST(test_senseless_rates_are_refused);
    return UNITY_END();
}
