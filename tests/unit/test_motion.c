/* Swims that are formulas (motion_swim.h): what motion.c makes of their frames is compared with the
 * formula. */
#include "speed/motion.h"

#include "motion_swim.h"
#include "target.h"
#include "unity.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXTREMES TIMES(1000, 100)

static motion_t motion;
static rest_t rest;
static uint32_t random_state;

void setUp(void) {
    swim_as_usual();
    random_state = 4u;
}

void tearDown(void) {}

static double uniform(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return (double)(random_state >> 8) / 16777216.0;
}

static double forward_at(double t) {
    const moment_t now = moment_at(t);
    return cos(now.course) * now.velocity[0] + sin(now.course) * now.velocity[1];
}

static void rest_before(void) {
    rest_mean_t mean;
    rest_init(&rest);
    const imu_frame_t frame = frame_of(-6.0, -5.99);
    for (int i = 0; i < 600; i++) {
        rest_push(&rest, &frame, 0.01f);
    }
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    motion_begin(&motion, &mean, NULL);
}

/* Sums motion_forward() up as the board does, slot by slot, as soon as it may. What swings with the
 * beat is not of interest: errors are those of the mean over one beat. */
#define SLOTS_MAX 700u
typedef struct {
    uint16_t next;
    uint16_t unknown;
    double speed_m_s, way_m;
    double error_m_s[SLOTS_MAX + 1u]; /* summed over the slots before */
    double worst_m_s;
    double nose_m_s; /* integral along the nose; has gravity in it unless the fish is level */
    double turn_rad, turn_error_rad, turn_most_rad; /* summed up; worst of a slot; largest true */
} sum_t;

static sum_t sum;

static void compare(void) {
    const uint16_t beat = (uint16_t)lround(swim.beat_s * 10.0), end = sum.next;
    const double error_m_s = sum.speed_m_s - forward_at(0.1 * end) + forward_at(0.0);
    sum.error_m_s[end] = sum.error_m_s[end - 1] + error_m_s;
    if (end >= beat) {
        const double mean_m_s = (sum.error_m_s[end] - sum.error_m_s[end - beat]) / beat;
        sum.worst_m_s = fmax(sum.worst_m_s, fabs(mean_m_s));
    }
}

/* Heading of the nose at a moment. */
static double yaw_at(double t) {
    double share[3], course[3], swing[3];
    share_at(t, share);
    course_at(t, course);
    swing_at(t, share, swim.yaw_rad, 2.0 * PI / swim.beat_s, swim.yaw_phase, swing);
    return course[0] + swing[0];
}

static void take_turn(uint16_t index) {
    const int16_t turn = motion_turn(&motion, index);
    const double truly_rad = yaw_at(0.1 * (index + 1)) - yaw_at(0.1 * index);
    if (turn == SPEED_NO_MOTION) {
        return;
    }
    sum.turn_rad += 1e-4 * turn;
    sum.turn_error_rad = fmax(sum.turn_error_rad, fabs(1e-4 * turn - truly_rad));
    sum.turn_most_rad = fmax(sum.turn_most_rad, fabs(truly_rad));
}

static void take_slots(double now_s) {
    while (0.1 * (sum.next + 1) + swim.beat_s + 0.2 < now_s) {
        float gain_m_s = NAN, way_m = NAN;
        if (motion_forward(&motion, sum.next, (float)swim.beat_s, &gain_m_s, &way_m)) {
            sum.way_m += 0.1 * sum.speed_m_s + (double)way_m;
            sum.speed_m_s += (double)gain_m_s;
        } else {
            sum.unknown++;
        }
        take_turn(sum.next);
        sum.next++;
        compare();
    }
}

/* The frames end at first_s, first_s + dt_s, ... */
static void swim_on(double first_s, double until_s, double dt_s) {
    const int frames = (int)floor((until_s - first_s) / dt_s + 1e-6) + 1;
    for (int i = 0; i < frames; i++) {
        const double t = first_s + i * dt_s;
        const imu_frame_t frame = frame_of(t - dt_s, t);
        motion_push(&motion, &frame, (float)t, (float)dt_s);
        sum.nose_m_s += dt_s * (double)frame.accel_m_s2[0];
        take_slots(t);
    }
}

