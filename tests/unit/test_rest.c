#include "speed/rest.h"

#include "target.h"
#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define PI 3.14159265358979323846
#define G 9.81
#define DEG (PI / 180.0)

static rest_t rest;
static rest_mean_t mean;
static uint32_t random_state;
static double bias_rad_s[3];

void setUp(void) {
    rest_init(&rest);
    random_state = 7u;
    memset(bias_rad_s, 0, sizeof bias_rad_s);
}

void tearDown(void) {}

static double uniform(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return ((double)(random_state >> 8) + 0.5) / 16777216.0;
}

/* Deviation 1, near enough to normal. */
static double normal(void) {
    const double sum = uniform() + uniform() + uniform() + uniform();
    return sqrt(3.0) * (sum - 2.0);
}

/* What a motion adds to gravity and to the bias at one time. */
typedef void (*moving_t)(double t, double accel[3], double rate[3]);

static void still(double t, double accel[3], double rate[3]) { (void)t, (void)accel, (void)rate; }

/* Noise as specified: 0.14 mg and 0.0035 deg/s per root Hz, averaged over the frame: white up to
 * half the frame rate. */
static imu_frame_t frame_at(double t, double dt_s, moving_t moving) {
    double accel[3] = {0.1, -0.2, -G}, rate[3] = {bias_rad_s[0], bias_rad_s[1], bias_rad_s[2]};
    const double root_hz = sqrt(0.5 / dt_s);
    imu_frame_t frame = {0};
    moving(t, accel, rate);
    for (int i = 0; i < 3; i++) {
        frame.accel_m_s2[i] = (float)(accel[i] + 0.14e-3 * G * root_hz * normal());
        frame.rate_rad_s[i] = (float)(rate[i] + 0.0035 * DEG * root_hz * normal());
    }
    return frame;
}

static double now_s;

/* Returns the share of blocks after which it counted as still. */
static double push_for(double duration_s, double dt_s, moving_t moving) {
    int checks = 0, stills = 0;
    const int frames = (int)lround(duration_s / dt_s);
    for (int i = 0; i < frames; i++) {
        now_s += dt_s;
        const imu_frame_t frame = frame_at(now_s, dt_s, moving);
        rest_push(&rest, &frame, (float)dt_s);
        checks++;
        stills += rest_get(&rest, &mean);
    }
    return (double)stills / checks;
}

static void a_still_fish_is_still_at_any_rate(void) {
    const double rates_hz[] = {50.0, 100.0, 200.0, 400.0};
    const double lengths_s[] = {30.0, 20.0, 15.0, 12.0};
    const double bias[3] = {0.0005, -0.0002, -0.0037};
    for (int i = 0; i < 4; i++) {
        setUp();
        memcpy(bias_rad_s, bias, sizeof bias);
        (void)push_for(lengths_s[i], 1.0 / rates_hz[i], still);
        TEST_ASSERT_TRUE(rest_get(&rest, &mean));
        TEST_ASSERT_EQUAL_FLOAT((float)lengths_s[i], mean.still_s);
        TEST_ASSERT_EQUAL_FLOAT(10.0f, mean.mean_s);
        for (int axis = 0; axis < 3; axis++) {
            const double accel = axis == 0 ? 0.1 : axis == 1 ? -0.2 : -G;
            /* 4 sigma of a mean of 10 s */
            TEST_ASSERT_FLOAT_WITHIN(1.3e-3f, (float)accel, mean.accel_m_s2[axis]);
            TEST_ASSERT_FLOAT_WITHIN(6e-5f, (float)bias[axis], mean.rate_rad_s[axis]);
        }
    }
}

static void stillness_is_counted_in_blocks(void) {
    const imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, -9.81f}};
    for (int i = 0; i < 50 * 25; i++) {
        const bool known = rest_get(&rest, &mean);
        TEST_ASSERT_EQUAL_INT(i >= 50, known);
        if (known) {
            TEST_ASSERT_EQUAL_FLOAT(0.5f * (float)(i / 50), mean.still_s);
            TEST_ASSERT_EQUAL_FLOAT(0.5f * (float)(i / 50 < 20 ? i / 50 : 20), mean.mean_s);
        }
        rest_push(&rest, &frame, 0.01f);
    }
}

