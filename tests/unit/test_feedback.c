/* The estimator laws against hand-made numbers and the C library's tanh. */
#include "feedback.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define CHANNELS 2u
#define ESTIMATES 3u

static feedback_rule_t rules[ESTIMATES];
static feedback_t law;
static float error[CHANNELS], ahead[CHANNELS], gain[CHANNELS], phi[ESTIMATES * CHANNELS];
static feedback_moment_t moment;
static float old[ESTIMATES], now[ESTIMATES], input[CHANNELS];

/* Numbers whose sums and products are exact in float. */
void setUp(void) {
    for (uint32_t j = 0; j < ESTIMATES; j++) {
        rules[j] = (feedback_rule_t){.gain = 0.5f, .low = -100.0f, .high = 100.0f};
    }
    law = (feedback_t){.channels = CHANNELS,
                       .estimates = ESTIMATES,
                       .gamma = {2.0f, 1.0f},
                       .input_gain_min = 0.25f,
                       .rules = rules};
    memcpy(error, (float[]){0.5f, -0.25f}, sizeof error);
    memcpy(ahead, (float[]){1.0f, 3.0f}, sizeof ahead);
    memcpy(gain, (float[]){2.0f, -0.5f}, sizeof gain);
    memcpy(phi, (float[]){-4.0f, 0.0f, 0.0f, 2.0f, 1.0f, 8.0f}, sizeof phi);
    memcpy(old, (float[]){1.0f, -2.0f, 0.5f}, sizeof old);
    moment =
        (feedback_moment_t){.error = error, .feed_forward = ahead, .input_gain = gain, .phi = phi};
    memset(now, 0x55, sizeof now);
    memset(input, 0x55, sizeof input);
}
void tearDown(void) {}

static feedback_result_t step(void) { return feedback_step(&law, &moment, old, now, input); }

static void check_now(float first, float second, float third) {
    TEST_ASSERT_EQUAL_FLOAT(first, now[0]);
    TEST_ASSERT_EQUAL_FLOAT(second, now[1]);
    TEST_ASSERT_EQUAL_FLOAT(third, now[2]);
}

static void check_refused(feedback_result_t expected) {
    float untouched[ESTIMATES + CHANNELS];
    memset(untouched, 0x55, sizeof untouched);
    TEST_ASSERT_EQUAL(expected, step());
    TEST_ASSERT_EQUAL_MEMORY(untouched, now, sizeof now);
    TEST_ASSERT_EQUAL_MEMORY(untouched, input, sizeof input);
}

static void test_estimates_are_updated_first_and_then_used(void) {
    TEST_ASSERT_EQUAL(FEEDBACK_OK, feedback_check(&law));
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    /* 1 + 0.5*(-4*0.5), -2 + 0.5*(2*-0.25), 0.5 + 0.5*(0.5 - 8*0.25) */
    check_now(0.0f, -2.25f, -0.25f);
    /* (2*0.5 + 1 + 0 - 0.25)/2, (-0.25 + 3 - 4.5 - 2)/-0.5 */
    TEST_ASSERT_EQUAL_FLOAT(0.875f, input[0]);
    TEST_ASSERT_EQUAL_FLOAT(7.5f, input[1]);
}

static void test_estimates_may_be_written_over_the_old_ones(void) {
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    float expected[ESTIMATES];
    memcpy(expected, now, sizeof expected);
    const float first = input[0];
    TEST_ASSERT_EQUAL(FEEDBACK_OK, feedback_step(&law, &moment, old, old, input));
    TEST_ASSERT_EQUAL_MEMORY(expected, old, sizeof old);
    TEST_ASSERT_EQUAL_FLOAT(first, input[0]);
}

static void test_leak_divides_old_and_new_alike(void) {
    rules[1].leak = 0.125f;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    check_now(0.0f, -2.0f, -0.25f);
}

static void test_no_estimate_leaves_its_limits(void) {
    rules[0].low = 0.25f;
    rules[2].high = -1.0f;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    check_now(0.25f, -2.25f, -1.0f);
    /* (1 + 1 - 4*0.25 - 1)/2: what is used is what is kept. */
    TEST_ASSERT_EQUAL_FLOAT(0.0f, input[0]);
}

static void test_errors_in_the_dead_zone_teach_nothing(void) {
    rules[2].dead_zone = 0.25f;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    check_now(0.0f, -2.25f, 0.75f);
    rules[2].dead_zone = 0.5f;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    check_now(0.0f, -2.25f, 0.5f);
    TEST_ASSERT_EQUAL_FLOAT((1.0f + 1.0f + 0.5f) / 2.0f, input[0]);
}

