/* Pulse widths by hand: 1500 us +- 10 us per degree, three ticks to the microsecond. */
#include "gait/servo.h"

#include "unity.h"

#include <math.h>

#define RAD_PER_DEG 0.0174532925f

static servo_config_t config;
static servo_t servo;

void setUp(void) {
    config = (servo_config_t){.centre_us = 1500.0f,
                              .us_per_rad = 572.9578f,
                              .min_us = 900.0f,
                              .max_us = 2100.0f,
                              .direction = 1.0f};
    servo = (servo_t){0};
}
void tearDown(void) {}

static void test_angles_become_ticks(void) {
    TEST_ASSERT_EQUAL_UINT16(4500, servo_move_isr(&servo, &config, 0.0f));
    TEST_ASSERT_EQUAL_UINT16(5850, servo_move_isr(&servo, &config, 45.0f * RAD_PER_DEG));
    TEST_ASSERT_EQUAL_UINT16(3150, servo_move_isr(&servo, &config, -45.0f * RAD_PER_DEG));
    TEST_ASSERT_EQUAL_UINT16(4530, servo_move_isr(&servo, &config, 1.0f * RAD_PER_DEG));
    TEST_ASSERT_TRUE(servo.moving);
    TEST_ASSERT_EQUAL(0, servo.clipped_frames);
}

static void test_direction_mirrors(void) {
    config.direction = -1.0f;
    TEST_ASSERT_EQUAL_UINT16(3150, servo_move_isr(&servo, &config, 45.0f * RAD_PER_DEG));
    TEST_ASSERT_EQUAL_FLOAT(45.0f * RAD_PER_DEG, servo.angle_rad);
}

static void test_ticks_are_rounded_to_nearest(void) {
    config.us_per_rad = 1.0f;
    TEST_ASSERT_EQUAL_UINT16(4500, servo_move_isr(&servo, &config, 0.16f));
    TEST_ASSERT_EQUAL_UINT16(4501, servo_move_isr(&servo, &config, 0.17f));
    TEST_ASSERT_EQUAL_UINT16(4500, servo_move_isr(&servo, &config, -0.16f));
    TEST_ASSERT_EQUAL_UINT16(4499, servo_move_isr(&servo, &config, -0.17f));
}

static void test_the_pulse_range_limits_the_angle(void) {
    TEST_ASSERT_EQUAL_UINT16(6300, servo_move_isr(&servo, &config, 1.2f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 600.0f / 572.9578f, servo.angle_rad);
    TEST_ASSERT_EQUAL(1, servo.clipped_frames);
    TEST_ASSERT_EQUAL_UINT16(2700, servo_move_isr(&servo, &config, -1.2f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, -600.0f / 572.9578f, servo.angle_rad);
    TEST_ASSERT_EQUAL(2, servo.clipped_frames);
}

static void test_the_limited_angle_knows_the_direction(void) {
    config.direction = -1.0f;
    config.max_us = 1800.0f;
    TEST_ASSERT_EQUAL_UINT16(5400, servo_move_isr(&servo, &config, -1.0f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, -300.0f / 572.9578f, servo.angle_rad);
}

static void test_rounding_stays_inside_limits_between_ticks(void) {
    config.min_us = 900.1f; /* 2700.3 ticks */
    config.max_us = 2099.9f;
    TEST_ASSERT_EQUAL_UINT16(2701, servo_move_isr(&servo, &config, -3.0f));
    TEST_ASSERT_EQUAL_UINT16(6299, servo_move_isr(&servo, &config, 3.0f));
}

static void test_slew_is_per_frame(void) {
    config.slew_rad_s = 5.0f;
    for (int frame = 1; frame <= 4; frame++) {
        (void)servo_move_isr(&servo, &config, 0.35f);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, frame < 4 ? 0.1f * (float)frame : 0.35f, servo.angle_rad);
    }
    TEST_ASSERT_EQUAL(3, servo.clipped_frames);
    (void)servo_move_isr(&servo, &config, -1.0f);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.25f, servo.angle_rad);
}

static void test_slew_starts_from_where_the_pulse_limit_held_it(void) {
    config.slew_rad_s = 5.0f;
    config.max_us = 1520.0f;
    for (int frame = 0; frame < 50; frame++) {
        (void)servo_move_isr(&servo, &config, 1.0f);
    }
    (void)servo_move_isr(&servo, &config, -1.0f);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 20.0f / 572.9578f - 0.1f, servo.angle_rad);
}

static void test_after_a_rest_slew_counts_from_the_centre(void) {
    (void)servo_move_isr(&servo, &config, 0.8f);
    servo_rest_isr(&servo);
    TEST_ASSERT_FALSE(servo.moving);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, servo.angle_rad);
    config.slew_rad_s = 5.0f;
    (void)servo_move_isr(&servo, &config, 0.8f);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.1f, servo.angle_rad);
}

static void test_nonsense_holds_the_tail(void) {
    const uint16_t before = servo_move_isr(&servo, &config, 0.3f);
    TEST_ASSERT_EQUAL_UINT16(before, servo_move_isr(&servo, &config, (float)NAN));
    TEST_ASSERT_EQUAL_UINT16(before, servo_move_isr(&servo, &config, (float)INFINITY));
    TEST_ASSERT_EQUAL_FLOAT(0.3f, servo.angle_rad);
    TEST_ASSERT_EQUAL(2, servo.clipped_frames);
}

static void check_refused(float *field, float value) {
    const float good = *field;
    TEST_ASSERT_TRUE(servo_config_valid(&config));
    *field = value;
    TEST_ASSERT_FALSE(servo_config_valid(&config));
    *field = good;
}

static void test_bad_configurations(void) {
    check_refused(&config.direction, 0.0f);
    check_refused(&config.direction, 0.5f);
    check_refused(&config.direction, (float)NAN);
    check_refused(&config.us_per_rad, 0.0f);
    check_refused(&config.us_per_rad, -500.0f);
    check_refused(&config.us_per_rad, (float)INFINITY);
    check_refused(&config.centre_us, 900.0f);
    check_refused(&config.centre_us, 2100.0f);
    check_refused(&config.centre_us, (float)NAN);
    check_refused(&config.min_us, 0.0f);
    check_refused(&config.min_us, (float)NAN);
    check_refused(&config.max_us, 20000.0f);
    check_refused(&config.max_us, (float)NAN);
    check_refused(&config.slew_rad_s, -1.0f);
    check_refused(&config.slew_rad_s, (float)NAN);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_angles_become_ticks);
    RUN_TEST(test_direction_mirrors);
    RUN_TEST(test_ticks_are_rounded_to_nearest);
    RUN_TEST(test_the_pulse_range_limits_the_angle);
    RUN_TEST(test_the_limited_angle_knows_the_direction);
    RUN_TEST(test_rounding_stays_inside_limits_between_ticks);
    RUN_TEST(test_slew_is_per_frame);
    RUN_TEST(test_slew_starts_from_where_the_pulse_limit_held_it);
    RUN_TEST(test_after_a_rest_slew_counts_from_the_centre);
    RUN_TEST(test_nonsense_holds_the_tail);
    RUN_TEST(test_bad_configurations);
    return UNITY_END();
}
