/* The learner against hand-made numbers, the formulas of the thesis and its own memory's edges. */
#include "learner.h"

#include "target.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846
#define SAMPLES 3u
#define PLANT_SAMPLES 51u
#define GUARD_BYTES 16u
#define GUARD 0xA5u
#define MEMORY_BYTES 4096u

static buffer_learner_config_t config;
static buffer_learner_t learner;
static law_report_t report;
static _Alignas(8) uint8_t memory[MEMORY_BYTES + GUARD_BYTES];

void setUp(void) {
    config = (buffer_learner_config_t){
        .law = {.kp_rad_s_m = 1.0f,
                .amplitude_min_rad = -100.0f,
                .amplitude_max_rad = 100.0f,
                .beat_s = 1.0f,
                .q_len = 1,
                .tail = LAW_TAIL_KEEP},
        .samples = SAMPLES,
    };
    memset(&report, 0x55, sizeof report);
    memset(memory, GUARD, sizeof memory);
}
void tearDown(void) {}

static void begin(const float *first) {
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_init(&learner, &config, first, memory, MEMORY_BYTES));
}

static void swim(const float *errors, uint16_t valid) {
    for (uint16_t k = 0; k < config.samples; k++) {
        TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_measure(&learner, k, errors[k]));
    }
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, valid, &report));
}

static void check(const float *expected) {
    for (uint16_t k = 0; k < config.samples; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, expected[k], buffer_learner_output(&learner, k));
    }
}

static void use_window(uint16_t window, buffer_learner_history_t history) {
    config.past = PAST_WINDOW;
    config.window = window;
    config.history = history;
}

static void test_last_is_the_p_law(void) {
    config.law.kp_rad_s_m = 0.5f;
    config.law.lead_beats = 1;
    begin((float[]){0.1f, 0.2f, 0.3f});
    check((float[]){0.1f, 0.2f, 0.3f});
    swim((float[]){9.0f, 0.4f, -0.2f}, SAMPLES);
    check((float[]){0.3f, 0.1f, 0.3f});
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 9.0f, report.max_abs_error_m_s);
    TEST_ASSERT_EQUAL(3, report.measured_beats);
    swim((float[]){0.0f, 0.2f, 0.2f}, SAMPLES);
    check((float[]){0.4f, 0.2f, 0.3f});
}

static void test_without_a_first_input_it_starts_from_zero(void) {
    begin(NULL);
    check((float[]){0.0f, 0.0f, 0.0f});
}

/* (2.10) from its sums: u_0 = (.1 .2 .3), L = .5; u_1 = u_0 + 2 L e_0, u_2 = (u_0 + u_1)/2 +
 * 3/2 L (e_0 + e_1), u_3 = (u_0 + u_1 + u_2)/3 + 4/3 L (e_0 + e_1 + e_2). */
static void test_mean_is_the_iteration_average(void) {
    config.past = PAST_MEAN;
    config.law.kp_rad_s_m = 0.5f;
    begin((float[]){0.1f, 0.2f, 0.3f});
    swim((float[]){0.4f, -0.2f, 0.0f}, SAMPLES);
    check((float[]){0.5f, 0.0f, 0.3f});
    swim((float[]){0.2f, 0.2f, 0.4f}, SAMPLES);
    check((float[]){0.75f, 0.1f, 0.6f});
    swim((float[]){-0.6f, 0.3f, 0.2f}, SAMPLES);
    check((float[]){0.45f, 0.3f, 0.8f});
}

static void test_a_cut_trial_counts_in_the_mean_with_its_input_and_no_error(void) {
    config.past = PAST_MEAN;
    config.law.kp_rad_s_m = 0.5f;
    begin((float[]){0.1f, 0.2f, 0.3f});
    swim((float[]){0.4f, -0.2f, 50.0f}, 2);
    check((float[]){0.5f, 0.0f, 0.3f});
    TEST_ASSERT_EQUAL(2, report.measured_beats);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.4f, report.max_abs_error_m_s);
    swim((float[]){0.2f, 50.0f, 50.0f}, 1);
    check((float[]){0.75f, -0.05f, 0.3f});
}

/* (2.35): alpha = (.5, .3, .2), beta = (.4, .2, .1), zero history; five trials, so that the ring of
 * past trials comes round twice. Errors 1, 2, 3, 4, 5 at the first sample, half that, minus that.
 */