static void swim_all(double dt_s) {
    sum = (sum_t){0};
    rest_before();
    swim_on(0.37 * dt_s, swim.length_s, dt_s);
}

static void assert_below(double limit, double value) {
    if (!(value <= limit)) {
        printf("%g is above %g\n", value, limit);
    }
    TEST_ASSERT_TRUE(value <= limit);
}

/* Simpson over the formula. */
static double true_way(double to_s) {
    double sum_m = 0.0;
    for (int i = 0; i <= 400; i++) {
        const double weight = i == 0 || i == 400 ? 1.0 : i % 2 == 1 ? 4.0 : 2.0;
        sum_m += weight * (forward_at(to_s * i / 400.0) - forward_at(0.0));
    }
    return sum_m * to_s / 1200.0;
}

static void the_speed_of_a_swim_is_found(void) {
    swim_all(0.01);
    const double way_m = true_way(0.1 * sum.next);
    printf("worst of %u slots: %.3f mm/s, way %.4f m, really %.4f m\n", sum.next,
           1e3 * sum.worst_m_s, sum.way_m, way_m);
    TEST_ASSERT_EQUAL_UINT16(0, sum.unknown);
    TEST_ASSERT_TRUE(sum.next > 380);
    assert_below(0.2e-3, fabs(sum.error_m_s[sum.next]) / sum.next);
    assert_below(0.4e-3, sum.worst_m_s);
    assert_below(8e-3, fabs(sum.way_m - way_m));
    TEST_ASSERT_TRUE(way_m > 2.0);
}

/* Roll a quarter beat before yaw is the worst: the attitude cones. */
static void any_phase_and_rate_will_do(void) {
    const double dt_s[] = {0.02, 0.01, 0.005, 0.0025};
    const double limit_m_s[] = {2e-3, 0.8e-3, 0.8e-3, 0.8e-3};
    for (int i = 0; i < 4; i++) {
        setUp();
        swim.length_s = i == 0 ? 40.0 : 14.0;
        swim.grow_s = i == 0 ? 10.0 : 6.0;
        swim.yaw_phase += 1.7 * i;
        swim.roll_phase = swim.yaw_phase + PI / 2.0;
        swim.sway_phase -= 2.1 * i;
        swim_all(dt_s[i]);
        printf("%.1f ms: %.3f mm/s\n", 1e3 * dt_s[i], 1e3 * sum.worst_m_s);
        TEST_ASSERT_EQUAL_UINT16(0, sum.unknown);
        assert_below(limit_m_s[i], sum.worst_m_s);
    }
}

/* A beat of whole frames of 20 ms need not be one of whole slots. A direction that swung by one
 * degree would be 3 mm/s^2. */
static void any_beat_will_do(void) {
    const double beats_s[] = {0.42, 0.76, 1.34, 2.18};
    for (int i = 0; i < 4; i++) {
        setUp();
        swim.beat_s = beats_s[i];
        swim.length_s = 16.0 * swim.beat_s;
        swim.grow_s = 7.0 * swim.beat_s;
        swim.sway_phase = swim.yaw_phase;
        swim_all(0.01);
        printf("beat of %.2f s: %.3f mm/s\n", beats_s[i], 1e3 * sum.worst_m_s);
        assert_below(1.5e-3, sum.worst_m_s);
    }
}

/* Facts: an IMU 0.1 m ahead of the axis of yaw, +-10 degrees at 1 Hz: 0.060 m/s^2 along the nose;
 * sway in step with yaw adds to it. In the level frame it goes out of the mean. */
static void along_the_nose_it_would_be_metres_per_second(void) {
    for (int sways = 0; sways <= 1; sways++) {
        setUp();
        swim.ahead_m = 0.1;
        swim.pitch_rad = swim.roll_rad = 0.0;
        swim.tilt_rad[0] = swim.tilt_rad[1] = 0.0;
        swim.sway_m_s2 *= sways;
        swim.sway_phase = swim.yaw_phase + PI;
        swim_all(0.01);
        printf("along the nose %.2f m/s, level %.3f mm/s\n", sum.nose_m_s, 1e3 * sum.worst_m_s);
        TEST_ASSERT_TRUE(sum.nose_m_s < (sways ? -2.2 : -1.4));
        assert_below(1e-3, sum.worst_m_s);
    }
}

