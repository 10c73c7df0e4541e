/* Which trials are judged, and how the best is compared when beats are missing. */
#include "ilc/judge.h"
#include "ilc/memory.h"

#include "unity.h"

#include <string.h>

#define BEATS 40u

static float errors[BEATS_MAX];
static uint8_t measured[BEATS_MAX];
static law_trial_t trial;
static judge_peaks_t best;

void setUp(void) {
    memset(errors, 0, sizeof errors);
    memset(measured, 1, sizeof measured);
    memset(&best, 0, sizeof best);
    trial = (law_trial_t){.beats = BEATS, .error_m_s = errors, .measured = measured};
}
void tearDown(void) {}

static void miss(uint32_t first, uint32_t count) { memset(measured + first, 0, count); }

static void test_four_fifths_and_no_more_than_three_in_a_row(void) {
    TEST_ASSERT_TRUE(judge_counts(&trial, true));
    TEST_ASSERT_FALSE(judge_counts(&trial, false));
    miss(10, 3);
    TEST_ASSERT_TRUE(judge_counts(&trial, true));
    miss(13, 1);
    TEST_ASSERT_FALSE(judge_counts(&trial, true));
    memset(measured, 1, BEATS);
    for (uint32_t k = 0; k < 8u; k++) {
        miss(5u * k, 1);
    }
    TEST_ASSERT_TRUE(judge_counts(&trial, true));
    miss(39, 1);
    TEST_ASSERT_FALSE(judge_counts(&trial, true));
    trial.measured = NULL;
    TEST_ASSERT_TRUE(judge_counts(&trial, true));
}

static void test_short_trials_and_gaps_at_both_ends(void) {
    trial.beats = 4;
    miss(0, 1);
    TEST_ASSERT_FALSE(judge_counts(&trial, true)); /* 3 of 4 */
    trial.beats = 5;
    TEST_ASSERT_TRUE(judge_counts(&trial, true));
    trial.beats = BEATS;
    miss(0, 3);
    miss(37, 3);
    TEST_ASSERT_TRUE(judge_counts(&trial, true));
    miss(36, 1);
    TEST_ASSERT_FALSE(judge_counts(&trial, true));
    trial.beats = BEATS_MAX;
    memset(measured, 1, sizeof measured);
    for (uint32_t k = 0; k < 102u; k++) {
        miss(5u * k, 1);
    }
    TEST_ASSERT_TRUE(judge_counts(&trial, true)); /* 410 of 512 */
    miss(511, 1);
    TEST_ASSERT_FALSE(judge_counts(&trial, true));
}

static void expect_peaks(uint16_t count, const uint16_t *beat, const float *error_m_s) {
    TEST_ASSERT_EQUAL(count, best.count);
    TEST_ASSERT_EQUAL_UINT16_ARRAY(beat, best.beat, count);
    TEST_ASSERT_EQUAL_FLOAT_ARRAY(error_m_s, best.error_m_s, count);
}

static void test_the_largest_errors_are_kept_in_order(void) {
    for (uint32_t k = 0; k < BEATS; k++) {
        errors[k] = k % 2u == 0 ? 0.001f : -0.001f;
    }
    errors[30] = -0.030f;
    errors[5] = 0.030f;
    errors[20] = 0.050f;
    measured[7] = 0;
    errors[7] = 0.9f;
    judge_keep(&best, &trial);
    expect_peaks(8, (const uint16_t[]){20, 5, 30, 0, 1, 2, 3, 4},
                 (const float[]){0.05f, 0.03f, 0.03f, 0.001f, 0.001f, 0.001f, 0.001f, 0.001f});
}

static void test_a_beat_without_an_error_is_no_peak(void) {
    judge_keep(&best, &trial);
    TEST_ASSERT_EQUAL(0, best.count);
    errors[39] = -0.002f;
    judge_keep(&best, &trial);
    expect_peaks(1, (const uint16_t[]){39}, (const float[]){0.002f});
}

static bool is_better(float at_8, float at_20) {
    errors[8] = at_8;
    errors[20] = at_20;
    return judge_is_better(&best, 0.016f, &trial);
}

