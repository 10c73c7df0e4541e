/* Weights and means of earlier trials, against the formulas in double. */
#include "ilc/past.h"

#include "mock_hal.h"
#include "unity.h"

#include <math.h>
#include <stddef.h>

#define BEATS 5u

static const law_t law = {
    .kp_rad_s_m = 4.0f, .amplitude_max_rad = 0.8f, .beat_s = 1.0f, .q_len = 1};

void setUp(void) {}
void tearDown(void) {}

static void expect_weights(double input, double kp, double kd, law_weights_t found) {
    TEST_ASSERT_FLOAT_WITHIN(2e-6f, (float)input, found.input);
    TEST_ASSERT_FLOAT_WITHIN(2e-6f + 2e-7f * (float)kp, (float)kp, found.kp);
    TEST_ASSERT_FLOAT_WITHIN(2e-6f, (float)kd, found.kd);
}

/* (2.10) in iteration i = ended - 1: the mean over ended trials, with i + 2 times the gain. */
static void test_the_mean_and_its_growing_gain(void) {
    expect_weights(0.0, 0.0, 0.0, past_mean_before(1));
    expect_weights(1.0, 2.0, 0.0, past_mean_now(1));
    expect_weights(2.0 / 3.0, 8.0 / 3.0, 0.0, past_mean_before(3));
    expect_weights(1.0 / 3.0, 4.0 / 3.0, 0.0, past_mean_now(3));
    const law_weights_t before = past_mean_before(40), now = past_mean_now(40);
    expect_weights(1.0, 41.0, 0.0,
                   (law_weights_t){before.input + now.input, before.kp + now.kp, 0.0f});
}

static void test_the_means_are_those_of_all_trials(void) {
    float mean_rad[BEATS] = {0}, mean_error[BEATS] = {0};
    double sum_rad[BEATS] = {0}, sum_error[BEATS] = {0};
    for (uint32_t ended = 1; ended <= 50u; ended++) {
        float amplitude[BEATS], error[BEATS];
        uint8_t measured[BEATS];
        for (uint32_t k = 0; k < BEATS; k++) {
            amplitude[k] = 0.03f * (float)((ended * 7u + k * 11u) % 40u) - 0.2f;
            error[k] = 0.01f * (float)((ended * 5u + k * 3u) % 13u) - 0.06f;
            measured[k] = (ended + k) % 4u != 0;
            sum_rad[k] += fmin(fmax((double)amplitude[k], 0.0), 0.8);
            sum_error[k] += measured[k] != 0 ? (double)error[k] : 0.0;
        }
        const law_trial_t trial = {.beats = BEATS, .error_m_s = error, .measured = measured};
        past_mean_add(&law, ended, &trial, amplitude, mean_rad, mean_error);
        for (uint32_t k = 0; k < BEATS; k++) {
            TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)(sum_rad[k] / ended), mean_rad[k]);
            TEST_ASSERT_FLOAT_WITHIN(1e-7f, (float)(sum_error[k] / ended), mean_error[k]);
        }
    }
}

static void test_a_trial_without_a_mask_is_measured(void) {
    const float amplitude[BEATS] = {0.1f, 0.2f, 0.3f, 0.4f, 0.9f};
    const float error[BEATS] = {0.01f, 0.02f, 0.03f, 0.04f, 0.05f};
    float mean_rad[BEATS] = {0}, mean_error[BEATS] = {0};
    const law_trial_t trial = {.beats = BEATS, .error_m_s = error};
    past_mean_add(&law, 1, &trial, amplitude, mean_rad, mean_error);
    TEST_ASSERT_EQUAL_FLOAT_ARRAY(error, mean_error, BEATS);
    TEST_ASSERT_EQUAL_FLOAT(0.4f, mean_rad[3]);
    TEST_ASSERT_EQUAL_FLOAT(0.8f, mean_rad[4]);
}

static void test_a_growing_window_divides_by_what_is_there(void) {
    const law_weights_t weights[3] = {{0.5f, 1.0f, 2.0f}, {0.3f, 0.5f, 1.0f}, {0.2f, 0.25f, 1.0f}};
    expect_weights(1.0, 1.75, 4.0, past_window_weight(weights, 3, 1, 0));
    expect_weights(0.5 / 0.8, 1.0 * 1.75 / 1.5, 2.0 * 4.0 / 3.0,
                   past_window_weight(weights, 3, 2, 0));
    expect_weights(0.3 / 0.8, 0.5 * 1.75 / 1.5, 1.0 * 4.0 / 3.0,
                   past_window_weight(weights, 3, 2, 1));
    expect_weights(0.2, 0.25, 1.0, past_window_weight(weights, 3, 3, 2));
}

/* A law whose weights add up to nothing has no part to divide by. */
static void test_weights_without_a_sum_stay(void) {
    const law_weights_t weights[2] = {{0.0f, 0.0f, 0.0f}, {1.0f, 1.0f, 0.0f}};
    expect_weights(0.0, 0.0, 0.0, past_window_weight(weights, 2, 1, 0));
    expect_weights(1.0, 1.0, 0.0, past_window_weight(weights, 2, 2, 1));
}

static void test_a_moving_average_has_even_weights(void) {
    for (uint32_t window = 1; window <= PAST_WINDOW_MAX; window++) {
        for (uint32_t present = 1; present <= window; present++) {
            const double even = 1.0 / present;
            expect_weights(even, even, even, past_average_weight(window, present));
        }
    }
    static bool panicked;
    MOCK_EXPECT_PANIC(panicked, (void)past_average_weight(PAST_WINDOW_MAX + 1u, 1));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, (void)past_average_weight(3, 0));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, (void)past_average_weight(3, 4));
    TEST_ASSERT_TRUE(panicked);
}

static void test_only_the_mean_goes_without_kd(void) {
    law_t with = law;
    with.kd_rad_s2_m = -0.5f;
    TEST_ASSERT_TRUE(past_fits(PAST_MEAN, &law));
    TEST_ASSERT_FALSE(past_fits(PAST_MEAN, &with));
    TEST_ASSERT_TRUE(past_fits(PAST_LAST, &with));
    TEST_ASSERT_TRUE(past_fits(PAST_WINDOW, &with));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_mean_and_its_growing_gain);
    RUN_TEST(test_the_means_are_those_of_all_trials);
    RUN_TEST(test_a_trial_without_a_mask_is_measured);
    RUN_TEST(test_a_growing_window_divides_by_what_is_there);
    RUN_TEST(test_weights_without_a_sum_stay);
    RUN_TEST(test_a_moving_average_has_even_weights);
    RUN_TEST(test_only_the_mean_goes_without_kd);
    return UNITY_END();
}
