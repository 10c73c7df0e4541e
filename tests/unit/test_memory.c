/* Begin, first, learn, best, rollback: small fish of three beats. */
#include "ilc/memory.h"

#include "mock_hal.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define BEATS 3u
#define CRC 0xC0FFEEu

static memory_t memory;
static law_t law;
static memory_report_t report;
static float scratch[BEATS_MAX];
static uint8_t measured[BEATS];
static uint32_t trial_number;

static const float reference[BEATS] = {0.02f, 0.3f, 0.01f};

void setUp(void) {
    law = (law_t){.kp_rad_s_m = 4.0f, .amplitude_max_rad = 0.8f, .beat_s = 1.0f, .q_len = 1};
    memset(&memory, 0, sizeof memory);
    memset(measured, 1, sizeof measured);
    memory_begin(&memory, CRC, BEATS);
    trial_number = 0;
}
void tearDown(void) {}

static law_result_t learn(float error, bool complete, float ratio) {
    const float errors[BEATS] = {0.0f, -error, error};
    const law_trial_t trial = {.beats = BEATS, .error_m_s = errors, .measured = measured};
    trial_number++;
    const memory_rules_t rules = {.rollback_ratio = ratio};
    return memory_learn(&memory, &law, &trial, trial_number, complete, &rules, scratch, &report);
}

static void first(void) {
    TEST_ASSERT_EQUAL(LAW_OK, memory_first(&memory, &law, reference, scratch));
}

static void test_begin_empties_all_but_the_trial_number(void) {
    memset(&memory, 0x3F, sizeof memory);
    memory.last_trial = 77;
    memory_begin(&memory, 5, 40);
    memory_t expected = {.reference_crc = 5, .last_trial = 77, .beats = 40};
    TEST_ASSERT_EQUAL_MEMORY(&expected, &memory, sizeof memory);
}

static void test_begin_refuses_impossible_lengths(void) {
    static bool panicked;
    MOCK_EXPECT_PANIC(panicked, memory_begin(&memory, CRC, 0));
    TEST_ASSERT_TRUE(panicked);
    MOCK_EXPECT_PANIC(panicked, memory_begin(&memory, CRC, BEATS_MAX + 1u));
    TEST_ASSERT_TRUE(panicked);
}

static void test_first_is_gain_times_reference_unsaturated(void) {
    law.step_max_rad = 0.1f;
    first();
    TEST_ASSERT_EQUAL(1, memory.iteration);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.08f, memory.amplitude_rad[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 1.2f, memory.amplitude_rad[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.04f, memory.amplitude_rad[2]);
    TEST_ASSERT_EQUAL(0, memory.last_trial);
}

static void test_first_uses_lead_and_tail(void) {
    law.lead_beats = 1;
    first();
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 1.2f, memory.amplitude_rad[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.04f, memory.amplitude_rad[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.04f, memory.amplitude_rad[2]);
}

static void test_first_again_takes_the_gain_of_that_moment(void) {
    first();
    law.kp_rad_s_m = 2.0f;
    first();
    TEST_ASSERT_EQUAL(1, memory.iteration);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.04f, memory.amplitude_rad[0]);
    static bool panicked;
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.01f, true, 1.3f));
    MOCK_EXPECT_PANIC(panicked, (void)memory_first(&memory, &law, reference, scratch));
    TEST_ASSERT_TRUE(panicked);
}

static void test_first_refused_changes_nothing(void) {
    first();
    const memory_t before = memory;
    const float poisoned[BEATS] = {0.02f, (float)NAN, 0.01f};
    TEST_ASSERT_EQUAL(LAW_BAD_INPUT, memory_first(&memory, &law, poisoned, scratch));
    law.lead_beats = BEATS;
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, memory_first(&memory, &law, reference, scratch));
    TEST_ASSERT_EQUAL_MEMORY(&before, &memory, sizeof memory);
}

static void test_learning_saturates_corrects_and_counts(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(2, memory.iteration);
    TEST_ASSERT_EQUAL(1, memory.last_trial);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.08f, memory.amplitude_rad[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.6f, memory.amplitude_rad[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.24f, memory.amplitude_rad[2]);
    TEST_ASSERT_EQUAL(1, report.law.saturated_beats);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.05f, report.law.max_abs_error_m_s);
}

static void test_the_best_is_kept_as_it_was_swum(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_TRUE(report.improved);
    TEST_ASSERT_EQUAL(1, memory.best_iteration);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.05f, memory.best_max_abs_error_m_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.8f, memory.best_rad[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.04f, memory.best_rad[2]);

    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_FALSE(report.improved);
    TEST_ASSERT_EQUAL(1, memory.best_iteration);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.04f, true, 1.3f));
    TEST_ASSERT_TRUE(report.improved);
    TEST_ASSERT_EQUAL(3, memory.best_iteration);
}