static void a_wrong_tilt_shows_as_its_share_of_gravity(void) {
    rest_mean_t mean = {0};
    swim.tilt_rad[0] = swim.tilt_rad[1] = 0.0;
    mean.accel_m_s2[0] = (float)(G * sin(0.5 * DEG));
    mean.accel_m_s2[2] = (float)(-G * cos(0.5 * DEG));
    swim.length_s = 22.0;
    sum = (sum_t){0};
    motion_begin(&motion, &mean, NULL);
    swim_on(0.01, 22.0, 0.01);
    const double t = 0.1 * sum.next;
    const double error_m_s2 = (sum.speed_m_s - forward_at(t) + forward_at(0.0)) / t;
    TEST_ASSERT_TRUE(fabs(error_m_s2 / (-G * sin(0.5 * DEG)) - 1.0) < 0.005);
}

static void a_rest_takes_the_gyroscopes_bias_away(void) {
    const double bias[3] = {0.004, -0.003, 0.0037};
    memcpy(swim.bias_rad_s, bias, sizeof bias);
    swim_all(0.01);
    assert_below(0.5e-3, sum.worst_m_s);
}

/* Then a bias stays, and its tilt: 0.004 rad/s for 10 s. */
static void without_a_rest_the_last_frame_stands_in(void) {
    const imu_frame_t first = frame_of(-0.01, 0.0);
    swim.length_s = 12.0;
    swim.grow_s = 5.0;
    for (int biased = 0; biased <= 1; biased++) {
        sum = (sum_t){0};
        swim.bias_rad_s[1] = 0.004 * biased;
        motion_begin(&motion, NULL, &first);
        swim_on(0.01, 12.0, 0.01);
        TEST_ASSERT_TRUE(biased ? sum.worst_m_s > 1.0 : sum.worst_m_s < 0.5e-3);
    }
}

static void a_turn_does_not_change_the_speed(void) {
    swim.turn_rad = 30.0 * DEG;
    swim.turn_at_s = 15.0;
    swim.turn_s = 6.0;
    swim_all(0.01);
    printf("30 degrees: %.3f mm/s\n", 1e3 * sum.worst_m_s);
    assert_below(1e-3, sum.worst_m_s);
    swim.turn_rad = -270.0 * DEG;
    swim.turn_at_s = 6.0;
    swim.turn_s = 20.0;
    swim.length_s = 30.0;
    swim_all(0.01);
    printf("-270 degrees: %.3f mm/s\n", 1e3 * sum.worst_m_s);
    assert_below(2e-3, sum.worst_m_s);
}

static void check_turns(const char *what) {
    const double off_rad = sum.turn_rad - yaw_at(0.1 * sum.next) + yaw_at(0.0);
    printf("turns, %s: up to %.4f rad a slot, worst error %.5f, in all %.5f of %.4f rad\n", what,
           sum.turn_most_rad, sum.turn_error_rad, off_rad, yaw_at(0.1 * sum.next) - yaw_at(0.0));
    TEST_ASSERT_EQUAL_UINT16(0, sum.unknown);
    assert_below(0.01 * sum.turn_most_rad, sum.turn_error_rad);
    assert_below(0.0015, fabs(off_rad));
}

/* Summed up along the body's vertical instead, 38 s would be off by 0.13 rad: roll and pitch swing
 * together. */
static void the_turns_of_a_swim_are_found(void) {
    swim_all(0.01);
    check_turns("10 degrees of yaw");
    swim.turn_rad = -270.0 * DEG;
    swim.turn_at_s = 12.0;
    swim.turn_s = 14.0;
    swim_all(0.0025);
    check_turns("and -270 degrees");
    TEST_ASSERT_TRUE(sum.turn_rad < -4.5);
}

