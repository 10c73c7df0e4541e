#include "monitor_explorer.h"

#include "base/crc.h"
#include "gait/servo.h"
#include "store/bytes.h"
#include "store/records.h"
#include "target.h"
#include "unity.h"

#define RECORD_BYTES (RECORD_HEADER_BYTES + (PARAM_NAME_BYTES + 4u) * PARAM_COUNT)
#define CONFIGS TIMES(2000u, 200u)
#define MOVES 200u

static params_t params;
static uint8_t record[RECORD_MAX_BYTES];
static monitor_limits_t limits;

void setUp(void) { params_reset(&params); }
void tearDown(void) {}

static bool read_params(void) {
    const size_t length = record_encode_params(&params, record);
    TEST_ASSERT_EQUAL_size_t(RECORD_BYTES, length);
    return monitor_read(record, length, &limits);
}

static void expect_limits(uint16_t min_ticks, uint16_t max_ticks, uint16_t step_ticks) {
    TEST_ASSERT_EQUAL_UINT16(min_ticks, limits.min_ticks);
    TEST_ASSERT_EQUAL_UINT16(max_ticks, limits.max_ticks);
    TEST_ASSERT_EQUAL_UINT16(step_ticks, limits.step_ticks);
}

static void test_every_state_keeps_the_rules(void) {
    const explored_t explored = explore_monitor();
    TEST_ASSERT_EQUAL_UINT32(0, explored.wrong_pulses);
    TEST_ASSERT_EQUAL_UINT32(0, explored.held_back);
    TEST_ASSERT_GREATER_THAN_UINT32(400, explored.states);
    TEST_ASSERT_GREATER_THAN_UINT32(100000, explored.pulses);
}

static void test_limits_come_from_the_record(void) {
    TEST_ASSERT_TRUE(read_params());
    expect_limits(2700, 6300, UINT16_MAX);
    params.value[PARAM_SERVO_MIN_US] = 1000.5f; /* 3001.5 thirds */
    params.value[PARAM_SERVO_MAX_US] = 1900.5f;
    params.value[PARAM_SERVO_SLEW_RAD_S] = 5.0f;
    params.value[PARAM_SERVO_US_RAD] = 500.0f; /* 50 us a frame */
    TEST_ASSERT_TRUE(read_params());
    expect_limits(3002, 5701, 152);
}

