/* What beats get that no trial has corrected, and that the law's other rules hold for them. */
#include "ilc/beyond.h"
#include "ilc/memory.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define BEATS 8u

static number_t amplitude[BEATS];
static uint8_t visits[BEATS];
static memory_t memory;
static float scratch[BEATS];
static law_t law;

void setUp(void) {
    for (uint32_t k = 0; k < BEATS; k++) {
        amplitude[k] = NUMBER(0.1) * (number_t)(k + 1u);
        visits[k] = 0;
    }
    law = (law_t){.kp_rad_s_m = 4.0f, .amplitude_max_rad = 0.75f, .beat_s = 1.0f, .q_len = 1u};
    memset(&memory, 0, sizeof memory);
}

void tearDown(void) {}

static void fill(beyond_t policy) { beyond_fill(policy, BEATS, BEATS, visits, amplitude); }

static void assert_untouched(uint32_t end) {
    for (uint32_t k = 0; k < end; k++) {
        TEST_ASSERT_TRUE(amplitude[k] == NUMBER(0.1) * (number_t)(k + 1u));
    }
}

static void visit(uint32_t beats) {
    for (uint32_t k = 0; k < beats; k++) {
        visits[k] = (uint8_t)(k + 1u);
    }
}

static void test_keep_touches_nothing(void) {
    visit(5);
    fill(BEYOND_KEEP);
    assert_untouched(BEATS);
}

static void test_hold_repeats_the_last_corrected_beat(void) {
    visit(5);
    fill(BEYOND_HOLD);
    assert_untouched(5);
    for (uint32_t k = 5; k < BEATS; k++) {
        TEST_ASSERT_TRUE(amplitude[k] == amplitude[4]);
    }
}

static void test_taper_goes_evenly_down_to_zero_at_the_end(void) {
    visit(5);
    fill(BEYOND_TAPER);
    assert_untouched(5);
    const float wanted[] = {0.375f, 0.25f, 0.125f}; /* 0.5 at beat 4, 0 at the end of beat 7 */
    for (uint32_t k = 5; k < BEATS; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, wanted[k - 5u], (float)amplitude[k]);
    }
}

static void test_without_any_visit_or_with_all_nothing_happens(void) {
    for (int policy = BEYOND_KEEP; policy < BEYOND_COUNT; policy++) {
        setUp();
        fill((beyond_t)policy);
        assert_untouched(BEATS);
        visits[BEATS - 1u] = 1; /* the last beat alone is enough */
        fill((beyond_t)policy);
        assert_untouched(BEATS);
    }
}

static void test_holes_before_the_last_visit_are_left(void) {
    visits[2] = 3;
    visits[6] = 255;
    fill(BEYOND_HOLD);
    assert_untouched(7);
    TEST_ASSERT_TRUE(amplitude[7] == amplitude[6]);
}

static void test_the_shortest_trials(void) {
    number_t one = NUMBER(0.3);
    const uint8_t never = 0, once = 1;
    beyond_fill(BEYOND_TAPER, 1, 1, &never, &one);
    beyond_fill(BEYOND_TAPER, 1, 1, &once, &one);
    TEST_ASSERT_TRUE(one == NUMBER(0.3));
    visits[0] = 1;
    fill(BEYOND_TAPER);
    assert_untouched(1);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.1f / 8.0f, (float)amplitude[BEATS - 1u]);
}

static void test_the_tail_is_left(void) {
    visit(3);
    beyond_fill(BEYOND_TAPER, BEATS, 6, visits, amplitude);
    assert_untouched(3);
    for (uint32_t k = 3; k < 6; k++) {
        const float taper = 0.3f * (float)(BEATS - k) / 6.0f;
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, taper, (float)amplitude[k]);
    }
    for (uint32_t k = 6; k < BEATS; k++) {
        TEST_ASSERT_TRUE(amplitude[k] == NUMBER(0.1) * (number_t)(k + 1u));
    }
}

static void test_a_tail_behind_which_all_lies_is_left(void) {
    visit(5);
    beyond_fill(BEYOND_HOLD, BEATS, 2, visits, amplitude);
    assert_untouched(BEATS);
}

static void test_an_unknown_policy_keeps(void) {
    visit(5);
    fill(BEYOND_COUNT);
    assert_untouched(BEATS);
}

/* From here on through the memory, as the board learns. */

static void begin(const float *reference_m_s) {
    memory_begin(&memory, 1u, BEATS);
    TEST_ASSERT_EQUAL(LAW_OK, memory_first(&memory, &law, reference_m_s, scratch));
}

/* A trial that swam |executed| beats, each |error_m_s| off. */
static void learn(uint16_t executed, float error_m_s, beyond_t policy) {
    float error[BEATS];
    uint8_t measured[BEATS];
    for (uint32_t k = 0; k < BEATS; k++) {
        error[k] = error_m_s;
        measured[k] = k < executed;
    }
    const law_trial_t trial = {.beats = BEATS, .error_m_s = error, .measured = measured};
    const memory_rules_t rules = {.beyond = policy};
    memory_report_t report;
    TEST_ASSERT_EQUAL(LAW_OK, memory_learn(&memory, &law, &trial, memory.last_trial + 1u, false,
                                           &rules, scratch, &report));
}

static const float FLAT[BEATS] = {0.02f, 0.02f, 0.02f, 0.02f, 0.02f, 0.02f, 0.02f, 0.02f};