static void test_window_is_the_m_th_order_law(void) {
    use_window(3, LEARNER_HISTORY_ZERO);
    config.weight[0] = (law_weights_t){0.5f, 0.4f, 0.0f};
    config.weight[1] = (law_weights_t){0.3f, 0.2f, 0.0f};
    config.weight[2] = (law_weights_t){0.2f, 0.1f, 0.0f};
    begin(NULL);
    const float next[5] = {0.4f, 1.2f, 2.42f, 4.05f, 6.091f};
    for (uint32_t i = 0; i < 5u; i++) {
        const float error = (float)(i + 1u);
        swim((float[]){error, 0.5f * error, -error}, SAMPLES);
        check((float[]){next[i], 0.5f * next[i], -next[i]});
    }
}

/* (3.43), m = 1, beta = 1/2, L = -2, step 1/2: u' = (u_i + u_{i-1})/2 + sum (de_i + de_{i-1})/2 +
 * 2 e_i; the last sample repeats the difference before it. */
static void test_moving_average_pd(void) {
    use_window(2, LEARNER_HISTORY_ZERO);
    config.law.kp_rad_s_m = 2.0f;
    config.law.kd_rad_s2_m = 1.0f;
    config.law.beat_s = 0.5f;
    config.weight[0] = (law_weights_t){0.5f, 1.0f, 0.5f};
    config.weight[1] = (law_weights_t){0.5f, 0.0f, 0.5f};
    begin((float[]){0.2f, 0.2f, 0.2f});
    swim((float[]){0.1f, 0.3f, 0.0f}, SAMPLES);
    check((float[]){0.5f, 0.4f, -0.2f});
    swim((float[]){0.1f, 0.2f, 0.4f}, 2);
    /* de_0 = (.4 -.6 -.6), de_1 = (.2 0 0): beyond the cut nothing is known. */
    check((float[]){0.35f + 0.3f + 0.2f, 0.3f - 0.3f + 0.4f, 0.0f - 0.3f + 0.0f});
}

static void weigh_evenly(uint16_t window) {
    for (uint32_t j = 0; j < window; j++) {
        config.weight[j] = (law_weights_t){1.0f / (float)window, 0.5f, 0.0f};
    }
}

static void test_histories(void) {
    const float first[] = {0.6f, 0.0f, -0.6f};
    const float error[] = {0.2f, 0.2f, 0.0f};
    weigh_evenly(3);
    use_window(3, LEARNER_HISTORY_ZERO);
    begin(first);
    swim(error, SAMPLES);
    check((float[]){0.3f, 0.1f, -0.2f});

    use_window(3, LEARNER_HISTORY_FIRST);
    begin(first);
    swim(error, SAMPLES);
    check((float[]){0.7f, 0.1f, -0.6f});
}

/* The gain of what is there already adds up to that of the whole window, 1.5. */
static void test_a_growing_window(void) {
    weigh_evenly(3);
    use_window(3, LEARNER_HISTORY_NONE);
    begin((float[]){0.6f, 0.0f, -0.6f});
    swim((float[]){0.2f, 0.2f, 0.0f}, SAMPLES);
    check((float[]){0.9f, 0.3f, -0.6f});
    swim((float[]){0.0f, 0.4f, 0.4f}, SAMPLES);
    check((float[]){0.75f + 0.15f, 0.15f + 0.45f, -0.6f + 0.3f});
    swim((float[]){0.1f, 0.0f, 0.0f}, SAMPLES);
    check((float[]){0.8f + 0.15f, 0.3f + 0.3f, -0.5f + 0.2f});
    swim((float[]){0.0f, 0.0f, 0.2f}, SAMPLES);
    check((float[]){2.75f / 3.0f + 0.05f, 0.5f + 0.2f, -1.2f / 3.0f + 0.3f});
}

