#include "imu/frame.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define PERIOD_NS 10000000u
#define BEGIN_NS 987654321000ull

/* Synthetic, computed by hand from the layout in the manual. */
static const uint8_t EXAMPLE[IMU_FRAME_BYTES] = {
    0xFA, 0x11, 0x29, 0x01, 0x40, 0x00, 0x08, 0x1A, 0x99, 0xBE, 0x1C, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x20, 0x41, 0x00, 0x00, 0x20, 0xC0, 0x00, 0x00, 0x40, 0x3F, 0x0A, 0xD7, 0x23, 0x3C, 0x0A, 0xD7,
    0xA3, 0xBC, 0x00, 0x00, 0x00, 0x3F, 0x21, 0xB0, 0xD2, 0xBE, 0x8A, 0xB0, 0xC1, 0xBE, 0xC4, 0xB1,
    0x1C, 0xC1, 0x6F, 0x12, 0x83, 0x3C, 0x00, 0x00, 0x80, 0xBE, 0x6F, 0x12, 0x83, 0x3B, 0x93, 0x1E,
};

static imu_sequence_t sequence;

void setUp(void) { imu_sequence_init(&sequence, PERIOD_NS); }

void tearDown(void) {}

static void the_header_is_that_of_the_example(void) {
    TEST_ASSERT_EQUAL_UINT8_ARRAY(EXAMPLE, imu_frame_header, IMU_FRAME_HEADER_BYTES);
}

static void example_gives_its_values(void) {
    imu_frame_t frame;
    TEST_ASSERT_TRUE(imu_frame_decode(EXAMPLE, &frame));
    TEST_ASSERT_TRUE(frame.time_startup_ns == 123456789000ull);
    const float ypr[] = {10.0f, -2.5f, 0.75f};
    const float rate[] = {0.01f, -0.02f, 0.5f};
    const float accel[] = {-0.4115f, -0.3783f, -9.7934f};
    const float linear[] = {0.016f, -0.25f, 0.004f};
    for (size_t axis = 0; axis < 3; axis++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, ypr[axis], frame.ypr_deg[axis]);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, rate[axis], frame.rate_rad_s[axis]);
        TEST_ASSERT_FLOAT_WITHIN(1e-4f, accel[axis], frame.accel_m_s2[axis]);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, linear[axis], frame.linear_accel_m_s2[axis]);
    }
}

static void all_bytes_of_the_time_count(void) {
    uint8_t bytes[IMU_FRAME_BYTES];
    memcpy(bytes, EXAMPLE, sizeof bytes);
    for (uint8_t i = 0; i < 8; i++) {
        bytes[6 + i] = (uint8_t)(0x11 * (i + 1));
    }
    imu_frame_t frame;
    TEST_ASSERT_TRUE(imu_frame_decode(bytes, &frame));
    TEST_ASSERT_TRUE(frame.time_startup_ns == 0x8877665544332211ull);
}

static void assert_value_dropped(size_t offset, float value, bool dropped) {
    uint8_t bytes[IMU_FRAME_BYTES];
    memcpy(bytes, EXAMPLE, sizeof bytes);
    memcpy(bytes + offset, &value, sizeof value);
    imu_frame_t frame;
    TEST_ASSERT_EQUAL_INT(dropped, !imu_frame_decode(bytes, &frame));
}

static void impossible_values_drop_the_frame(void) {
    for (size_t offset = 14; offset < 62; offset += 4) {
        assert_value_dropped(offset, NAN, true);
        assert_value_dropped(offset, INFINITY, true);
        assert_value_dropped(offset, -INFINITY, true);
    }
    assert_value_dropped(18, 90.0f, false);
    assert_value_dropped(18, -90.1f, true);
    for (size_t axis = 0; axis < 3; axis++) {
        assert_value_dropped(26 + 4 * axis, -34.9f, false);
        assert_value_dropped(26 + 4 * axis, 35.0f, true);
        assert_value_dropped(38 + 4 * axis, 156.9f, false);
        assert_value_dropped(38 + 4 * axis, -157.1f, true);
        assert_value_dropped(50 + 4 * axis, 166.0f, false);
        assert_value_dropped(50 + 4 * axis, 168.0f, true);
    }
}

static void assert_step(imu_step_t expected, uint64_t time_ns, float expected_dt_s) {
    float dt_s = -1.0f;
    TEST_ASSERT_EQUAL_INT(expected, imu_sequence_next(&sequence, time_ns, &dt_s));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f * expected_dt_s, expected_dt_s, dt_s);
}