/* Frames that do not fill half a second: what is over goes to the next block. */
static void no_time_is_lost_between_blocks(void) {
    const imu_frame_t frame = {.accel_m_s2 = {0.0f, 0.0f, -9.81f}};
    for (int i = 0; i < 1000; i++) {
        rest_push(&rest, &frame, 0.03f);
    }
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    TEST_ASSERT_EQUAL_FLOAT(30.0f, mean.still_s);
}

/* Sums count from it, and it counts for no more than the others. */
static void an_odd_first_frame_does_not_hide_the_rest(void) {
    imu_frame_t frame = {.accel_m_s2 = {0.3f, 0.0f, -9.81f}, .rate_rad_s = {0.1f, 0.0f, 0.0f}};
    rest_push(&rest, &frame, 0.01f);
    frame = (imu_frame_t){.accel_m_s2 = {0.0f, 0.0f, -9.81f}};
    for (int i = 1; i < 200; i++) {
        rest_push(&rest, &frame, 0.01f);
    }
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    TEST_ASSERT_EQUAL_FLOAT(2.0f, mean.still_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.3f / 200.0f, mean.accel_m_s2[0]);
}

/* Against sums in double; the values carry an offset as large as gravity and a slow change. The
 * gyroscopes say the same all the time: then the angle is a line. */
static void the_mean_is_that_of_the_last_ten_seconds(void) {
    static const float constant_rad_s[3] = {0.001f, -0.002f, 0.003f};
    static float pushed[4000][6];
    double expected[6] = {0};
    for (int i = 0; i < 4000; i++) {
        imu_frame_t frame = frame_at(0.01 * i, 0.01, still);
        frame.accel_m_s2[0] += 1e-5f * (float)i;
        memcpy(frame.rate_rad_s, constant_rad_s, sizeof constant_rad_s);
        memcpy(pushed[i], frame.accel_m_s2, sizeof frame.accel_m_s2);
        memcpy(pushed[i] + 3, frame.rate_rad_s, sizeof frame.rate_rad_s);
        rest_push(&rest, &frame, 0.01f);
    }
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    for (int c = 0; c < 6; c++) {
        for (int i = 3000; i < 4000; i++) {
            expected[c] += (double)pushed[i][c] / 1000.0;
        }
        const float got = c < 3 ? mean.accel_m_s2[c] : mean.rate_rad_s[c - 3];
        TEST_ASSERT_TRUE(fabs((double)got - expected[c]) < (c < 3 ? 4e-6 : 1e-7));
    }
}

#define TREMBLE_RAD (0.05 * DEG)
#define TREMBLE_RAD_S (2.0 * PI * 3.7)

static void trembling(double t, double accel[3], double rate[3]) {
    accel[0] += G * TREMBLE_RAD * sin(TREMBLE_RAD_S * t);
    rate[1] += TREMBLE_RAD * TREMBLE_RAD_S * cos(TREMBLE_RAD_S * t);
}

/* Whenever the rest ends: the tilt is that of now, and no bias comes of where the hand is. */
static void a_trembling_hand_is_followed(void) {
    double worst_tilt_rad = 0, worst_bias_rad_s = 0;
    bias_rad_s[1] = 0.0002;
    now_s = 0;
    (void)push_for(5.0, 0.01, trembling);
    for (int i = 0; i < 100; i++) {
        (void)push_for(0.01, 0.01, trembling);
        const double now_rad = TREMBLE_RAD * sin(TREMBLE_RAD_S * now_s);
        const double tilt_rad = ((double)mean.accel_m_s2[0] - 0.1) / G;
        worst_tilt_rad = fmax(worst_tilt_rad, fabs(tilt_rad - now_rad));
        worst_bias_rad_s = fmax(worst_bias_rad_s, fabs((double)mean.rate_rad_s[1] - 0.0002));
    }
    printf("trembling by %.5f rad: tilt within %.5f rad, bias within %.6f rad/s\n", TREMBLE_RAD,
           worst_tilt_rad, worst_bias_rad_s);
    TEST_ASSERT_TRUE(worst_tilt_rad < 0.3 * TREMBLE_RAD);
    TEST_ASSERT_TRUE(worst_bias_rad_s < 0.3 * TREMBLE_RAD / 5.0);
    TEST_ASSERT_TRUE(mean.tilt_sigma_rad > 0.0f && mean.tilt_sigma_rad < (float)TREMBLE_RAD);
}