static void test_what_is_remembered_is_what_the_plant_got(void) {
    config.law.amplitude_min_rad = 0.0f;
    config.law.amplitude_max_rad = 1.0f;
    config.past = PAST_MEAN;
    begin((float[]){5.0f, -5.0f, 0.5f});
    check((float[]){1.0f, 0.0f, 0.5f});
    swim((float[]){-0.2f, 0.1f, 0.0f}, SAMPLES);
    check((float[]){0.6f, 0.2f, 0.5f});
    swim((float[]){0.0f, 0.0f, 0.0f}, SAMPLES);
    check((float[]){0.5f, 0.25f, 0.5f});
    swim((float[]){0.0f, 0.0f, 0.0f}, SAMPLES); /* (1 + .6 + .5)/3 - 4/3 * .2, not of 5 */
    check((float[]){2.1f / 3.0f - 0.8f / 3.0f, 0.15f + 0.4f / 3.0f, 0.5f});

    weigh_evenly(2);
    use_window(2, LEARNER_HISTORY_FIRST);
    begin((float[]){5.0f, -5.0f, 0.5f});
    swim((float[]){-0.4f, 0.4f, 0.0f}, SAMPLES);
    check((float[]){0.8f, 0.2f, 0.5f});
}

static void test_a_trial_with_nothing_valid_changes_no_input_and_counts(void) {
    config.past = PAST_MEAN;
    config.law.kp_rad_s_m = 0.5f;
    begin((float[]){0.1f, 0.2f, 0.3f});
    swim((float[]){50.0f, 50.0f, 50.0f}, 0);
    check((float[]){0.1f, 0.2f, 0.3f});
    TEST_ASSERT_EQUAL(0, report.measured_beats);
    TEST_ASSERT_EQUAL(1, learner.trials);
    swim((float[]){0.4f, 0.0f, 0.0f}, SAMPLES);
    check((float[]){0.4f, 0.2f, 0.3f}); /* 3/2 L e_1: two trials have ended */
}

static void test_a_trial_nobody_measured_is_like_one_with_nothing_valid(void) {
    begin((float[]){0.1f, 0.2f, 0.3f});
    swim((float[]){0.1f, 0.1f, 0.1f}, SAMPLES);
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, SAMPLES, &report));
    check((float[]){0.2f, 0.3f, 0.4f});
    TEST_ASSERT_EQUAL(0, report.measured_beats);
    TEST_ASSERT_EQUAL(2, learner.trials);
}

static void test_a_non_finite_error_is_refused_and_counts_as_not_measured(void) {
    begin(NULL);
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_measure(&learner, 0, 0.5f));
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_measure(&learner, 1, 0.5f));
    TEST_ASSERT_EQUAL(LAW_BAD_INPUT, buffer_learner_measure(&learner, 1, (float)NAN));
    TEST_ASSERT_EQUAL(LAW_BAD_INPUT, buffer_learner_measure(&learner, 2, (float)INFINITY));
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, SAMPLES, &report));
    check((float[]){0.5f, 0.0f, 0.0f});
    TEST_ASSERT_EQUAL(1, report.measured_beats);
}

/* A collision is known only afterwards: the samples before it lose their validity in
 * buffer_learner_end.
 */
static void test_valid_masks_what_was_measured_before(void) {
    use_window(2, LEARNER_HISTORY_ZERO);
    config.weight[0] = config.weight[1] = (law_weights_t){0.5f, 1.0f, 0.0f};
    begin(NULL);
    swim((float[]){0.1f, 0.2f, 7.0f}, 2);
    check((float[]){0.1f, 0.2f, 0.0f});
    swim((float[]){0.0f, 0.0f, 0.0f}, SAMPLES);
    check((float[]){0.15f, 0.3f, 0.0f});
}

static void test_errors_too_large_leave_everything_as_it_was(void) {
    weigh_evenly(2);
    use_window(2, LEARNER_HISTORY_ZERO);
    begin((float[]){0.2f, 0.2f, 0.2f});
    swim((float[]){0.2f, 0.2f, 0.2f}, SAMPLES);
    check((float[]){0.2f, 0.2f, 0.2f});
    const law_report_t before = report;
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_measure(&learner, 0, 1e25f));
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_measure(&learner, 1, 0.4f));
    TEST_ASSERT_EQUAL(LAW_BAD_INPUT, buffer_learner_end(&learner, SAMPLES, &report));
    TEST_ASSERT_EQUAL_MEMORY(&before, &report, sizeof report);
    TEST_ASSERT_EQUAL(1, learner.trials);
    check((float[]){0.2f, 0.2f, 0.2f});
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, SAMPLES, &report));
    check((float[]){0.3f, 0.3f, 0.3f}); /* (.2 + .2)/2 + .5 * .2: the refused trial left no error */
}