static void test_a_record_with_any_bit_flipped_is_refused(void) {
    TEST_ASSERT_TRUE(read_params());
    for (uint32_t bit = 0; bit < 8u * RECORD_BYTES; bit++) {
        record[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
        TEST_ASSERT_FALSE(monitor_read(record, RECORD_BYTES, &limits));
        record[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
    }
}

static void test_a_record_of_another_length_or_kind_is_refused(void) {
    TEST_ASSERT_TRUE(read_params());
    for (size_t length = 0; length < RECORD_BYTES + 40u; length++) {
        TEST_ASSERT_EQUAL(length == RECORD_BYTES, monitor_read(record, length, &limits));
    }
    const size_t length = record_encode_counter(7, record);
    TEST_ASSERT_FALSE(monitor_read(record, length, &limits));
}

static void seal(size_t length) {
    const uint32_t front = crc32_update(0, record, 8);
    (void)bytes_put_u32(record + 8, crc32_update(front, record + RECORD_HEADER_BYTES,
                                                 length - RECORD_HEADER_BYTES));
}

static void test_what_the_record_lacks_has_its_default(void) {
    params.value[PARAM_SERVO_MAX_US] = 1800.0f;
    TEST_ASSERT_TRUE(read_params());
    const size_t entry = PARAM_NAME_BYTES + 4u;
    record[RECORD_HEADER_BYTES + entry * PARAM_SERVO_MAX_US] = 'X';
    (void)bytes_put_f32(record + RECORD_HEADER_BYTES + entry * PARAM_SERVO_MIN_US + 16u, 100.0f);
    seal(RECORD_BYTES);
    TEST_ASSERT_TRUE(monitor_read(record, RECORD_BYTES, &limits));
    expect_limits(2700, 6300, UINT16_MAX);
}

static void test_within_means_in_every_limit(void) {
    const monitor_limits_t wide = {.min_ticks = 10, .max_ticks = 20, .step_ticks = 5};
    TEST_ASSERT_TRUE(monitor_within(&wide, &wide));
    TEST_ASSERT_TRUE(monitor_within(&(monitor_limits_t){11, 19, 4}, &wide));
    TEST_ASSERT_FALSE(monitor_within(&(monitor_limits_t){9, 20, 5}, &wide));
    TEST_ASSERT_FALSE(monitor_within(&(monitor_limits_t){10, 21, 5}, &wide));
    TEST_ASSERT_FALSE(monitor_within(&(monitor_limits_t){10, 20, 6}, &wide));
}

static void test_no_coast_is_longer_than_the_longest(void) {
    TEST_ASSERT_TRUE(read_params());
    monitor_t monitor = {0};
    monitor_request_t request = {.pulse_ticks = 4500,
                                 .swim = true,
                                 .swim_ticks = 1,
                                 .coast_ticks = UINT16_MAX,
                                 .trial = 1,
                                 .limits = limits};
    TEST_ASSERT_EQUAL_UINT16(4500, monitor_tick_isr(&monitor, &request));
    request.swim = false;
    uint32_t pulses = 0;
    while (monitor_tick_isr(&monitor, &request) != 0) {
        pulses++;
    }
    TEST_ASSERT_EQUAL_UINT32(MONITOR_COAST_TICKS_MAX, pulses);
}

static uint32_t seed = 1;

static float between(float low, float high) {
    seed = seed * 1664525u + 1013904223u;
    return low + (high - low) * (float)(seed >> 8) * (1.0f / 16777216.0f);
}

/* What the gait's servo code sends is never held back by limits of the same parameters. */
static void test_whatever_the_servo_code_sends_may_go_out(void) {
    for (uint32_t i = 0; i < CONFIGS; i++) {
        params.value[PARAM_SERVO_MIN_US] = between(500.0f, 1400.0f);
        params.value[PARAM_SERVO_MAX_US] = between(1600.0f, 2500.0f);
        params.value[PARAM_SERVO_US_RAD] = between(50.0f, 2000.0f);
        params.value[PARAM_SERVO_SLEW_RAD_S] = i % 4u == 0 ? 0.0f : between(0.01f, 50.0f);
        TEST_ASSERT_TRUE(read_params());
        const servo_config_t config = {.centre_us = between(1450.0f, 1550.0f),
                                       .us_per_rad = params.value[PARAM_SERVO_US_RAD],
                                       .min_us = params.value[PARAM_SERVO_MIN_US],
                                       .max_us = params.value[PARAM_SERVO_MAX_US],
                                       .direction = i % 2u == 0 ? 1.0f : -1.0f,
                                       .slew_rad_s = params.value[PARAM_SERVO_SLEW_RAD_S]};
        servo_t servo = {0};
        monitor_t monitor = {0};
        for (uint32_t move = 0; move < MOVES; move++) {
            const uint16_t pulse = servo_move_isr(&servo, &config, between(-1.5f, 1.5f));
            const monitor_request_t request = {.pulse_ticks = pulse,
                                               .swim = true,
                                               .swim_ticks = MOVES,
                                               .trial = 1,
                                               .limits = limits};
            TEST_ASSERT_EQUAL_UINT16(pulse, monitor_tick_isr(&monitor, &request));
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_state_keeps_the_rules);
    RUN_TEST(test_limits_come_from_the_record);
    RUN_TEST(test_a_record_with_any_bit_flipped_is_refused);
    RUN_TEST(test_a_record_of_another_length_or_kind_is_refused);
    RUN_TEST(test_what_the_record_lacks_has_its_default);
    RUN_TEST(test_within_means_in_every_limit);
    RUN_TEST(test_no_coast_is_longer_than_the_longest);
    RUN_TEST(test_whatever_the_servo_code_sends_may_go_out);
    return UNITY_END();
}