static double tremble_hz;

/* A hand: 1 deg/s and 0.05 m/s^2 of deviation on each axis, and the tilt that goes with it. */
static void held(double t, double accel[3], double rate[3]) {
    for (int axis = 0; axis < 3; axis++) {
        const double phase = 2.0 * PI * tremble_hz * (1.0 + 0.07 * axis) * t + 2.0 * axis;
        rate[axis] += sqrt(2.0) * DEG * cos(phase);
        accel[axis] += sqrt(2.0) * 0.05 * sin(1.1 * phase);
        if (axis < 2) {
            accel[axis] += G * sqrt(2.0) * DEG * sin(phase) / (2.0 * PI * tremble_hz);
        }
    }
}

static void a_held_fish_is_still(void) {
    const double trembles_hz[] = {0.5, 1.0, 3.0, 8.0};
    for (int i = 0; i < 4; i++) {
        setUp();
        tremble_hz = trembles_hz[i];
        TEST_ASSERT_TRUE(push_for(30.0, 0.01, held) > 0.98);
        TEST_ASSERT_EQUAL_FLOAT(30.0f, mean.still_s);
    }
}

static double yaw_deg;

/* Yaw and sway of a fish, once per second. */
static void swims(double t, double accel[3], double rate[3]) {
    rate[2] += yaw_deg * DEG * 2.0 * PI * cos(2.0 * PI * t);
    accel[1] += 0.04 * yaw_deg * sin(2.0 * PI * t + 0.5);
}

static void a_swimming_fish_is_not_still(void) {
    for (int i = 2; i <= 14; i += 4) {
        setUp();
        yaw_deg = i;
        for (int phase = 0; phase < 5; phase++) {
            rest_init(&rest);
            now_s = 0.1 * phase + 0.003 * i;
            TEST_ASSERT_TRUE(push_for(5.0, 0.01, swims) == 0.0);
        }
    }
}

/* Steps of a walk: twice a second, and what the hand cannot hold. */
static void carried(double t, double accel[3], double rate[3]) {
    accel[2] += 1.5 * sin(2.0 * PI * 2.0 * t);
    accel[0] += 0.5 * sin(2.0 * PI * 1.0 * t);
    rate[1] += 0.1 * sin(2.0 * PI * 1.0 * t);
}

static void gently_carried(double t, double accel[3], double rate[3]) {
    (void)rate;
    accel[2] += 0.4 * sin(2.0 * PI * 1.8 * t);
}

static void a_carried_fish_is_not_still(void) {
    TEST_ASSERT_TRUE(push_for(20.0, 0.01, carried) == 0.0);
    TEST_ASSERT_TRUE(push_for(20.0, 0.01, gently_carried) == 0.0);
}

static double turn_deg_s;

static void turns(double t, double accel[3], double rate[3]) {
    (void)t, (void)accel;
    rate[2] += turn_deg_s * DEG;
}

static void tilts(double t, double accel[3], double rate[3]) {
    rate[1] += turn_deg_s * DEG;
    accel[0] += G * sin(turn_deg_s * DEG * t);
}

/* Nobody asks for less than 5 s of rest. */
static double longest_rest_s(moving_t moving) {
    double longest_s = 0.0;
    rest_init(&rest);
    now_s = 0.0;
    for (int i = 0; i < 24; i++) {
        if (push_for(0.5, 0.01, moving) > 0.0 && rest_get(&rest, &mean)) {
            longest_s = fmax(longest_s, (double)mean.still_s);
        }
    }
    return longest_s;
}