/* An IMU that lies askew in the fish: its own z axis would make 13 % too little of it. */
static void a_turn_is_about_the_vertical(void) {
    const double tilt = 30.0 * DEG;
    imu_frame_t frame = {.accel_m_s2 = {(float)(G * sin(tilt)), 0.0f, (float)(-G * cos(tilt))},
                         .rate_rad_s = {(float)(-0.5 * sin(tilt)), 0.0f, (float)(0.5 * cos(tilt))}};
    motion_begin(&motion, NULL, &frame);
    for (int i = 0; i < 200; i++) {
        motion_push(&motion, &frame, 0.01f * (float)(i + 1), 0.01f);
    }
    for (uint16_t index = 0; index < 19; index++) {
        TEST_ASSERT_INT16_WITHIN(1, 500, motion_turn(&motion, index));
    }
}

static void a_turn_is_known_only_where_frames_cover_it(void) {
    imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, (float)-G}, .rate_rad_s = {0.0f, 0.0f, -0.2f}};
    motion_begin(&motion, NULL, &frame);
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 0));
    for (int i = 0; i < 25; i++) {
        motion_push(&motion, &frame, 0.12f + 0.01f * (float)i, 0.01f);
    }
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 0));
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 1)); /* from 0.11 s on */
    TEST_ASSERT_INT16_WITHIN(1, -200, motion_turn(&motion, 2));
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 3)); /* not over */
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 2 + MOTION_SLOTS));
}

static void a_turn_beyond_the_numbers_is_unknown(void) {
    imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, (float)-G}};
    motion_begin(&motion, NULL, &frame);
    for (int i = 0; i < 45; i++) {
        frame.rate_rad_s[2] = i < 20 ? -32.7f : 32.9f;
        motion_push(&motion, &frame, 0.01f * (float)(i + 1), 0.01f);
    }
    TEST_ASSERT_INT16_WITHIN(5, -32700, motion_turn(&motion, 1));
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 2));
    TEST_ASSERT_EQUAL_INT16(SPEED_NO_MOTION, motion_turn(&motion, 3));
}

/* The board's clock for the sensor's wavers; the sensor's own does not. */
static void times_may_waver(void) {
    swim.length_s = 22.0;
    rest_before();
    sum = (sum_t){0};
    for (int i = 0; i <= 2200; i++) {
        const double t = 0.01 * i;
        const imu_frame_t frame = frame_of(t - 0.01, t);
        motion_push(&motion, &frame, (float)(t + 0.002 * uniform()), 0.01f);
        take_slots(t - 0.01);
    }
    printf("2 ms of jitter: %.3f mm/s\n", 1e3 * sum.worst_m_s);
    TEST_ASSERT_EQUAL_UINT16(0, sum.unknown);
    assert_below(1e-3, sum.worst_m_s);
}

static void push_frames(double until_s, bool (*keep)(double)) {
    double last_s = 0.0;
    rest_before();
    sum = (sum_t){0};
    for (int i = 1; i <= (int)lround(until_s * 100.0); i++) {
        const double t = 0.01 * i;
        if (keep(t)) {
            const imu_frame_t frame = frame_of(t - 0.01, t);
            motion_push(&motion, &frame, (float)t, (float)(t - last_s));
            last_s = t;
        }
        take_slots(t);
    }
}

static bool but_one_in_a_hundred(double t) {
    (void)t;
    return uniform() > 0.01;
}

/* Each one makes some 1e-5 rad of tilt; held instead of interpolated it would be twenty times that.
 */
static void lost_frames_are_bridged(void) {
    swim.length_s = 30.0;
    push_frames(30.0, but_one_in_a_hundred);
    printf("one in a hundred lost: %.2f mm/s\n", 1e3 * sum.worst_m_s);
    TEST_ASSERT_EQUAL_UINT16(0, sum.unknown);
    assert_below(20e-3, sum.worst_m_s);
}

/* The frames that end at 10.04 ... 10.15 s are missing. Holding the rate of either side over the
 * hole would tilt by degrees. */
/* How the body turned meanwhile is not known: a degree would be 0.17 m/s^2. */
static void assert_lost_from(uint16_t slot, uint16_t last) {
    for (uint16_t index = (uint16_t)(slot - 10u); index < last; index++) {
        float gain_m_s, way_m;
        TEST_ASSERT_EQUAL_INT(index < slot,
                              motion_forward(&motion, index, 1.0f, &gain_m_s, &way_m));
    }
}

