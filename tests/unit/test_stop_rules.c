#include "supervisor/stop_rules.h"

#include "unity.h"

#include <math.h>

#define NOW_US 100000000ull

static stop_limits_t limits;
static stop_inputs_t inputs;

void setUp(void) {
    limits = (stop_limits_t){
        .link_timeout_us = 5000000,
        .imu_timeout_us = 1000000,
        .tick_late_us = 30000,
        .battery_critical_mv = 6000,
        .tilt_max_rad = 1.0f,
    };
    inputs = (stop_inputs_t){
        .now_us = NOW_US,
        .last_tick_us = NOW_US - 20000,
        .last_heartbeat_us = NOW_US - 1000000,
        .last_imu_us = NOW_US - 10000,
        .battery_mv = 7400,
    };
}

void tearDown(void) {}

static void assert_verdict(fault_t expected) {
    TEST_ASSERT_EQUAL_INT(expected, stop_rules_check(&limits, &inputs));
}

static void nothing_is_wrong(void) { assert_verdict(FAULT_NONE); }

static void battery_stops_below_its_limit(void) {
    inputs.battery_mv = 6000;
    assert_verdict(FAULT_NONE);
    inputs.battery_mv = 5999;
    assert_verdict(FAULT_BATTERY_CRITICAL);
    limits.battery_critical_mv = 0;
    inputs.battery_mv = 0;
    assert_verdict(FAULT_NONE);
}

/* Zero, what a dead converter reads, is no exception either way. */
static void a_battery_whose_voltage_is_unknown_stops(void) {
    inputs.battery_at_limit = true;
    TEST_ASSERT_EQUAL_INT(FAULT_BATTERY_SENSE, stop_rules_check(&limits, &inputs));
    limits.battery_sag_us = 1000000;
    inputs.battery_ok_us = NOW_US - 999999;
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, stop_rules_check(&limits, &inputs));
    inputs.battery_ok_us = NOW_US - 1000000;
    TEST_ASSERT_EQUAL_INT(FAULT_BATTERY_SENSE, stop_rules_check(&limits, &inputs));
    limits.battery_critical_mv = 0;
    TEST_ASSERT_EQUAL_INT(FAULT_NONE, stop_rules_check(&limits, &inputs));
}

static void a_battery_that_sags_for_a_moment_is_not_critical(void) {
    const uint16_t sagged_mv[] = {0, 1, 5999};
    for (int i = 0; i < 3; i++) {
        setUp();
        limits.battery_sag_us = 1000000;
        inputs.battery_mv = sagged_mv[i];
        inputs.battery_ok_us = NOW_US;
        assert_verdict(FAULT_NONE);
        inputs.battery_ok_us = NOW_US - 999999;
        assert_verdict(FAULT_NONE);
        inputs.battery_ok_us = NOW_US - 1000000;
        assert_verdict(FAULT_BATTERY_CRITICAL);
        inputs.battery_mv = 6000;
        assert_verdict(FAULT_NONE);
    }
}

static void tilt_stops_either_way_round(void) {
    float *const angles[] = {&inputs.pitch_rad, &inputs.roll_rad};
    for (int i = 0; i < 2; i++) {
        setUp();
        *angles[i] = 1.0f;
        assert_verdict(FAULT_NONE);
        *angles[i] = -1.001f;
        assert_verdict(FAULT_TILT);
        *angles[i] = 1.001f;
        assert_verdict(FAULT_TILT);
        *angles[i] = NAN;
        assert_verdict(FAULT_TILT);
        limits.tilt_max_rad = 0.0f;
        assert_verdict(FAULT_NONE);
    }
}