static void test_configs_that_do_not_hold_together(void) {
    const buffer_learner_config_t good = config;
#define REFUSED(change)                                                                            \
    config = good;                                                                                 \
    change;                                                                                        \
    TEST_ASSERT_EQUAL_MESSAGE(0, buffer_learner_bytes(&config), #change);                          \
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG,                                                              \
                      buffer_learner_init(&learner, &config, NULL, memory, MEMORY_BYTES))
    REFUSED(config.samples = 0);
    REFUSED(config.law.lead_beats = 3);
    REFUSED(config.law.q_len = 0);
    REFUSED(config.law.q_len = 3);
    REFUSED(config.law.kp_rad_s_m = (float)NAN);
    REFUSED(config.law.beat_s = 0.0f);
    REFUSED(config.past = (past_kind_t)3);
    REFUSED(config.past = PAST_MEAN; config.law.kd_rad_s2_m = 1.0f);
    REFUSED(use_window(0, LEARNER_HISTORY_ZERO));
    REFUSED(use_window(LEARNER_WINDOW_MAX + 1u, LEARNER_HISTORY_ZERO));
    REFUSED(use_window(1, (buffer_learner_history_t)3));
    REFUSED(use_window(2, LEARNER_HISTORY_ZERO); config.weight[1].input = (float)INFINITY);
    REFUSED(use_window(2, LEARNER_HISTORY_ZERO); config.weight[1].kp = (float)NAN);
    REFUSED(use_window(2, LEARNER_HISTORY_ZERO); config.weight[0].kd = (float)NAN);
    REFUSED(use_window(2, LEARNER_HISTORY_ZERO); config.weight[0].input = -5e28f);
    REFUSED(use_window(2, LEARNER_HISTORY_NONE); config.weight[0].input = 1.0f;
            config.weight[1].input = -1.0000001f; config.law.amplitude_max_rad = 1e30f);
#undef REFUSED
}

static void test_weights_beyond_the_window_do_not_matter(void) {
    use_window(2, LEARNER_HISTORY_ZERO);
    config.weight[2].input = (float)NAN;
    TEST_ASSERT_TRUE(buffer_learner_bytes(&config) > 0);
}

static void test_first_inputs_that_are_not_finite_are_refused(void) {
    float first[] = {0.0f, 0.0f, (float)NAN};
    TEST_ASSERT_EQUAL(LAW_BAD_INPUT,
                      buffer_learner_init(&learner, &config, first, memory, MEMORY_BYTES));
    first[2] = 1e31f;
    TEST_ASSERT_EQUAL(LAW_BAD_INPUT,
                      buffer_learner_init(&learner, &config, first, memory, MEMORY_BYTES));
}

/* As many numbers per sample as the header says, and a byte for each trial kept. */
static size_t bytes_by_hand(void) {
    const size_t kept = config.past == PAST_LAST   ? 0u
                        : config.past == PAST_MEAN ? 1u
                                                   : config.window - 1u;
    return (3u + 2u * kept) * config.samples * sizeof(float) + (1u + kept) * config.samples;
}

static void swim_some(void) {
    for (uint32_t i = 0; i < 20u; i++) {
        for (uint16_t k = 0; k < config.samples; k++) {
            (void)buffer_learner_measure(&learner, k,
                                         0.01f * (float)((i * 7u + k * 3u) % 11u) - 0.05f);
        }
        const uint16_t valid = (uint16_t)((i * 5u) % (config.samples + 1u));
        TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, valid, &report));
    }
}

static void check_bytes(void) {
    const size_t bytes = buffer_learner_bytes(&config);
    TEST_ASSERT_EQUAL(bytes_by_hand(), bytes);
    memset(memory, GUARD, sizeof memory);
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG,
                      buffer_learner_init(&learner, &config, NULL, memory, bytes - 1u));
    TEST_ASSERT_EACH_EQUAL_HEX8(GUARD, memory, bytes + GUARD_BYTES);
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_init(&learner, &config, NULL, memory, bytes));
    swim_some();
    TEST_ASSERT_EACH_EQUAL_HEX8(GUARD, memory + bytes, GUARD_BYTES);
}

static void test_the_buffer_is_used_to_its_end_and_not_beyond(void) {
    for (uint16_t samples = 1; samples < 12u; samples++) {
        config.samples = samples;
        config.past = PAST_LAST;
        check_bytes();
        config.past = PAST_MEAN;
        check_bytes();
        for (uint16_t window = 1; window <= LEARNER_WINDOW_MAX; window++) {
            weigh_evenly(window);
            for (uint32_t history = 0; history <= LEARNER_HISTORY_NONE; history++) {
                use_window(window, (buffer_learner_history_t)history);
                check_bytes();
            }
        }
    }
}

