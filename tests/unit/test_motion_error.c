/*
 * What rounding costs: motion.c beside the same integration in double precision, on the same
 * samples, and beside the floating point that it replaced. Errors against the true motion are in
 * test_motion.c; they are those of the method.
 */
#include "speed/motion.h"

#include "motion_swim.h"
#include "target.h"
#include "unity.h"

#include <stdio.h>

#define REAL float
#define ROOT(x) sqrtf(x)
#define NAME(x) x##_float
#include "motion_plain.h"

#define REAL double
#define ROOT(x) sqrt(x)
#define NAME(x) x##_double
#include "motion_plain.h"

#define SWIM_S 40.0
#define RESTS 400u /* frames */

static motion_t motion;
static plain_t_float before;
static plain_t_double exact;
static uint32_t random_state;

/* The largest over the swim: of the speed along either level axis, of the way. */
typedef struct {
    double speed_m_s, way_m;
} error_t;

void setUp(void) {
    swim_as_usual();
    random_state = 4u;
}

void tearDown(void) {}

/* About normal, |sigma| 1. */
static double noise(void) {
    double sum = -6.0;
    for (int i = 0; i < 12; i++) {
        random_state = random_state * 1664525u + 1013904223u;
        sum += (double)(random_state >> 8) / 16777216.0;
    }
    return sum;
}

static imu_frame_t noisy_frame(double from_s, double to_s, double noisy) {
    imu_frame_t frame = frame_of(from_s, to_s);
    for (int i = 0; noisy > 0.0 && i < 3; i++) {
        frame.rate_rad_s[i] += (float)(1e-3 * noisy * noise());
        frame.accel_m_s2[i] += (float)(2e-2 * noisy * noise());
    }
    return frame;
}

static rest_mean_t rest_of(double dt_s, double noisy) {
    static rest_t rest;
    rest_mean_t mean;
    rest_init(&rest);
    for (unsigned i = 0; i < RESTS; i++) {
        const imu_frame_t frame = noisy_frame(-6.0, -6.0 + dt_s, noisy);
        rest_push(&rest, &frame, (float)dt_s);
    }
    TEST_ASSERT_TRUE(rest_get(&rest, &mean));
    return mean;
}

/* |gain| and |way| of slot |index| less the exact ones, summed up. */
typedef struct {
    double speed_m_s[2], way_m[2];
    error_t worst;
} sum_t;

static void add_slot(sum_t *sum, unsigned index, const double gain_m_s[2], const double way_m[2]) {
    for (unsigned i = 0; i < 2u; i++) {
        sum->way_m[i] += 0.1 * sum->speed_m_s[i] + way_m[i] - exact.way_m[index][i];
        sum->speed_m_s[i] += gain_m_s[i] - exact.gain_m_s[index][i];
        sum->worst.speed_m_s = fmax(sum->worst.speed_m_s, fabs(sum->speed_m_s[i]));
        sum->worst.way_m = fmax(sum->worst.way_m, fabs(sum->way_m[i]));
    }
}

static void add_slots(unsigned index, sum_t *now, sum_t *then) {
    const motion_slot_t *const slot = &motion.slots[index % MOTION_SLOTS];
    TEST_ASSERT_EQUAL_UINT(index, slot->index);
    const double gain_m_s[2] = {slot->gain[0] * 0x1p-29, slot->gain[1] * 0x1p-29};
    const double way_m[2] = {slot->way[0] * 0x1p-32, slot->way[1] * 0x1p-32};
    const double gain_before[2] = {(double)before.gain_m_s[index][0],
                                   (double)before.gain_m_s[index][1]};
    const double way_before[2] = {(double)before.way_m[index][0], (double)before.way_m[index][1]};
    add_slot(now, index, gain_m_s, way_m);
    add_slot(then, index, gain_before, way_before);
}

static void compare(const char *what, double rate_hz, double noisy) {
    const double dt_s = 1.0 / rate_hz;
    sum_t now = {0}, then = {0};
    const rest_mean_t mean = rest_of(dt_s, noisy);
    motion_begin(&motion, &mean, NULL);
    begin_float(&before, &mean);
    begin_double(&exact, &mean);
    unsigned closed = 0;
    for (unsigned i = 1; (double)i * dt_s <= SWIM_S; i++) {
        const double t = (double)i * dt_s;
        const imu_frame_t frame = noisy_frame(t - dt_s, t, noisy);
        motion_push(&motion, &frame, (float)t, (float)dt_s);
        push_float(&before, &frame, (float)t, (float)dt_s);
        push_double(&exact, &frame, (float)t, (float)dt_s);
        for (; closed < exact.index && closed < motion.index && closed < before.index; closed++) {
            add_slots(closed, &now, &then);
        }
    }
    TEST_ASSERT_GREATER_THAN_UINT(395, closed);
    printf("  %-24s %3.0f Hz  %9.3f %9.3f um/s  %9.3f %9.3f um\n", what, rate_hz,
           1e6 * now.worst.speed_m_s, 1e6 * then.worst.speed_m_s, 1e6 * now.worst.way_m,
           1e6 * then.worst.way_m);
    TEST_ASSERT_TRUE(now.worst.speed_m_s <= then.worst.speed_m_s);
    TEST_ASSERT_TRUE(now.worst.way_m <= then.worst.way_m);
}

static void each_rate(const char *what, double noisy) {
    compare(what, 100.0, noisy);
    compare(what, 200.0, noisy);
    compare(what, 400.0, noisy);
}

static void rounding_costs_no_more_than_in_floating_point(void) {
    printf("against double precision, 40 s; speed and way, fixed and floating point:\n");
    each_rate("a fish", 0.0);
    each_rate("a fish, noisy", 1.0);
    swim.roll_phase = swim.yaw_phase + PI / 2.0;
    each_rate("coning", 0.0);
    each_rate("coning, noisy", 1.0);
    swim.bias_rad_s[0] = 0.0041234;
    swim.bias_rad_s[1] = -0.0033333;
    swim.bias_rad_s[2] = 0.0077777;
    each_rate("coning, biased", 0.0);
    setUp();
    swim.tilt_rad[0] = swim.tilt_rad[1] = swim.roll_rad = swim.pitch_rad = 0.0;
    each_rate("level, yaw alone", 0.0);
    setUp();
    swim.turn_rad = -270.0 * DEG;
    swim.turn_at_s = 6.0;
    swim.turn_s = 20.0;
    each_rate("-270 degrees", 0.0);
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(rounding_costs_no_more_than_in_floating_point);
    return UNITY_END();
}
