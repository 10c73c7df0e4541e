/* The swim against an ideal sine in double precision; starts, stops and beat boundaries. */
#include "gait/gait.h"

#include "unity.h"

#include <math.h>

#define PI 3.14159265358979323846
#define FRAMES 50u
#define COAST 25u
#define US_PER_RAD 572.9578

static gait_config_t config;
static gait_t gait;

static const gait_command_t stop = {0};

void setUp(void) {
    config = (gait_config_t){.servo = {.centre_us = 1500.0f,
                                       .us_per_rad = (float)US_PER_RAD,
                                       .min_us = 900.0f,
                                       .max_us = 2100.0f,
                                       .direction = 1.0f},
                             .frames_per_beat = FRAMES,
                             .coast_frames = COAST};
    gait_init(&gait);
}
void tearDown(void) {}

static gait_output_t step(gait_command_t command) {
    return gait_frame_isr(&gait, &config, command);
}

static gait_command_t swim(float amplitude_rad) {
    return (gait_command_t){.swim = true, .amplitude_rad = amplitude_rad};
}

static gait_output_t swim_frames(uint32_t frames, float amplitude_rad) {
    gait_output_t output = {0};
    for (uint32_t i = 0; i < frames; i++) {
        output = step(swim(amplitude_rad));
    }
    return output;
}

static void test_off_sends_nothing(void) {
    for (int i = 0; i < 10; i++) {
        const gait_output_t output = step(stop);
        TEST_ASSERT_EQUAL(GAIT_OFF, output.mode);
        TEST_ASSERT_EQUAL_UINT16(0, output.pulse_ticks);
        TEST_ASSERT_FALSE(output.beat_start);
    }
}

static void test_the_first_frame_is_the_centre(void) {
    const gait_output_t output = step(swim(0.5f));
    TEST_ASSERT_EQUAL(GAIT_SWIM, output.mode);
    TEST_ASSERT_TRUE(output.beat_start);
    TEST_ASSERT_EQUAL(0, output.beat);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, output.angle_rad);
    TEST_ASSERT_EQUAL_UINT16(4500, output.pulse_ticks);
}

static void test_forty_beats_follow_the_ideal_sine(void) {
    for (uint32_t i = 0; i < 40u * FRAMES; i++) {
        const float amplitude = 0.02f * (float)(i / FRAMES + 1u);
        const gait_output_t output = step(swim(amplitude));
        const double angle = (double)amplitude * sin(2.0 * PI * i / FRAMES);
        TEST_ASSERT_TRUE(fabs((double)output.angle_rad - angle) < 1e-6);
        TEST_ASSERT_TRUE(fabs(output.pulse_ticks - 3.0 * (1500.0 + US_PER_RAD * angle)) < 0.51);
        TEST_ASSERT_EQUAL(i % FRAMES == 0, output.beat_start);
        TEST_ASSERT_EQUAL(i / FRAMES, output.beat);
    }
    TEST_ASSERT_EQUAL(0, gait.servo.clipped_frames);
}

static void test_amplitude_changes_at_the_boundary_only(void) {
    (void)step(swim(0.4f));
    for (uint32_t i = 1; i < FRAMES; i++) {
        const gait_output_t output = step(swim(0.01f * (float)i));
        const double angle = (double)0.4f * sin(2.0 * PI * i / FRAMES);
        TEST_ASSERT_TRUE(fabs((double)output.angle_rad - angle) < 1e-6);
    }
    const gait_output_t boundary = step(swim(0.1f));
    TEST_ASSERT_TRUE(boundary.beat_start);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, boundary.angle_rad);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.1f * (float)sin(2.0 * PI / FRAMES),
                             step(swim(9.0f)).angle_rad);
}

static void test_other_tempos(void) {
    const uint16_t tempos[] = {4, 7, 1000};
    for (int t = 0; t < 3; t++) {
        gait_init(&gait);
        config.frames_per_beat = tempos[t];
        for (uint32_t i = 0; i < 3u * tempos[t]; i++) {
            const gait_output_t output = step(swim(0.5f));
            TEST_ASSERT_TRUE(fabs((double)output.angle_rad - 0.5 * sin(2.0 * PI * i / tempos[t])) <
                             1e-6);
            TEST_ASSERT_EQUAL(i / tempos[t], output.beat);
        }
    }
}

static void test_a_stop_coasts_to_the_centre_and_lets_go(void) {
    float last = swim_frames(11, 0.7f).angle_rad; /* frame 10 */
    const float fastest = 0.5f * (float)PI * last / COAST * 1.01f;
    for (uint32_t i = 1; i <= COAST; i++) {
        const gait_output_t output = step(stop);
        TEST_ASSERT_EQUAL(GAIT_COAST, output.mode);
        TEST_ASSERT_NOT_EQUAL(0, output.pulse_ticks);
        TEST_ASSERT_TRUE(output.angle_rad < last && last - output.angle_rad <= fastest);
        last = output.angle_rad;
    }
    TEST_ASSERT_EQUAL_FLOAT(0.0f, last);
    const gait_output_t off = step(stop);
    TEST_ASSERT_EQUAL(GAIT_OFF, off.mode);
    TEST_ASSERT_EQUAL_UINT16(0, off.pulse_ticks);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, off.angle_rad);
}