static void assert_silence_rule(uint64_t *last_us, uint32_t *timeout_us, fault_t fault) {
    *last_us = NOW_US - *timeout_us;
    assert_verdict(FAULT_NONE);
    *last_us = NOW_US - *timeout_us - 1;
    assert_verdict(fault);
    *last_us = 0;
    assert_verdict(fault);
    *last_us = NOW_US;
    assert_verdict(FAULT_NONE);
    *last_us = NOW_US + 1;
    assert_verdict(FAULT_NONE);
    *last_us = UINT64_MAX;
    assert_verdict(FAULT_NONE);
    *last_us = 0;
    *timeout_us = 0;
    assert_verdict(FAULT_NONE);
}

static void imu_stops_when_silent(void) {
    assert_silence_rule(&inputs.last_imu_us, &limits.imu_timeout_us, FAULT_IMU_STALE);
}

static void link_stops_when_silent(void) {
    assert_silence_rule(&inputs.last_heartbeat_us, &limits.link_timeout_us, FAULT_LINK_LOST);
}

static void late_tick_stops(void) {
    assert_silence_rule(&inputs.last_tick_us, &limits.tick_late_us, FAULT_LATE_TICK);
}

/* Right after boot "timeout ago" lies before time 0. */
static void early_times_do_not_wrap(void) {
    inputs = (stop_inputs_t){.now_us = 20000, .battery_mv = 7400};
    assert_verdict(FAULT_NONE);
}

/* 2^32 us are 71 minutes: an old 32-bit habit would see 5 ms here. */
static void silence_longer_than_32_bits_is_seen(void) {
    inputs.now_us = 0x100000000ull + 5000;
    inputs.last_tick_us = inputs.last_imu_us = inputs.now_us;
    inputs.last_heartbeat_us = 0;
    assert_verdict(FAULT_LINK_LOST);
}

static void the_first_broken_rule_is_named(void) {
    inputs = (stop_inputs_t){.now_us = NOW_US, .battery_mv = 1, .pitch_rad = 2.0f};
    assert_verdict(FAULT_BATTERY_CRITICAL);
    inputs.battery_mv = 7400;
    assert_verdict(FAULT_TILT);
    inputs.pitch_rad = 0.0f;
    assert_verdict(FAULT_IMU_STALE);
    inputs.last_imu_us = NOW_US;
    assert_verdict(FAULT_LINK_LOST);
    inputs.last_heartbeat_us = NOW_US;
    assert_verdict(FAULT_LATE_TICK);
    inputs.last_tick_us = NOW_US;
    assert_verdict(FAULT_NONE);
}

static void only_a_wall_takes_beats_away(void) {
    for (uint16_t row = 0; row < fault_count(); row++) {
        const fault_t end = (fault_t)fault_row(row)->number;
        const uint16_t wanted = end == FAULT_WALL ? 4 : 7;
        TEST_ASSERT_EQUAL_UINT16(wanted, stop_rules_trusted_beats(end, 7, 3));
        TEST_ASSERT_EQUAL_UINT16(7, stop_rules_trusted_beats(end, 7, 0));
    }
    TEST_ASSERT_EQUAL_UINT16(0, stop_rules_trusted_beats(FAULT_WALL, 3, 3));
    TEST_ASSERT_EQUAL_UINT16(0, stop_rules_trusted_beats(FAULT_WALL, 2, 10));
    TEST_ASSERT_EQUAL_UINT16(0, stop_rules_trusted_beats(FAULT_WALL, 0, 1));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(nothing_is_wrong);
    RUN_TEST(battery_stops_below_its_limit);
    RUN_TEST(a_battery_whose_voltage_is_unknown_stops);
    RUN_TEST(a_battery_that_sags_for_a_moment_is_not_critical);
    RUN_TEST(tilt_stops_either_way_round);
    RUN_TEST(imu_stops_when_silent);
    RUN_TEST(link_stops_when_silent);
    RUN_TEST(late_tick_stops);
    RUN_TEST(early_times_do_not_wrap);
    RUN_TEST(silence_longer_than_32_bits_is_seen);
    RUN_TEST(the_first_broken_rule_is_named);
    RUN_TEST(only_a_wall_takes_beats_away);
    return UNITY_END();
}