static void test_only_judged_trials_become_the_best(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, false, 1.3f));
    TEST_ASSERT_FALSE(report.improved);
    measured[0] = 0;
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_FALSE(report.improved);
    TEST_ASSERT_EQUAL(0, memory.best_iteration);
    TEST_ASSERT_EQUAL(3, memory.iteration);
}

static void test_two_bad_trials_in_a_row_bring_the_best_back(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    const memory_t after_best = memory;
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.066f, true, 1.3f));
    TEST_ASSERT_FALSE(report.rolled_back);
    TEST_ASSERT_EQUAL(1, memory.worse_streak);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.066f, true, 1.3f));
    TEST_ASSERT_TRUE(report.rolled_back);
    TEST_ASSERT_FALSE(report.improved);
    TEST_ASSERT_EQUAL_MEMORY(after_best.best_rad, memory.amplitude_rad, sizeof reference);
    TEST_ASSERT_EQUAL(0, memory.worse_streak);
    TEST_ASSERT_EQUAL(4, memory.iteration);
    TEST_ASSERT_EQUAL(3, memory.last_trial);
    TEST_ASSERT_EQUAL(1, memory.best_iteration);
}

static void test_a_fair_trial_between_ends_the_streak(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.064f, true, 1.3f));
    TEST_ASSERT_EQUAL(0, memory.worse_streak);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_FALSE(report.rolled_back);
}

static void test_a_short_trial_can_be_bad_but_not_fair(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, false, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.01f, false, 1.3f));
    TEST_ASSERT_EQUAL(1, memory.worse_streak);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_TRUE(report.rolled_back);
}

static void expect_visits(uint8_t a, uint8_t b, uint8_t c) {
    const uint8_t wanted[BEATS] = {a, b, c};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(wanted, memory.visits, BEATS);
}

static void test_visits_count_the_corrections_of_each_beat(void) {
    first();
    expect_visits(0, 0, 0);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    expect_visits(1, 1, 1);
    measured[2] = 0; /* cut short */
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, false, 1.3f));
    expect_visits(2, 2, 1);
    law.lead_beats = 1.0f; /* beat 1 waits for the speed of beat 2, and so does the held tail */
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, false, 1.3f));
    expect_visits(3, 2, 1);
    law.lead_beats = 0.5f;
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, false, 1.3f));
    expect_visits(4, 3, 1);
    memset(memory.visits, UINT8_MAX - 1, BEATS);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, false, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, false, 1.3f));
    expect_visits(UINT8_MAX, UINT8_MAX, UINT8_MAX - 1);
}

static void test_a_rollback_visits_nothing_and_forgets_no_visit(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    expect_visits(2, 2, 2);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_TRUE(report.rolled_back);
    expect_visits(2, 2, 2);
    TEST_ASSERT_TRUE(memory_restore_best(&memory));
    expect_visits(2, 2, 2);
    memory_begin(&memory, CRC + 1u, BEATS);
    expect_visits(0, 0, 0);
}

static void test_what_was_rarely_reached_keeps_the_full_gain(void) {
    law.fade = 0.5f;
    law.fade_from = 1;
    first();
    measured[2] = 0;
    for (int i = 0; i < 5; i++) {
        TEST_ASSERT_EQUAL(LAW_OK, learn(0.0f, false, 1.3f));
    }
    expect_visits(5, 5, 0);
    measured[2] = 1;
    memory.amplitude_rad[1] = memory.amplitude_rad[2] = 0.5f;
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.03f, true, 1.3f));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.5f - 4.0f * 0.03f / 3.0f, memory.amplitude_rad[1]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.5f + 4.0f * 0.03f, memory.amplitude_rad[2]);
    expect_visits(6, 6, 1);
}

static void test_the_memory_tells_what_made_its_amplitudes(void) {
    first();
    TEST_ASSERT_EQUAL(MEMORY_INPUT_FIRST, memory.input);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(MEMORY_INPUT_LAW, memory.input);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_EQUAL(MEMORY_INPUT_RESTORED, memory.input);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(MEMORY_INPUT_LAW, memory.input);
    TEST_ASSERT_TRUE(memory_restore_best(&memory));
    TEST_ASSERT_EQUAL(MEMORY_INPUT_RESTORED, memory.input);
}

/* Beyond the ratio, not at it. */
static void test_a_trial_at_the_ratio_is_not_worse(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.25f, true, 2.0f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.5f, true, 2.0f));
    TEST_ASSERT_EQUAL(0, memory.worse_streak);
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.5001f, true, 2.0f));
    TEST_ASSERT_EQUAL(1, memory.worse_streak);
}

static void test_ratio_zero_never_rolls_back(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.01f, true, 0.0f));
    for (int i = 0; i < 5; i++) {
        TEST_ASSERT_EQUAL(LAW_OK, learn(0.2f, true, 0.0f));
        TEST_ASSERT_FALSE(report.rolled_back);
    }
}

