#include "speed/thrust.h"

#include "target.h"
#include "unity.h"

#include <math.h>

#define PI 3.14159265358979323846
#define BEATS 40u

static thrust_config_t config;
static thrust_t thrust;
static uint64_t random_state;

void setUp(void) {
    config = (thrust_config_t){
        .kappa_per_m = 10.0f, .slope_m_s_rad = 0.219f, .dead_zone_rad = 0.197f, .delay_s = 0.3f};
    random_state = 5u;
}

void tearDown(void) {}

static double between(double low, double high) {
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return low + (high - low) * (double)(random_state >> 40) / 16777216.0;
}

static double steady(double amplitude_rad) {
    const double beyond = amplitude_rad - (double)config.dead_zone_rad;
    return beyond > 0 ? (double)config.slope_m_s_rad * beyond : 0;
}

static void test_steady_speeds_of_table_8_1(void) {
    const double amplitude_rad[] = {PI / 4, 7 * PI / 36, 5 * PI / 36};
    const double speed_m_s[] = {0.12762, 0.09282, 0.05117};
    for (unsigned i = 0; i < 3; i++) {
        thrust_init(&thrust, &config, 1.0f);
        float mean = 0.0f;
        for (unsigned k = 0; k < BEATS; k++) {
            mean = thrust_beat(&thrust, (float)amplitude_rad[i]);
        }
        TEST_ASSERT_DOUBLE_WITHIN(2.3e-3, speed_m_s[i], (double)mean); /* the line misses by that */
        TEST_ASSERT_DOUBLE_WITHIN(1e-6, steady(amplitude_rad[i]), (double)mean);
    }
}

static double way_from_rest(double end, double t_s) {
    const double k = (double)config.kappa_per_m;
    return t_s > 0 ? log(cosh(end * k * t_s)) / k : 0;
}

static void test_from_rest_as_solved_exactly(void) {
    const double end = steady(0.6);
    thrust_init(&thrust, &config, 1.0f);
    for (unsigned k = 0; k < 8; k++) {
        const double since = (double)k - (double)config.delay_s;
        const double way = way_from_rest(end, since + 1) - way_from_rest(end, since);
        TEST_ASSERT_DOUBLE_WITHIN(2e-5, way, (double)thrust_beat(&thrust, 0.6f));
    }
}

static void test_coasting_as_solved_exactly(void) {
    thrust_init(&thrust, &config, 1.0f);
    for (unsigned k = 0; k < BEATS; k++) {
        (void)thrust_beat(&thrust, 0.6f);
    }
    const double from = steady(0.6);
    const double kappa = (double)config.kappa_per_m;
    (void)thrust_beat(&thrust, 0.0f); /* thrust ends 0.3 s into it */
    for (unsigned k = 1; k < BEATS; k++) {
        const double begin = (double)k - (double)config.delay_s;
        const double way =
            (log1p(kappa * from * (begin + 1)) - log1p(kappa * from * begin)) / kappa;
        TEST_ASSERT_DOUBLE_WITHIN(2e-5, way, (double)thrust_beat(&thrust, 0.0f));
    }
}

/* Steps of a thousandth of a beat in double. Delays that are whole steps of the code's are exact,
 * others are off by at most half of one. */
static void compare_with_fine_steps(double beat_s, double allowed_m_s) {
    static double amplitude_rad[BEATS];
    const unsigned fine = 1000;
    const double dt = beat_s / fine;
    double v = 0;
    thrust_init(&thrust, &config, (float)beat_s);
    for (unsigned k = 0; k < BEATS; k++) {
        amplitude_rad[k] = k % 7u == 6u ? 0 : between(0, 0.785);
        double way = 0;
        for (unsigned i = 0; i < fine; i++) {
            const double at = (double)k + (i + 0.5) / fine - (double)config.delay_s / beat_s;
            const double end = at < 0 ? 0 : steady(amplitude_rad[(unsigned)at]);
            const double half = v + 0.5 * dt * (double)config.kappa_per_m * (end * end - v * v);
            v += dt * (double)config.kappa_per_m * (end * end - half * half);
            way += half * dt;
        }
        const double mean = (double)thrust_beat(&thrust, (float)amplitude_rad[k]);
        TEST_ASSERT_DOUBLE_WITHIN(allowed_m_s, way / beat_s, mean);
    }
    TEST_ASSERT_DOUBLE_WITHIN(allowed_m_s, v, (double)thrust.speed_m_s);
}

static void test_equals_fine_steps(void) {
    const float delays_s[] = {0.0f, 0.05f, 0.3f, 1.0f, 1.75f, 4.0f};
    for (unsigned i = 0; i < 6; i++) {
        config.delay_s = delays_s[i];
        compare_with_fine_steps(1.0, 5e-5);
    }
    config.kappa_per_m = 20.0f;
    config.delay_s = 0.6f;
    compare_with_fine_steps(2.0, 3e-4);
    config.kappa_per_m = 2.5f;
    config.delay_s = 0.26f;
    compare_with_fine_steps(0.8, 2e-3);
}

/* Beyond all fish: nothing overshoots, nothing turns negative. */
static void test_stable_for_any_kappa(void) {
    for (unsigned i = 0; i < 100; i++) {
        config.kappa_per_m = (float)pow(10, between(-3, 6));
        config.slope_m_s_rad = (float)between(0, 2);
        thrust_init(&thrust, &config, 4.0f);
        for (unsigned k = 0; k < 20; k++) {
            const float mean = thrust_beat(&thrust, k < 12 ? 0.785f : 0.0f);
            TEST_ASSERT_TRUE(mean >= 0.0f && (double)mean <= steady(0.785) * 1.00001);
        }
    }
}

static void test_nothing_moves_below_the_dead_zone(void) {
    thrust_init(&thrust, &config, 1.0f);
    for (unsigned k = 0; k < BEATS; k++) {
        TEST_ASSERT_EQUAL_FLOAT(0.0f, thrust_beat(&thrust, 0.19f));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_steady_speeds_of_table_8_1);
    RUN_TEST(test_from_rest_as_solved_exactly);
    RUN_TEST(test_coasting_as_solved_exactly);
    RUN_ON_HOST(test_equals_fine_steps);
    RUN_TEST(test_stable_for_any_kappa);
    RUN_TEST(test_nothing_moves_below_the_dead_zone);
    return UNITY_END();
}