static void test_a_stop_instead_of_the_next_beat_closes_the_sine(void) {
    TEST_ASSERT_TRUE(swim_frames(2u * FRAMES, 0.7f).angle_rad < 0.0f);
    for (uint32_t i = 0; i < COAST; i++) {
        const gait_output_t output = step(stop);
        TEST_ASSERT_EQUAL(GAIT_COAST, output.mode);
        TEST_ASSERT_FALSE(output.beat_start);
        TEST_ASSERT_EQUAL_UINT16(4500, output.pulse_ticks);
    }
    TEST_ASSERT_EQUAL_UINT16(0, step(stop).pulse_ticks);
}

static void test_a_stop_at_the_centre_holds_it(void) {
    (void)swim_frames(FRAMES + 1u, 0.7f);
    for (uint32_t i = 0; i < COAST; i++) {
        TEST_ASSERT_EQUAL_UINT16(4500, step(stop).pulse_ticks);
    }
    TEST_ASSERT_EQUAL_UINT16(0, step(stop).pulse_ticks);
}

static void test_without_coast_frames_it_is_off_at_once(void) {
    config.coast_frames = 0;
    (void)swim_frames(11, 0.7f);
    TEST_ASSERT_EQUAL_UINT16(0, step(stop).pulse_ticks);
    TEST_ASSERT_EQUAL(GAIT_OFF, gait.mode);
}

/* Pulses are off: what the tail did before does not hold back the next swim. */
static void test_off_lets_go_of_the_servo(void) {
    config.coast_frames = 0;
    TEST_ASSERT_TRUE(swim_frames(11, 0.7f).angle_rad > 0.5f);
    (void)step(stop);
    TEST_ASSERT_FALSE(gait.servo.moving);
    config.servo.slew_rad_s = 0.1f;
    TEST_ASSERT_EQUAL_UINT16(4500, step(swim(0.7f)).pulse_ticks);
}

static void test_a_new_swim_waits_for_the_end_of_the_coast(void) {
    (void)swim_frames(FRAMES + 11u, 0.7f);
    (void)step(stop);
    for (uint32_t i = 1; i < COAST; i++) {
        TEST_ASSERT_EQUAL(GAIT_COAST, step(swim(0.7f)).mode);
    }
    TEST_ASSERT_EQUAL(GAIT_OFF, step(swim(0.7f)).mode);
    const gait_output_t output = step(swim(0.7f));
    TEST_ASSERT_TRUE(output.beat_start);
    TEST_ASSERT_EQUAL(0, output.beat);
    TEST_ASSERT_EQUAL_UINT16(4500, output.pulse_ticks);
}

static void test_the_coast_begins_where_the_limits_left_the_tail(void) {
    config.servo.max_us = 1600.0f;
    const float held = swim_frames(13, 0.7f).angle_rad;
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, (float)(100.0 / US_PER_RAD), held);
    TEST_ASSERT_TRUE(gait.servo.clipped_frames > 0);
    const gait_output_t output = step(stop);
    TEST_ASSERT_TRUE(output.angle_rad < held && output.angle_rad > 0.98f * held);
}

static void test_a_non_finite_amplitude_does_not_move_the_tail(void) {
    for (uint32_t i = 0; i < FRAMES; i++) {
        TEST_ASSERT_EQUAL_UINT16(4500, step(swim((float)NAN)).pulse_ticks);
    }
}

static void test_bad_configurations(void) {
    TEST_ASSERT_TRUE(gait_config_valid(&config));
    config.frames_per_beat = 3;
    TEST_ASSERT_FALSE(gait_config_valid(&config));
    config.frames_per_beat = 1001;
    TEST_ASSERT_FALSE(gait_config_valid(&config));
    config.frames_per_beat = 1000;
    config.servo.direction = 0.0f;
    TEST_ASSERT_FALSE(gait_config_valid(&config));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_off_sends_nothing);
    RUN_TEST(test_the_first_frame_is_the_centre);
    RUN_TEST(test_forty_beats_follow_the_ideal_sine);
    RUN_TEST(test_amplitude_changes_at_the_boundary_only);
    RUN_TEST(test_other_tempos);
    RUN_TEST(test_a_stop_coasts_to_the_centre_and_lets_go);
    RUN_TEST(test_a_stop_instead_of_the_next_beat_closes_the_sine);
    RUN_TEST(test_a_stop_at_the_centre_holds_it);
    RUN_TEST(test_without_coast_frames_it_is_off_at_once);
    RUN_TEST(test_off_lets_go_of_the_servo);
    RUN_TEST(test_a_new_swim_waits_for_the_end_of_the_coast);
    RUN_TEST(test_the_coast_begins_where_the_limits_left_the_tail);
    RUN_TEST(test_a_non_finite_amplitude_does_not_move_the_tail);
    RUN_TEST(test_bad_configurations);
    return UNITY_END();
}