static void test_an_improvement_is_never_a_bad_trial(void) {
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 0.5f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.04f, true, 0.5f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.03f, true, 0.5f));
    TEST_ASSERT_EQUAL(0, memory.worse_streak);
    TEST_ASSERT_FALSE(report.rolled_back);
}

static void check_refused(law_result_t expected, law_result_t (*attempt)(void)) {
    const memory_t before = memory;
    memset(&report, 0x55, sizeof report);
    memory_report_t untouched;
    memcpy(&untouched, &report, sizeof report);
    TEST_ASSERT_EQUAL(expected, attempt());
    TEST_ASSERT_EQUAL_MEMORY(&before, &memory, sizeof memory);
    TEST_ASSERT_EQUAL_MEMORY(&untouched, &report, sizeof report);
}

static law_result_t learn_poison(void) { return learn((float)NAN, true, 1.3f); }
static law_result_t learn_huge(void) { return learn(3e38f, true, 1.3f); }
static law_result_t learn_good(void) { return learn(0.01f, true, 1.3f); }
static law_result_t learn_wrong_length(void) {
    const float errors[2] = {0.0f, 0.0f};
    const law_trial_t trial = {.beats = 2, .error_m_s = errors};
    const memory_rules_t rules = {.rollback_ratio = 1.3f};
    return memory_learn(&memory, &law, &trial, 9, true, &rules, scratch, &report);
}

static void test_refusals_change_nothing(void) {
    check_refused(LAW_BAD_INPUT, learn_good); /* nothing was swum yet */
    first();
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    check_refused(LAW_BAD_INPUT, learn_poison);
    check_refused(LAW_BAD_INPUT, learn_huge);
    check_refused(LAW_BAD_CONFIG, learn_wrong_length);
    memset(measured, 0, sizeof measured);
    check_refused(LAW_NOTHING_MEASURED, learn_good);
    memset(measured, 1, sizeof measured);
    law.beat_s = 0.0f;
    check_refused(LAW_BAD_CONFIG, learn_good);
}

static void test_restoring_by_hand(void) {
    TEST_ASSERT_FALSE(memory_restore_best(&memory));
    first();
    TEST_ASSERT_FALSE(memory_restore_best(&memory));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.10f, true, 1.3f));
    TEST_ASSERT_TRUE(memory_restore_best(&memory));
    TEST_ASSERT_EQUAL_MEMORY(memory.best_rad, memory.amplitude_rad, sizeof reference);
    TEST_ASSERT_EQUAL(0, memory.worse_streak);
    TEST_ASSERT_EQUAL(3, memory.iteration);
}

/* The places of past trials are the iteration modulo 8 (learn/past_trials.c). */
static void test_the_iteration_goes_round_and_keeps_its_place(void) {
    first();
    memory.iteration = UINT16_MAX;
    TEST_ASSERT_EQUAL(LAW_OK, learn(0.05f, true, 1.3f));
    TEST_ASSERT_EQUAL((UINT16_MAX + 1u) % MEMORY_ROUND, memory.iteration % MEMORY_ROUND);
    TEST_ASSERT_EQUAL(65528, memory.iteration);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_begin_empties_all_but_the_trial_number);
    RUN_TEST(test_begin_refuses_impossible_lengths);
    RUN_TEST(test_first_is_gain_times_reference_unsaturated);
    RUN_TEST(test_first_uses_lead_and_tail);
    RUN_TEST(test_first_again_takes_the_gain_of_that_moment);
    RUN_TEST(test_first_refused_changes_nothing);
    RUN_TEST(test_learning_saturates_corrects_and_counts);
    RUN_TEST(test_the_best_is_kept_as_it_was_swum);
    RUN_TEST(test_only_judged_trials_become_the_best);
    RUN_TEST(test_two_bad_trials_in_a_row_bring_the_best_back);
    RUN_TEST(test_a_fair_trial_between_ends_the_streak);
    RUN_TEST(test_a_short_trial_can_be_bad_but_not_fair);
    RUN_TEST(test_visits_count_the_corrections_of_each_beat);
    RUN_TEST(test_a_rollback_visits_nothing_and_forgets_no_visit);
    RUN_TEST(test_what_was_rarely_reached_keeps_the_full_gain);
    RUN_TEST(test_the_memory_tells_what_made_its_amplitudes);
    RUN_TEST(test_a_trial_at_the_ratio_is_not_worse);
    RUN_TEST(test_ratio_zero_never_rolls_back);
    RUN_TEST(test_an_improvement_is_never_a_bad_trial);
    RUN_TEST(test_refusals_change_nothing);
    RUN_TEST(test_restoring_by_hand);
    RUN_TEST(test_the_iteration_goes_round_and_keeps_its_place);
    return UNITY_END();
}