static void a_long_gap_ends_the_motion(void) {
    rest_before();
    sum = (sum_t){.next = 65000};
    swim_on(0.01, 10.0, 0.01);
    const imu_frame_t frame = frame_of(10.11, 10.12);
    motion_push(&motion, &frame, 10.12f, 0.12f);
    swim_on(10.13, 14.0, 0.01);
    assert_lost_from(100, 138);
}

static void a_gap_of_50_ms_is_bridged_and_one_of_60_is_not(void) {
    for (int lost = 5; lost <= 6; lost++) {
        float gain_m_s, way_m;
        const double t = 1.02 + 0.01 * (lost + 1);
        rest_before();
        sum = (sum_t){.next = 65000};
        swim_on(0.01, 1.02, 0.01);
        const imu_frame_t frame = frame_of(t - 0.01, t);
        motion_push(&motion, &frame, (float)t, (float)(0.01 * (lost + 1) - 1e-5 * (lost == 5)));
        swim_on(t + 0.01, 3.0, 0.01);
        TEST_ASSERT_TRUE(motion_forward(&motion, 9, 1.0f, &gain_m_s, &way_m));
        TEST_ASSERT_EQUAL_INT(lost == 5, motion_forward(&motion, 10, 1.0f, &gain_m_s, &way_m));
        TEST_ASSERT_EQUAL_INT(lost == 5, motion_forward(&motion, 20, 1.0f, &gain_m_s, &way_m));
    }
}

static void a_restart_ends_the_motion(void) {
    rest_before();
    sum = (sum_t){.next = 65000};
    swim_on(0.01, 10.0, 0.01);
    const imu_frame_t frame = frame_of(10.0, 10.01);
    motion_push(&motion, &frame, 10.01f, 0.0f);
    swim_on(10.02, 14.0, 0.01);
    assert_lost_from(100, 138);
}

static void the_first_frame_may_come_after_any_gap(void) {
    const float dt_s[] = {0.0f, 0.01f, 0.3f, 5.0f};
    for (int i = 0; i < 4; i++) {
        float gain_m_s, way_m;
        rest_before();
        sum = (sum_t){.next = 65000};
        const imu_frame_t frame = frame_of(-0.01, 0.0);
        motion_push(&motion, &frame, 0.0f, dt_s[i]);
        swim_on(0.01, 3.0, 0.01);
        TEST_ASSERT_TRUE(motion_forward(&motion, 0, 1.0f, &gain_m_s, &way_m));
        TEST_ASSERT_TRUE(motion_forward(&motion, 20, 1.0f, &gain_m_s, &way_m));
    }
}

/* Begun before the start, by frames that were on their way; and long after it. */
static void only_time_after_the_start_counts(void) {
    float gain_m_s, way_m;
    imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, -9.81f}};
    motion_begin(&motion, NULL, &frame);
    frame.accel_m_s2[0] = 1.0f;
    for (int i = -30; i < 100; i++) {
        motion_push(&motion, &frame, 0.007f * (float)i + 0.002f, 0.007f);
    }
    TEST_ASSERT_TRUE(motion_forward(&motion, 0, 0.1f, &gain_m_s, &way_m));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.1f, gain_m_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.005f, way_m);
    motion_begin(&motion, NULL, &frame);
    for (int i = 1; i < 100; i++) {
        motion_push(&motion, &frame, 7.333f + 0.01f * (float)i, 0.01f);
    }
    TEST_ASSERT_FALSE(motion_forward(&motion, 73, 1.0f, &gain_m_s, &way_m));
    TEST_ASSERT_TRUE(motion_forward(&motion, 74, 1.0f, &gain_m_s, &way_m));
}

/* Frames as long as anything end where they like; late in the longest trial, too. */
static void slots_get_exactly_their_share(void) {
    const double dt_s[] = {0.0025, 0.0073, 0.01, 0.02, 0.0137};
    for (int i = 0; i < 5; i++) {
        const double start_s = i == 4 ? 2000.0 : 0.0;
        imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, -9.81f}};
        motion_begin(&motion, NULL, &frame);
        frame.accel_m_s2[0] = 0.5f;
        for (double t = start_s; t < start_s + 5.0; t += dt_s[i]) {
            motion_push(&motion, &frame, (float)t, (float)dt_s[i]);
        }
        const float slack_s = i == 4 ? 2.5e-4f : 2e-6f; /* a time of 2000 s is known to 0.12 ms */
        for (uint16_t k = 1; k < 45; k++) {
            const uint16_t index = (uint16_t)(k + (uint16_t)(10.0 * start_s));
            float gain_m_s = 0.0f, way_m = 0.0f;
            TEST_ASSERT_TRUE(motion_forward(&motion, index, 1.0f, &gain_m_s, &way_m));
            TEST_ASSERT_FLOAT_WITHIN(0.5f * slack_s, 0.05f, gain_m_s);
            TEST_ASSERT_FLOAT_WITHIN(0.05f * slack_s, 0.0025f, way_m);
        }
    }
}

