#include "link_fixture.h"

static imu_sample_t sample_at(uint64_t time_us) {
    imu_sample_t sample = {.time_us = time_us, .dt_s = 0.01f};
    sample.frame.accel_m_s2[2] = -9.81f;
    sample.frame.rate_rad_s[0] = (float)(time_us % 1000000u) * 1e-6f;
    sample.frame.ypr_deg[1] = 1.5f;
    return sample;
}

static mavlink_tailbeat_imu_t last;

/* |count| frames, 10 ms apart; how many messages that made. */
static unsigned stream(unsigned count) {
    unsigned messages = 0;
    for (unsigned i = 0; i < count; i++) {
        const imu_sample_t sample = sample_at(hal.now_us);
        link_imu(&board, &sample);
        hal.now_us += 10000u;
        peer_collect(HAL_PORT_RADIO);
        if (peer_count(MAVLINK_MSG_ID_TAILBEAT_IMU) != 0) {
            mavlink_msg_tailbeat_imu_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_IMU), &last);
            messages++;
        }
    }
    return messages;
}

static void ask_for(float interval_us) {
    send_command(MAV_CMD_SET_MESSAGE_INTERVAL, (float)MAVLINK_MSG_ID_TAILBEAT_IMU, interval_us);
}

static void test_nothing_comes_unasked(void) { TEST_ASSERT_EQUAL_UINT(0, stream(20)); }

static void test_all_frames_come_four_at_a_time(void) {
    ask_for(0.0f);
    expect_answer(MAV_CMD_SET_MESSAGE_INTERVAL, MAV_RESULT_ACCEPTED, FAULT_NONE);
    const uint64_t first_us = hal.now_us;
    TEST_ASSERT_EQUAL_UINT(2, stream(8));
    TEST_ASSERT_EQUAL_UINT8(4, last.count);
    TEST_ASSERT_EQUAL_UINT32(4, last.sequence);
    const uint32_t shift_us = 10000u * last.sequence;
    for (uint32_t i = 0; i < 4; i++) {
        const imu_sample_t sample = sample_at(first_us + shift_us + 10000u * i);
        TEST_ASSERT_EQUAL_UINT32(sample.time_us, last.time_us[i]);
        TEST_ASSERT_EQUAL_FLOAT(sample.frame.rate_rad_s[0], last.rate_rad_s[3 * i]);
        TEST_ASSERT_EQUAL_FLOAT(-9.81f, last.accel_m_s2[3 * i + 2]);
        TEST_ASSERT_EQUAL_FLOAT(1.5f, last.ypr_deg[3 * i + 1]);
    }
}

static void test_fewer_come_at_a_longer_interval(void) {
    ask_for(20000.0f);
    TEST_ASSERT_EQUAL_UINT(5, stream(40));
}

static void test_off_again(void) {
    ask_for(0.0f);
    TEST_ASSERT_EQUAL_UINT(1, stream(4));
    ask_for(-1.0f);
    TEST_ASSERT_EQUAL_UINT(0, stream(20));
}

static void test_it_ends_when_the_host_is_gone(void) {
    ask_for(0.0f);
    TEST_ASSERT_EQUAL_UINT(1, stream(4));
    hal.now_us += OUTBOX_HEARD_US;
    TEST_ASSERT_EQUAL_UINT(0, stream(8));
    send_heartbeat(HAL_PORT_RADIO, MAV_TYPE_GCS, PEER_SYSTEM);
    poll();
    TEST_ASSERT_EQUAL_UINT(0, stream(8));
}

static void test_senseless_intervals_and_other_messages(void) {
    const float senseless[] = {-2.0f, 100.0f, 2e7f, NAN, INFINITY};
    for (unsigned i = 0; i < sizeof senseless / sizeof senseless[0]; i++) {
        drain();
        peer_inbox_count = 0;
        ask_for(senseless[i]);
        expect_answer(MAV_CMD_SET_MESSAGE_INTERVAL, MAV_RESULT_DENIED, FAULT_BAD_DATA);
    }
    peer_inbox_count = 0;
    send_command(MAV_CMD_SET_MESSAGE_INTERVAL, MAVLINK_MSG_ID_TAILBEAT_HEALTH, 50000.0f);
    expect_answer(MAV_CMD_SET_MESSAGE_INTERVAL, MAV_RESULT_UNSUPPORTED, FAULT_UNKNOWN_COMMAND);
    TEST_ASSERT_EQUAL_UINT(0, stream(8));
}

static void test_what_imu_it_is(void) {
    mavlink_tailbeat_imu_info_t info;
    memcpy(imu.driver.model, "VN-100S", sizeof "VN-100S");
    memcpy(imu.driver.firmware, "3.1.0.0", sizeof "3.1.0.0");
    imu.driver.state = IMU_STREAMING;
    imu.driver.found_baud = 9600;
    imu.driver.line_baud = 115200;
    imu.driver.found_port = 2;
    imu.driver.config.rate_hz = 100;
    status.still_s = 7.5f;
    poll();
    peer_collect(HAL_PORT_RADIO);
    TEST_ASSERT_EQUAL_UINT(1, peer_count(MAVLINK_MSG_ID_TAILBEAT_IMU_INFO));
    mavlink_msg_tailbeat_imu_info_decode(peer_find(MAVLINK_MSG_ID_TAILBEAT_IMU_INFO), &info);
    TEST_ASSERT_EQUAL_STRING("VN-100S", info.model);
    TEST_ASSERT_EQUAL_STRING("3.1.0.0", info.firmware);
    TEST_ASSERT_EQUAL_UINT32(115200, info.baud);
    TEST_ASSERT_EQUAL_UINT8(2, info.port);
    TEST_ASSERT_EQUAL_UINT16(100, info.rate_hz);
    TEST_ASSERT_EQUAL_FLOAT(7.5f, info.still_s);
    poll();
    send_command(MAV_CMD_REQUEST_MESSAGE, MAVLINK_MSG_ID_TAILBEAT_IMU_INFO, 0.0f);
    TEST_ASSERT_EQUAL_UINT(1, peer_count(MAVLINK_MSG_ID_TAILBEAT_IMU_INFO));
}

static void test_saving_its_settings_is_the_applications(void) {
    send_command(TAILBEAT_CMD_IMU_SAVE, 0.0f, 0.0f);
    TEST_ASSERT_EQUAL(LINK_COMMAND_IMU_SAVE, last_command.id);
    expect_answer(TAILBEAT_CMD_IMU_SAVE, MAV_RESULT_ACCEPTED, FAULT_NONE);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_nothing_comes_unasked);
    RUN_TEST(test_all_frames_come_four_at_a_time);
    RUN_TEST(test_fewer_come_at_a_longer_interval);
    RUN_TEST(test_off_again);
    RUN_TEST(test_it_ends_when_the_host_is_gone);
    RUN_TEST(test_senseless_intervals_and_other_messages);
    RUN_TEST(test_what_imu_it_is);
    RUN_TEST(test_saving_its_settings_is_the_applications);
    return UNITY_END();
}