static void a_slow_turn_is_not_rest(void) {
    const double rates_deg_s[] = {1.0, -1.5, 3.0, 10.0};
    for (int i = 0; i < 4; i++) {
        turn_deg_s = rates_deg_s[i];
        const double turned_s = longest_rest_s(turns);
        printf("turning by %.1f deg/s: still for %.1f s\n", turn_deg_s, turned_s);
        TEST_ASSERT_TRUE(turned_s < 5.0);
        TEST_ASSERT_TRUE(longest_rest_s(tilts) < 5.0);
    }
    turn_deg_s = 10.0;
    TEST_ASSERT_TRUE(longest_rest_s(turns) == 0.0);
    turn_deg_s = 0.25; /* a bias of that size is in order, a tilt is not */
    TEST_ASSERT_TRUE(longest_rest_s(turns) == 12.0);
    turn_deg_s = 0.5;
    TEST_ASSERT_TRUE(longest_rest_s(tilts) < 8.0);
}

static void motion_ends_a_rest_and_rest_begins_anew(void) {
    yaw_deg = 10.0;
    now_s = 0.0;
    (void)push_for(8.0, 0.01, still);
    TEST_ASSERT_EQUAL_FLOAT(8.0f, mean.still_s);
    (void)push_for(0.5, 0.01, swims);
    TEST_ASSERT_FALSE(rest_get(&rest, &mean));
    (void)push_for(3.0, 0.01, still);
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    TEST_ASSERT_EQUAL_FLOAT(3.0f, mean.still_s);
    TEST_ASSERT_EQUAL_FLOAT(3.0f, mean.mean_s);
    TEST_ASSERT_FLOAT_WITHIN(2e-4f, 0.0f, mean.rate_rad_s[2]);
}

static void lies_otherwise(double t, double accel[3], double rate[3]) {
    (void)t, (void)rate;
    accel[0] += 0.5;
}

/* Turned about while nobody looked: quiet, but down is elsewhere. */
static void another_attitude_is_another_rest(void) {
    (void)push_for(8.0, 0.01, still);
    (void)push_for(2.0, 0.01, lies_otherwise);
    TEST_ASSERT_EQUAL_FLOAT(2.0f, mean.still_s);
    TEST_ASSERT_FLOAT_WITHIN(2e-3f, 0.6f, mean.accel_m_s2[0]);
}

static void gaps_and_restarts_break_the_rest(void) {
    const float breaks_s[] = {0.0f, 0.101f, 5.0f, -0.01f, NAN, INFINITY};
    const imu_frame_t frame = frame_at(0.0, 0.01, still);
    for (size_t i = 0; i < sizeof breaks_s / sizeof breaks_s[0]; i++) {
        (void)push_for(3.0, 0.01, still);
        TEST_ASSERT_TRUE(rest_get(&rest, &mean));
        rest_push(&rest, &frame, breaks_s[i]);
        TEST_ASSERT_FALSE(rest_get(&rest, &mean));
    }
    (void)push_for(3.0, 0.01, still);
    rest_push(&rest, &frame, 0.1f);
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(a_still_fish_is_still_at_any_rate);
    RUN_TEST(stillness_is_counted_in_blocks);
    RUN_TEST(no_time_is_lost_between_blocks);
    RUN_TEST(an_odd_first_frame_does_not_hide_the_rest);
    RUN_TEST(the_mean_is_that_of_the_last_ten_seconds);
    RUN_TEST(a_trembling_hand_is_followed);
    RUN_ON_HOST(a_held_fish_is_still);
    RUN_TEST(a_swimming_fish_is_not_still);
    RUN_TEST(a_carried_fish_is_not_still);
    RUN_TEST(a_slow_turn_is_not_rest);
    RUN_TEST(motion_ends_a_rest_and_rest_begins_anew);
    RUN_TEST(another_attitude_is_another_rest);
    RUN_TEST(gaps_and_restarts_break_the_rest);
    return UNITY_END();
}