static void the_ring_forgets_and_does_not_foresee(void) {
    float gain_m_s, way_m;
    rest_before();
    sum = (sum_t){.next = 65000};
    TEST_ASSERT_FALSE(motion_forward(&motion, 0, 1.0f, &gain_m_s, &way_m));
    swim_on(0.01, 12.0, 0.01);
    TEST_ASSERT_FALSE(motion_forward(&motion, 119 - MOTION_SLOTS, 1.0f, &gain_m_s, &way_m));
    TEST_ASSERT_TRUE(motion_forward(&motion, 120 - MOTION_SLOTS, 1.0f, &gain_m_s, &way_m));
    TEST_ASSERT_TRUE(motion_forward(&motion, 119, 1.0f, &gain_m_s, &way_m));
    TEST_ASSERT_FALSE(motion_forward(&motion, 120, 1.0f, &gain_m_s, &way_m));
    TEST_ASSERT_FALSE(motion_forward(&motion, 60000, 1.0f, &gain_m_s, &way_m));
}

/* However the IMU lies in the fish, what it feels at rest is no motion, and ahead is where its x
 * axis points. */
static void any_first_attitude_is_level(void) {
    const double tilts[][2] = {{0.0, 0.0},  {PI, 0.0},   {PI, 0.3},         {-3.1, 0.1},
                               {1.5, -0.4}, {0.2, -1.2}, {PI - 1e-5, 1e-5}, {0.0, 1.5}};
    for (size_t i = 0; i < sizeof tilts / sizeof tilts[0]; i++) {
        float gain_m_s, way_m;
        const float limit_m_s = fabs(tilts[i][0]) > 3.0 ? 2e-5f : 1e-6f; /* 1 - cos, rounded */
        setUp();
        swim.cruise_m_s = swim.ripple_m_s = swim.sway_m_s2 = 0.0;
        swim.yaw_rad = swim.pitch_rad = swim.roll_rad = 0.0;
        memcpy(swim.tilt_rad, tilts[i], sizeof tilts[i]);
        rest_before();
        imu_frame_t frame = frame_of(-1.0, -0.99);
        for (int k = 0; k < 100; k++) {
            motion_push(&motion, &frame, 0.01f * (float)(k + 1), 0.01f);
        }
        TEST_ASSERT_TRUE(motion_forward(&motion, 5, 0.1f, &gain_m_s, &way_m));
        TEST_ASSERT_FLOAT_WITHIN(limit_m_s, 0.0f, gain_m_s);
        frame.accel_m_s2[0] += 1.0f; /* along the nose */
        for (int k = 100; k < 200; k++) {
            motion_push(&motion, &frame, 0.01f * (float)(k + 1), 0.01f);
        }
        TEST_ASSERT_TRUE(motion_forward(&motion, 15, 0.1f, &gain_m_s, &way_m));
        TEST_ASSERT_FLOAT_WITHIN(limit_m_s, (float)(0.1 * cos(tilts[i][1])), gain_m_s);
        const int32_t *gained = motion.slots[15].gain;
        const double gained_m_s = hypot((double)gained[0], (double)gained[1]) * 0x1p-29;
        TEST_ASSERT_FLOAT_WITHIN(limit_m_s, gain_m_s, (float)gained_m_s);
    }
}

#define WEIGHTS 45