static void test_frozen_uses_without_learning_or_leaking(void) {
    moment.frozen = true;
    rules[1].leak = 1.0f;
    rules[2].low = 1.0f;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
    check_now(1.0f, -2.0f, 1.0f);
    TEST_ASSERT_EQUAL_FLOAT((1.0f + 1.0f - 4.0f + 1.0f) / 2.0f, input[0]);
}

static void test_without_estimates_it_is_plain_feedback(void) {
    law.estimates = 0;
    law.rules = NULL;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, feedback_check(&law));
    TEST_ASSERT_EQUAL(FEEDBACK_OK, feedback_step(&law, &moment, NULL, NULL, input));
    TEST_ASSERT_EQUAL_FLOAT(1.0f, input[0]);
    TEST_ASSERT_EQUAL_FLOAT(-5.5f, input[1]);
}

static void test_what_is_not_finite_is_refused(void) {
    float *const places[] = {&error[1], &ahead[0], &gain[1], &phi[5], &old[2]};
    const float bad[] = {(float)NAN, (float)INFINITY, (float)-INFINITY};
    for (size_t i = 0; i < sizeof places / sizeof *places; i++) {
        for (size_t j = 0; j < sizeof bad / sizeof *bad; j++) {
            const float good = *places[i];
            *places[i] = bad[j];
            check_refused(FEEDBACK_BAD_INPUT);
            *places[i] = good;
        }
    }
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
}

static void test_a_result_that_overflows_is_refused(void) {
    ahead[1] = 3e38f;
    check_refused(FEEDBACK_BAD_INPUT);
    ahead[1] = 3.0f;
    /* The estimate would be infinity less infinity. */
    phi[4] = 3e38f;
    phi[5] = 3e38f;
    error[0] = 1e30f;
    error[1] = -1e30f;
    check_refused(FEEDBACK_BAD_INPUT);
}

static void test_a_vanishing_input_gain_is_refused(void) {
    gain[1] = -0.2499f;
    check_refused(FEEDBACK_NO_AUTHORITY);
    gain[1] = 0.0f;
    check_refused(FEEDBACK_NO_AUTHORITY);
    gain[1] = 0.25f;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, step());
}

static void check_bad(float *place, float value) {
    const float good = *place;
    *place = value;
    TEST_ASSERT_EQUAL(FEEDBACK_BAD_CONFIG, feedback_check(&law));
    *place = good;
    TEST_ASSERT_EQUAL(FEEDBACK_OK, feedback_check(&law));
}

static void test_configs_that_make_no_sense_are_refused(void) {
    check_bad(&law.gamma[1], -0.1f);
    check_bad(&law.gamma[0], (float)NAN);
    check_bad(&law.input_gain_min, 0.0f);
    check_bad(&law.input_gain_min, (float)INFINITY);
    check_bad(&rules[2].gain, 0.0f);
    check_bad(&rules[2].gain, (float)INFINITY);
    check_bad(&rules[0].leak, -0.1f);
    check_bad(&rules[0].leak, (float)NAN);
    check_bad(&rules[1].dead_zone, -0.1f);
    check_bad(&rules[1].low, 100.5f);
    check_bad(&rules[1].low, (float)-INFINITY);
    check_bad(&rules[1].high, (float)NAN);
    law.rules = NULL;
    TEST_ASSERT_EQUAL(FEEDBACK_BAD_CONFIG, feedback_check(&law));
    law.rules = rules;
    law.channels = 0;
    TEST_ASSERT_EQUAL(FEEDBACK_BAD_CONFIG, feedback_check(&law));
    law.channels = FEEDBACK_CHANNELS_MAX + 1u;
    TEST_ASSERT_EQUAL(FEEDBACK_BAD_CONFIG, feedback_check(&law));
}

static void test_between_nodes(void) {
    const float bank[] = {0.0f, 10.0f, 1.0f, 20.0f, 5.0f, 0.0f};
    const struct {
        float position, first, second;
    } rows[] = {{0.0f, 0.0f, 10.0f},  {0.25f, 0.25f, 12.5f},     {1.0f, 1.0f, 20.0f},
                {1.5f, 3.0f, 10.0f},  {2.0f, 5.0f, 0.0f},        {1e30f, 5.0f, 0.0f},
                {-1.0f, 0.0f, 10.0f}, {(float)NAN, 0.0f, 10.0f}, {(float)INFINITY, 5.0f, 0.0f}};
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        float out[2];
        feedback_between(bank, 3, 2, rows[i].position, out);
        TEST_ASSERT_EQUAL_FLOAT(rows[i].first, out[0]);
        TEST_ASSERT_EQUAL_FLOAT(rows[i].second, out[1]);
    }
    float out[2];
    feedback_between(bank, 1, 2, 0.5f, out);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, out[0]);
}