/* Chapter 2, example 1: x' = A x + (0 0 1) u, y = x_3. */
static void advance(float *x, float input) {
    const float next[3] = {0.5f * x[0] + x[2], 0.15f * x[0] + 0.3f * x[1],
                           -0.75f * x[0] + 0.25f * x[1] - 0.25f * x[2] + input};
    memcpy(x, next, sizeof next);
}

static float wanted(uint32_t t) {
    return (float)(sin(2.0 * PI * t / 50.0) + sin(2.0 * PI * t / 5.0));
}

/* Stops where |e| exceeds |threshold|. Returns the samples up to and with the violating one. */
static uint16_t swim_until(float threshold) {
    float x[3] = {0.0f, 0.0f, 0.0f};
    for (uint16_t t = 0; t < PLANT_SAMPLES; t++) {
        const float error = wanted(t) - x[2];
        (void)buffer_learner_measure(&learner, t, error);
        if (error > threshold || error < -threshold) {
            return (uint16_t)(t + 1u);
        }
        advance(x, buffer_learner_output(&learner, t));
    }
    return 0;
}

/* Trials until one is not stopped any more; 500 when none is. */
static uint32_t trials_needed(float threshold, bool learns_from_violation) {
    begin(NULL);
    for (uint32_t i = 0; i < 500u; i++) {
        const uint16_t stopped = swim_until(threshold);
        if (stopped == 0) {
            return i;
        }
        const uint16_t valid = learns_from_violation ? stopped : (uint16_t)(stopped - 1u);
        TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, valid, &report));
    }
    return 500u;
}

static void check_stops(uint32_t at_1_5, uint32_t at_0_8) {
    TEST_ASSERT_EQUAL(at_1_5, trials_needed(1.5f, true));
    TEST_ASSERT_EQUAL(at_0_8, trials_needed(0.8f, true));
    TEST_ASSERT_EQUAL(500, trials_needed(1.5f, false));
    TEST_ASSERT_EQUAL(500, trials_needed(0.8f, false));
}

static void test_a_trial_stopped_by_its_error_must_learn_from_it(void) {
    config.samples = PLANT_SAMPLES;
    config.law.lead_beats = 1;
    config.law.kp_rad_s_m = 0.5f;
    check_stops(11, 66);

    config.past = PAST_MEAN;
    check_stops(23, 68);

    config.law.kp_rad_s_m = 1.0f;
    use_window(5, LEARNER_HISTORY_NONE);
    for (uint32_t j = 0; j < 5u; j++) {
        config.weight[j] = (law_weights_t){0.2f, 0.1f, 0.0f};
    }
    check_stops(18, 196);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_last_is_the_p_law);
    RUN_TEST(test_without_a_first_input_it_starts_from_zero);
    RUN_TEST(test_mean_is_the_iteration_average);
    RUN_TEST(test_a_cut_trial_counts_in_the_mean_with_its_input_and_no_error);
    RUN_TEST(test_window_is_the_m_th_order_law);
    RUN_TEST(test_moving_average_pd);
    RUN_TEST(test_histories);
    RUN_TEST(test_a_growing_window);
    RUN_TEST(test_what_is_remembered_is_what_the_plant_got);
    RUN_TEST(test_a_trial_with_nothing_valid_changes_no_input_and_counts);
    RUN_TEST(test_a_trial_nobody_measured_is_like_one_with_nothing_valid);
    RUN_TEST(test_a_non_finite_error_is_refused_and_counts_as_not_measured);
    RUN_TEST(test_valid_masks_what_was_measured_before);
    RUN_TEST(test_errors_too_large_leave_everything_as_it_was);
    RUN_TEST(test_configs_that_do_not_hold_together);
    RUN_TEST(test_weights_beyond_the_window_do_not_matter);
    RUN_TEST(test_first_inputs_that_are_not_finite_are_refused);
    RUN_TEST(test_the_buffer_is_used_to_its_end_and_not_beyond);
    RUN_ON_HOST(test_a_trial_stopped_by_its_error_must_learn_from_it);
    return UNITY_END();
}