/* A row of slots as long as a beat, the ends in part, over another such: term by term. */
static void brute_weights(double beat_s, double weight[2 * WEIGHTS + 1]) {
    double row[2 * WEIGHTS + 1] = {0};
    const double half = 5.0 * beat_s;
    for (int i = -WEIGHTS; i <= WEIGHTS; i++) {
        const double inside = half + 0.5 - abs(i);
        row[WEIGHTS + i] = inside < 0.0 ? 0.0 : inside > 1.0 ? 1.0 : inside;
    }
    for (int i = -WEIGHTS; i <= WEIGHTS; i++) {
        weight[WEIGHTS + i] = 0.0;
        for (int j = -WEIGHTS; j <= WEIGHTS; j++) {
            const int k = i - j;
            weight[WEIGHTS + i] +=
                k < -WEIGHTS || k > WEIGHTS ? 0.0 : row[WEIGHTS + j] * row[WEIGHTS + k];
        }
    }
}

/* Turning from the start on, at |rate|: mean heading around a slot, before the start 0. */
static double brute_heading(double rate, double beat_s, int index) {
    double weight[2 * WEIGHTS + 1], x = 0.0, y = 0.0;
    brute_weights(beat_s, weight);
    for (int i = -WEIGHTS; i <= WEIGHTS; i++) {
        const double a = 0.1 * rate * (index + i), b = a + 0.1 * rate;
        const bool before = index + i < 0;
        x += weight[WEIGHTS + i] * (before ? 0.1 : (sin(b) - sin(a)) / rate);
        y += weight[WEIGHTS + i] * (before ? 0.0 : (cos(a) - cos(b)) / rate);
    }
    return atan2(y, x);
}

/* An acceleration that keeps its direction shows the heading by its share along it. */
static void heading_is_averaged_over_a_beat_twice(void) {
    const double rate = 0.35, beats_s[] = {0.1, 0.2, 0.34, 0.76, 1.0, 1.1, 2.58};
    imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, (float)-G}};
    motion_begin(&motion, NULL, &frame);
    frame.rate_rad_s[2] = (float)rate;
    for (int i = 0; i < 3200; i++) {
        const double a = 0.0025 * rate * i, b = 0.0025 * rate * (i + 1);
        frame.accel_m_s2[0] = (float)((sin(b) - sin(a)) / (0.0025 * rate));
        frame.accel_m_s2[1] = (float)((cos(b) - cos(a)) / (0.0025 * rate));
        motion_push(&motion, &frame, (float)(0.0025 * (i + 1)), 0.0025f);
    }
    for (int i = 0; i < 7; i++) {
        for (int index = 0; index < 50; index += 7) {
            float gain_m_s = NAN, way_m = NAN;
            const double expected = cos(brute_heading(rate, beats_s[i], index));
            TEST_ASSERT_TRUE(
                motion_forward(&motion, (uint16_t)index, (float)beats_s[i], &gain_m_s, &way_m));
            TEST_ASSERT_FLOAT_WITHIN(5e-4f, (float)expected, 10.0f * gain_m_s);
            TEST_ASSERT_FLOAT_WITHIN(5e-4f, (float)expected, 200.0f * way_m);
        }
    }
}

/* Somebody plays with the fish for a minute: attitude is still a rotation, and level is level. */
static void the_attitude_stays_a_rotation(void) {
    imu_frame_t frame = {.accel_m_s2 = {0.3f, -0.2f, (float)-G}};
    motion_begin(&motion, NULL, &frame);
    for (int i = 0; i < 3000; i++) {
        for (int axis = 0; axis < 3; axis++) {
            frame.rate_rad_s[axis] = (float)(40.0 * (uniform() - 0.5));
        }
        motion_push(&motion, &frame, 0.02f * (float)(i + 1), 0.02f);
    }
    double square = 0.0;
    for (int i = 0; i < 4; i++) {
        square += pow((double)motion.attitude.q[i] * 0x1p-61, 2.0);
    }
    TEST_ASSERT_FALSE(motion.lost);
    TEST_ASSERT_TRUE(fabs(square - 1.0) < 1e-6);
}