static void test_direction(void) {
    float direction[CHANNELS];
    feedback_direction(CHANNELS, (float[]){1.5f, 8.0f}, (float[]){2.0f, -0.5f}, 0.0f, direction);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.6f, direction[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, -0.8f, direction[1]);
    feedback_direction(CHANNELS, (float[]){1.5f, 8.0f}, (float[]){2.0f, -0.5f}, 5.0f, direction);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.3f, direction[0]);
    feedback_direction(CHANNELS, (float[]){3e-30f, 4e-30f}, (float[]){1.0f, 1.0f}, 0.0f, direction);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.6f, direction[0]);
    feedback_direction(CHANNELS, (float[]){0.0f, 0.0f}, (float[]){1.0f, 1.0f}, 0.0f, direction);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, direction[0]);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, direction[1]);
}

static void test_reserve_against_an_uncertain_gain(void) {
    feedback_reserve_t reserve = {.kappa = 0.5f,
                                  .xi = 0.5f,
                                  .gamma_norm = 3.0f,
                                  .error_norm = 2.0f,
                                  .inverse_gain_norm = 0.5f,
                                  .root_channels = 2.0f,
                                  .alpha = 4.0f,
                                  .theta = -0.25f,
                                  .beta = 3.0f,
                                  .eta = -1.0f};
    /* 0.5 * ((3*2 + 2*4*0.25)*0.5 + 3*1) / (1 - 0.5) */
    TEST_ASSERT_EQUAL_FLOAT(7.0f, feedback_reserve(&reserve));
    reserve.smooth = true;
    const float theta = 0.25f * tanhf(0.25f);
    const float eta = tanhf(1.0f);
    TEST_ASSERT_FLOAT_WITHIN(2e-6f, (6.0f + 8.0f * theta) * 0.5f + 3.0f * eta,
                             feedback_reserve(&reserve));
}

static void test_sign(void) {
    TEST_ASSERT_EQUAL_FLOAT(1.0f, feedback_sign(1e-38f));
    TEST_ASSERT_EQUAL_FLOAT(-1.0f, feedback_sign(-3.0f));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, feedback_sign(0.0f));
}

static void test_tanh_against_the_library(void) {
    for (int i = 0; i <= 40000; i++) {
        const float x = 12.0f * (float)i / 40000.0f;
        const float value = feedback_tanh(x);
        TEST_ASSERT_DOUBLE_WITHIN(1e-7, tanh((double)x), (double)value);
        TEST_ASSERT_EQUAL_FLOAT(-value, feedback_tanh(-x));
    }
}

static void test_tanh_of_small_and_of_endless_values(void) {
    for (float x = 1e-38f; x < 1e-2f; x *= 1.37f) {
        TEST_ASSERT_FLOAT_WITHIN(3e-7f * x, tanhf(x), feedback_tanh(x));
    }
    TEST_ASSERT_EQUAL_FLOAT(1.0f, feedback_tanh(1e30f));
    TEST_ASSERT_EQUAL_FLOAT(1.0f, feedback_tanh((float)INFINITY));
    TEST_ASSERT_EQUAL_FLOAT(-1.0f, feedback_tanh((float)-INFINITY));
    TEST_ASSERT_TRUE(isnan(feedback_tanh((float)NAN)));
    TEST_ASSERT_EQUAL_FLOAT(0.0f, feedback_tanh(0.0f));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_estimates_are_updated_first_and_then_used);
    RUN_TEST(test_estimates_may_be_written_over_the_old_ones);
    RUN_TEST(test_leak_divides_old_and_new_alike);
    RUN_TEST(test_no_estimate_leaves_its_limits);
    RUN_TEST(test_errors_in_the_dead_zone_teach_nothing);
    RUN_TEST(test_frozen_uses_without_learning_or_leaking);
    RUN_TEST(test_without_estimates_it_is_plain_feedback);
    RUN_TEST(test_what_is_not_finite_is_refused);
    RUN_TEST(test_a_result_that_overflows_is_refused);
    RUN_TEST(test_a_vanishing_input_gain_is_refused);
    RUN_TEST(test_configs_that_make_no_sense_are_refused);
    RUN_TEST(test_between_nodes);
    RUN_TEST(test_direction);
    RUN_TEST(test_reserve_against_an_uncertain_gain);
    RUN_TEST(test_sign);
    RUN_TEST(test_tanh_against_the_library);
    RUN_TEST(test_tanh_of_small_and_of_endless_values);
    return UNITY_END();
}