static void test_the_best_counts_on_the_beats_that_both_measured(void) {
    TEST_ASSERT_TRUE(is_better(0.015f, 0.0f)); /* no peaks are known */
    TEST_ASSERT_FALSE(is_better(0.0f, 0.016f));
    errors[8] = 0.016f;
    errors[20] = -0.006f;
    judge_keep(&best, &trial);
    TEST_ASSERT_TRUE(is_better(-0.015f, 0.007f));
    TEST_ASSERT_FALSE(is_better(-0.016f, 0.0f));
    miss(8, 1);
    TEST_ASSERT_TRUE(is_better(0.9f, 0.005f));
    TEST_ASSERT_FALSE(is_better(0.0f, 0.006f));
    miss(20, 1); /* none of them: not larger than the smallest */
    errors[30] = 0.005f;
    TEST_ASSERT_TRUE(is_better(0.0f, 0.0f));
    errors[30] = 0.006f;
    TEST_ASSERT_FALSE(is_better(0.0f, 0.0f));
}

static void test_a_peak_that_was_not_measured_again_is_carried_over(void) {
    errors[8] = 0.016f;
    errors[20] = 0.006f;
    judge_keep(&best, &trial);
    miss(8, 1);
    errors[20] = 0.005f;
    for (int i = 0; i < 2; i++) { /* and once more */
        judge_keep(&best, &trial);
        expect_peaks(2, (const uint16_t[]){8, 20}, (const float[]){-0.016f, 0.005f});
    }
    measured[8] = 1;
    TEST_ASSERT_TRUE(is_better(0.016f, 0.004f)); /* alone with its peak */
    TEST_ASSERT_FALSE(is_better(0.0161f, 0.004f));
    TEST_ASSERT_FALSE(is_better(0.0f, 0.005f));
    errors[8] = 0.002f;
    errors[20] = 0.005f;
    judge_keep(&best, &trial);
    expect_peaks(2, (const uint16_t[]){20, 8}, (const float[]){0.005f, 0.002f});
}

static void test_worse_is_beyond_the_score_or_the_carried_peak(void) {
    errors[8] = 0.016f;
    judge_keep(&best, &trial);
    miss(8, 1);
    errors[20] = 0.005f;
    judge_keep(&best, &trial);
    memset(measured, 1, BEATS);
    errors[8] = 0.019f;
    TEST_ASSERT_FALSE(judge_is_worse(&best, 0.005f, &trial, 1.25f));
    errors[20] = 0.0063f;
    TEST_ASSERT_TRUE(judge_is_worse(&best, 0.005f, &trial, 1.25f));
    errors[20] = 0.0f;
    errors[8] = -0.0201f;
    TEST_ASSERT_TRUE(judge_is_worse(&best, 0.005f, &trial, 1.25f));
}

/* The law, the memory: a fish whose largest error is always at beat 8. */
static memory_t memory;
static law_t law;
static memory_report_t report;

static void begin(void) {
    static float reference[BEATS], scratch[BEATS_MAX];
    law = (law_t){.kp_rad_s_m = 4.0f, .amplitude_max_rad = 0.8f, .beat_s = 1.0f, .q_len = 1};
    memset(&memory, 0, sizeof memory);
    memory_begin(&memory, 1, BEATS);
    TEST_ASSERT_EQUAL(LAW_OK, memory_first(&memory, &law, reference, scratch));
}

static void learn(float at_8, float elsewhere) {
    static float scratch[BEATS_MAX];
    static uint32_t number;
    const memory_rules_t rules = {.rollback_ratio = 1.3f};
    for (uint32_t k = 0; k < BEATS; k++) {
        errors[k] = k == 8u ? at_8 : elsewhere;
    }
    TEST_ASSERT_EQUAL(
        LAW_OK, memory_learn(&memory, &law, &trial, ++number, true, &rules, scratch, &report));
}

static void test_a_trial_with_a_missing_beat_becomes_the_best(void) {
    begin();
    learn(0.03f, 0.03f);
    miss(30, 1);
    learn(0.02f, 0.02f);
    TEST_ASSERT_TRUE(report.improved);
    TEST_ASSERT_EQUAL(2, memory.best_iteration);
    TEST_ASSERT_EQUAL_FLOAT(0.02f, memory.best_max_abs_error_m_s);
}