/* 0.73 rad within a frame can be followed, 0.77 cannot, nor can what is no number. */
static void what_cannot_be_followed_ends_the_motion(void) {
    const float rates_rad_s[] = {29.2f, 30.8f, 70.0f, NAN, INFINITY, -3e38f};
    for (size_t i = 0; i < sizeof rates_rad_s / sizeof rates_rad_s[0]; i++) {
        imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, (float)-G}};
        motion_begin(&motion, NULL, &frame);
        motion_push(&motion, &frame, 0.025f, 0.025f);
        for (int k = 2; k < 6; k++) {
            frame.rate_rad_s[1] += 0.25f * rates_rad_s[i];
            motion_push(&motion, &frame, 0.025f * (float)k, 0.025f);
        }
        TEST_ASSERT_EQUAL_INT(i > 0, motion.lost);
    }
    const imu_frame_t no_number = {.accel_m_s2 = {0.0f, NAN, (float)-G}};
    motion_begin(&motion, NULL, &no_number);
    motion_push(&motion, &no_number, 0.0025f, 0.0025f);
    TEST_ASSERT_TRUE(motion.lost);
}

static float extreme(float limit) {
    const double u = uniform();
    return u < 0.1 ? -limit : u < 0.2 ? limit : limit * (float)(2.0 * uniform() - 1.0);
}

/* All that the sensor can say, at 50 to 400 Hz: the sanitizers see any number that overflows. */
static void no_frame_overflows(void) {
    unsigned followed = 0;
    for (int i = 0; i < EXTREMES; i++) {
        const float dt_s = 0.0025f * (float)(1 + (i & 7)), share = i % 3 == 0 ? 1.0f : 0.3f;
        rest_mean_t mean = {0};
        for (int axis = 0; axis < 3; axis++) {
            mean.accel_m_s2[axis] = extreme(157.0f);
            mean.rate_rad_s[axis] = extreme(0.1f);
        }
        motion_begin(&motion, &mean, NULL);
        for (int k = 1; k < 50; k++) {
            imu_frame_t frame;
            for (int axis = 0; axis < 3; axis++) {
                frame.accel_m_s2[axis] = extreme(157.0f);
                frame.rate_rad_s[axis] = extreme(share * 34.9f);
            }
            const float gap = k % 7 == 0 ? 2.9f : 1.0f;
            motion_push(&motion, &frame, 10.0f + dt_s * (float)k, gap * dt_s);
        }
        for (uint16_t slot = 90; slot < 110; slot++) {
            float gain_m_s, way_m;
            (void)motion_forward(&motion, slot, extreme(5.0f), &gain_m_s, &way_m);
            (void)motion_turn(&motion, slot);
        }
        followed += !motion.lost;
    }
    TEST_ASSERT_GREATER_THAN_UINT(EXTREMES * 3 / 10, followed);
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(the_speed_of_a_swim_is_found);
    RUN_ON_HOST(any_phase_and_rate_will_do);
    RUN_ON_HOST(any_beat_will_do);
    RUN_ON_HOST(along_the_nose_it_would_be_metres_per_second);
    RUN_ON_HOST(a_wrong_tilt_shows_as_its_share_of_gravity);
    RUN_ON_HOST(a_rest_takes_the_gyroscopes_bias_away);
    RUN_TEST(without_a_rest_the_last_frame_stands_in);
    RUN_ON_HOST(a_turn_does_not_change_the_speed);
    RUN_ON_HOST(the_turns_of_a_swim_are_found);
    RUN_TEST(a_turn_is_about_the_vertical);
    RUN_TEST(a_turn_is_known_only_where_frames_cover_it);
    RUN_TEST(a_turn_beyond_the_numbers_is_unknown);
    RUN_TEST(times_may_waver);
    RUN_ON_HOST(lost_frames_are_bridged);
    RUN_TEST(a_long_gap_ends_the_motion);
    RUN_TEST(a_gap_of_50_ms_is_bridged_and_one_of_60_is_not);
    RUN_TEST(a_restart_ends_the_motion);
    RUN_TEST(the_first_frame_may_come_after_any_gap);
    RUN_TEST(only_time_after_the_start_counts);
    RUN_TEST(slots_get_exactly_their_share);
    RUN_TEST(the_ring_forgets_and_does_not_foresee);
    RUN_TEST(any_first_attitude_is_level);
    RUN_TEST(heading_is_averaged_over_a_beat_twice);
    RUN_TEST(the_attitude_stays_a_rotation);
    RUN_TEST(what_cannot_be_followed_ends_the_motion);
    RUN_TEST(no_frame_overflows);
    return UNITY_END();
}