/* Whole trials of a tail that takes no correction: no policy may change what it gets. */
static void test_a_tail_that_takes_no_correction_is_the_laws_alone(void) {
    for (law_tail_t tail = LAW_TAIL_HOLD; tail < LAW_TAIL_COUNT; tail++) {
        for (float lead = 0.0f; lead <= 7.5f; lead += 0.5f) {
            float kept[BEATS];
            setUp();
            law.tail = tail;
            law.lead_beats = lead;
            for (beyond_t policy = BEYOND_KEEP; policy < BEYOND_COUNT; policy++) {
                memset(&memory, 0, sizeof memory);
                begin(FLAT);
                for (uint32_t k = 0; k < BEATS; k++) {
                    memory.amplitude_rad[k] = 0.1f + 0.01f * (float)k;
                }
                learn(BEATS, 0.01f, policy);
                learn(BEATS, 0.02f, policy);
                if (policy == BEYOND_KEEP) {
                    memcpy(kept, memory.amplitude_rad, sizeof kept);
                }
                TEST_ASSERT_EQUAL_MEMORY(kept, memory.amplitude_rad, sizeof kept);
            }
        }
    }
}

static void test_the_memory_holds_what_no_trial_reached(void) {
    begin(FLAT);
    learn(3, 0.01f, BEYOND_HOLD);
    for (uint32_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.12f, memory.amplitude_rad[k]);
    }
    learn(5, -0.01f, BEYOND_HOLD);
    const uint8_t wanted[BEATS] = {2, 2, 2, 1, 1, 0, 0, 0};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(wanted, memory.visits, BEATS);
    for (uint32_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.08f, memory.amplitude_rad[k]);
    }
}

static void test_a_beat_that_was_ever_corrected_stays(void) {
    begin(FLAT);
    learn(6, 0.01f, BEYOND_KEEP);
    learn(3, 0.01f, BEYOND_TAPER);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.16f, memory.amplitude_rad[2]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.12f, memory.amplitude_rad[5]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.08f, memory.amplitude_rad[6]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.04f, memory.amplitude_rad[7]);
}

/* A lead leaves beats behind that were swum and yet not corrected. */
static void test_a_lead_moves_where_beyond_begins(void) {
    law.lead_beats = 2.0f;
    begin(FLAT);
    learn(5, 0.01f, BEYOND_HOLD);
    const uint8_t wanted[BEATS] = {1, 1, 1, 0, 0, 0, 0, 0};
    TEST_ASSERT_EQUAL_UINT8_ARRAY(wanted, memory.visits, BEATS);
    TEST_ASSERT_TRUE(memory.amplitude_rad[3] == memory.amplitude_rad[2]);
    TEST_ASSERT_TRUE(memory.amplitude_rad[7] == memory.amplitude_rad[2]);
}

/* The promise of DU_MAX_RAD is for every beat that is swum. */
static void test_no_beat_steps_further_than_the_limit(void) {
    static const float bump[BEATS] = {0.1f, 0.1f, 0.1f, 0.0f, 0.0f, 0.0f, 0.0f, 0.15f};
    law.step_max_rad = 0.05f;
    for (int policy = BEYOND_HOLD; policy < BEYOND_COUNT; policy++) {
        memset(&memory, 0, sizeof memory);
        begin(bump);
        for (int trial = 0; trial < 12; trial++) {
            float old[BEATS];
            memcpy(old, memory.amplitude_rad, sizeof old);
            learn(3, 0.001f, (beyond_t)policy);
            for (uint32_t k = 0; k < BEATS; k++) {
                const float step = memory.amplitude_rad[k] - law_saturate(&law, old[k]);
                TEST_ASSERT_TRUE(fabsf(step) <= 0.05f * 1.0001f);
            }
        }
        const float last = policy == BEYOND_HOLD ? memory.amplitude_rad[2] : 0.0f;
        TEST_ASSERT_FLOAT_WITHIN(0.08f, last, memory.amplitude_rad[7]);
    }
}

/* The filter finds no edge where the held beats begin. */
static void test_the_filter_sees_what_was_filled(void) {
    static const float step[BEATS] = {0.1f, 0.1f, 0.1f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    law.q_len = 2u;
    begin(step);
    learn(3, 0.0f, BEYOND_HOLD);
    static const float wanted[BEATS] = {0.4f, 0.375f, 0.325f, 0.3f, 0.3f, 0.3f, 0.3f, 0.3f};
    for (uint32_t k = 0; k < BEATS; k++) { /* the first guess, filtered, has 0.4 0.4 0.3 0.1 0 */
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, wanted[k], memory.amplitude_rad[k]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_keep_touches_nothing);
    RUN_TEST(test_hold_repeats_the_last_corrected_beat);
    RUN_TEST(test_taper_goes_evenly_down_to_zero_at_the_end);
    RUN_TEST(test_without_any_visit_or_with_all_nothing_happens);
    RUN_TEST(test_holes_before_the_last_visit_are_left);
    RUN_TEST(test_the_shortest_trials);
    RUN_TEST(test_the_tail_is_left);
    RUN_TEST(test_a_tail_behind_which_all_lies_is_left);
    RUN_TEST(test_an_unknown_policy_keeps);
    RUN_TEST(test_a_tail_that_takes_no_correction_is_the_laws_alone);
    RUN_TEST(test_the_memory_holds_what_no_trial_reached);
    RUN_TEST(test_a_beat_that_was_ever_corrected_stays);
    RUN_TEST(test_a_lead_moves_where_beyond_begins);
    RUN_TEST(test_no_beat_steps_further_than_the_limit);
    RUN_TEST(test_the_filter_sees_what_was_filled);
    return UNITY_END();
}