/* The largest jitter of recordings is 30 us, at 800 Hz. */
static void jitter_is_no_gap(void) {
    imu_sequence_init(&sequence, 1250000);
    assert_step(IMU_STEP_FIRST, BEGIN_NS, 0.0f);
    assert_step(IMU_STEP_NEXT, BEGIN_NS + 1280000, 1.28e-3f);
    assert_step(IMU_STEP_NEXT, BEGIN_NS + 2500000, 1.22e-3f);
    assert_step(IMU_STEP_GAP, BEGIN_NS + 4970000, 2.47e-3f);
    TEST_ASSERT_EQUAL_UINT32(1, sequence.lost);
}

static void missing_frames_are_counted(void) {
    uint64_t time_ns = BEGIN_NS;
    uint32_t lost = 0;
    assert_step(IMU_STEP_FIRST, time_ns, 0.0f);
    for (uint32_t missing = 1; missing < 2000; missing += 7) {
        time_ns += (missing + 1ull) * PERIOD_NS + (missing % 2 == 0 ? 30000u : -30000ull);
        lost += missing;
        float dt_s;
        TEST_ASSERT_EQUAL_INT(IMU_STEP_GAP, imu_sequence_next(&sequence, time_ns, &dt_s));
        TEST_ASSERT_EQUAL_UINT32(lost, sequence.lost);
    }
}

static void half_a_step_is_where_a_gap_begins(void) {
    assert_step(IMU_STEP_FIRST, BEGIN_NS, 0.0f);
    assert_step(IMU_STEP_NEXT, BEGIN_NS + 15000000, 0.015f);
    assert_step(IMU_STEP_GAP, BEGIN_NS + 15000000 + 15000001, 0.015000001f);
    assert_step(IMU_STEP_NEXT, BEGIN_NS + 30000001 + 5000000, 0.005f);
    TEST_ASSERT_EQUAL_UINT32(1, sequence.lost);
}

static void a_clock_that_stands_or_falls_is_a_restart(void) {
    assert_step(IMU_STEP_FIRST, BEGIN_NS, 0.0f);
    assert_step(IMU_STEP_RESTART, BEGIN_NS, 0.0f);
    assert_step(IMU_STEP_NEXT, BEGIN_NS + PERIOD_NS, 0.01f);
    assert_step(IMU_STEP_RESTART, 1000, 0.0f);
    assert_step(IMU_STEP_NEXT, 1000 + PERIOD_NS, 0.01f);
    TEST_ASSERT_EQUAL_UINT32(2, sequence.restarts);
    TEST_ASSERT_EQUAL_UINT32(0, sequence.lost);
}

static void the_first_frame_may_have_time_zero(void) {
    assert_step(IMU_STEP_FIRST, 0, 0.0f);
    assert_step(IMU_STEP_NEXT, PERIOD_NS, 0.01f);
}

static void long_gaps_are_counted_well_enough(void) {
    assert_step(IMU_STEP_FIRST, 5, 0.0f);
    assert_step(IMU_STEP_GAP, 5 + 60000000000ull, 60.0f);
    TEST_ASSERT_UINT32_WITHIN(1, 5999, sequence.lost);
    sequence.lost = 0;
    assert_step(IMU_STEP_GAP, 5 + 3660000000000ull, 3600.0f);
    TEST_ASSERT_UINT32_WITHIN(40, 359999, sequence.lost);
}

static void the_longest_gap_ends_no_program(void) {
    imu_sequence_init(&sequence, 1);
    assert_step(IMU_STEP_FIRST, 0, 0.0f);
    assert_step(IMU_STEP_GAP, UINT64_MAX, 1.8446744e10f);
}

static void without_a_nominal_step_nothing_is_lost(void) {
    imu_sequence_init(&sequence, 0);
    assert_step(IMU_STEP_FIRST, BEGIN_NS, 0.0f);
    assert_step(IMU_STEP_NEXT, BEGIN_NS + 7000000000ull, 7.0f);
    assert_step(IMU_STEP_RESTART, 1, 0.0f);
    TEST_ASSERT_EQUAL_UINT32(0, sequence.lost);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(the_header_is_that_of_the_example);
    RUN_TEST(example_gives_its_values);
    RUN_TEST(all_bytes_of_the_time_count);
    RUN_TEST(impossible_values_drop_the_frame);
    RUN_TEST(jitter_is_no_gap);
    RUN_TEST(missing_frames_are_counted);
    RUN_TEST(half_a_step_is_where_a_gap_begins);
    RUN_TEST(a_clock_that_stands_or_falls_is_a_restart);
    RUN_TEST(the_first_frame_may_have_time_zero);
    RUN_TEST(long_gaps_are_counted_well_enough);
    RUN_TEST(the_longest_gap_ends_no_program);
    RUN_TEST(without_a_nominal_step_nothing_is_lost);
    return UNITY_END();
}