static void test_missing_the_worst_beat_does_not_make_a_trial_the_best(void) {
    begin();
    learn(0.016f, 0.006f);
    miss(8, 1);
    learn(0.0f, 0.007f); /* 7 mm/s on its own beats, where the best had 6 */
    TEST_ASSERT_FALSE(report.improved);
    TEST_ASSERT_EQUAL(1, memory.best_iteration);
}

/* Else its small score would send every later trial back. */
static void test_the_error_of_a_missing_beat_is_not_lost(void) {
    begin();
    learn(0.016f, 0.006f);
    miss(8, 1);
    learn(0.0f, 0.005f);
    TEST_ASSERT_TRUE(report.improved);
    TEST_ASSERT_EQUAL_FLOAT(0.005f, memory.best_max_abs_error_m_s);
    memset(measured, 1, BEATS);
    for (int i = 0; i < 3; i++) {
        learn(0.017f, 0.0051f);
        TEST_ASSERT_FALSE(report.improved);
        TEST_ASSERT_FALSE(report.rolled_back);
    }
    learn(0.017f, 0.004f); /* larger than the one that was carried over */
    TEST_ASSERT_FALSE(report.improved);
    learn(0.015f, 0.004f);
    TEST_ASSERT_TRUE(report.improved);
}

/* Nor does a large one of an early trial make what follows better. */
static void test_a_carried_error_is_compared_at_its_own_beat_alone(void) {
    begin();
    learn(0.02f, 0.02f);
    miss(3, 1);
    learn(0.01f, 0.01f);
    TEST_ASSERT_TRUE(report.improved);
    memset(measured, 1, BEATS);
    learn(0.0145f, 0.0145f);
    TEST_ASSERT_FALSE(report.improved);
    learn(0.0145f, 0.0145f);
    TEST_ASSERT_TRUE(report.rolled_back);
}

static void test_two_bad_trials_with_missing_beats_bring_the_best_back(void) {
    begin();
    learn(0.01f, 0.01f);
    miss(3, 2);
    learn(0.014f, 0.014f);
    TEST_ASSERT_EQUAL(1, memory.worse_streak);
    memset(measured, 1, BEATS);
    miss(20, 1);
    learn(0.014f, 0.014f);
    TEST_ASSERT_TRUE(report.rolled_back);
}

static void test_a_fair_trial_with_a_missing_beat_ends_the_streak(void) {
    begin();
    learn(0.01f, 0.01f);
    learn(0.014f, 0.014f);
    miss(20, 1);
    learn(0.012f, 0.012f);
    TEST_ASSERT_EQUAL(0, memory.worse_streak);
    miss(20, 4); /* not judged: proves nothing */
    learn(0.014f, 0.014f);
    learn(0.012f, 0.012f);
    TEST_ASSERT_EQUAL(1, memory.worse_streak);
    learn(0.001f, 0.001f);
    TEST_ASSERT_FALSE(report.improved);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_four_fifths_and_no_more_than_three_in_a_row);
    RUN_TEST(test_short_trials_and_gaps_at_both_ends);
    RUN_TEST(test_the_largest_errors_are_kept_in_order);
    RUN_TEST(test_a_beat_without_an_error_is_no_peak);
    RUN_TEST(test_the_best_counts_on_the_beats_that_both_measured);
    RUN_TEST(test_a_peak_that_was_not_measured_again_is_carried_over);
    RUN_TEST(test_worse_is_beyond_the_score_or_the_carried_peak);
    RUN_TEST(test_a_trial_with_a_missing_beat_becomes_the_best);
    RUN_TEST(test_missing_the_worst_beat_does_not_make_a_trial_the_best);
    RUN_TEST(test_the_error_of_a_missing_beat_is_not_lost);
    RUN_TEST(test_a_carried_error_is_compared_at_its_own_beat_alone);
    RUN_TEST(test_two_bad_trials_with_missing_beats_bring_the_best_back);
    RUN_TEST(test_a_fair_trial_with_a_missing_beat_ends_the_streak);
    return UNITY_END();
}
