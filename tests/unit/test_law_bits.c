/* law.c leaves out operations whose result is known: the bits must be those of all of them. */
#include "ilc/law.h"

#include "law_plain.h"
#include "target.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define BEATS_MOST 40u
#define CASES TIMES(3000u, 300u)

static uint32_t random_state;
static number_t error_m_s[BEATS_MOST], amplitude_rad[BEATS_MOST];
static uint8_t measured[BEATS_MOST], visits[BEATS_MOST];

void setUp(void) { random_state = 7u; }
void tearDown(void) {}

static uint32_t below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (uint32_t)(((uint64_t)random_state * limit) >> 32);
}

/* Zeros of both signs and denormals with the rest. */
static number_t number(float limit) {
    const float scale = (float)(int32_t)(below(2001u) - 1000u) * 1e-3f;
    switch (below(12)) {
    case 0:
        return 0.0f;
    case 1:
        return -0.0f;
    case 2:
        return scale * 1e-40f;
    default:
        return limit * scale;
    }
}

static law_t random_law(uint16_t beats) {
    law_t law = {.kp_rad_s_m = number(8.0f),
                 .amplitude_max_rad = 0.5f,
                 .amplitude_min_rad = below(3) == 0 ? -0.2f : 0.0f,
                 .beat_s = 0.7f,
                 .lead_beats = 0.5f * (float)below(beats < 6u ? 2u * beats : 12u),
                 .q_len = (uint16_t)(1u + below(2) * below((beats + 1u) / 2u)),
                 .tail = (law_tail_t)below(LAW_TAIL_COUNT)};
    law.kd_rad_s2_m = below(2) != 0 ? number(2.0f) : 0.0f;
    law.step_max_rad = below(2) != 0 ? fabsf(number(0.1f)) : 0.0f;
    law.fade = below(2) != 0 ? fabsf(number(2.0f)) : 0.0f;
    law.fade_from = (uint16_t)below(4);
    return law;
}

static law_trial_t random_trial(uint16_t beats) {
    for (uint32_t k = 0; k < beats; k++) {
        error_m_s[k] = number(0.1f);
        amplitude_rad[k] = number(0.7f);
        measured[k] = below(6) != 0;
        visits[k] = (uint8_t)(below(3) + (below(8) == 0 ? 5u : 0u));
    }
    measured[below(beats)] = 1;
    return (law_trial_t){beats, error_m_s, below(4) != 0 ? measured : NULL,
                         below(4) != 0 ? visits : NULL};
}

static void an_update_has_the_bits_of_all_operations(void) {
    for (uint32_t i = 0; i < CASES; i++) {
        const uint16_t beats = (uint16_t)(1u + below(BEATS_MOST));
        const law_t law = random_law(beats);
        const law_trial_t trial = random_trial(beats);
        number_t given[BEATS_MOST], plain[BEATS_MOST], scratch[BEATS_MOST];
        law_report_t report, plain_report;
        memcpy(given, amplitude_rad, sizeof given);
        memcpy(plain, amplitude_rad, sizeof plain);
        TEST_ASSERT_EQUAL(LAW_OK, law_update(&law, &trial, given, scratch, &report));
        plain_update(&law, &trial, plain, scratch, &plain_report);
        TEST_ASSERT_EQUAL_MEMORY(plain, given, beats * sizeof given[0]);
        TEST_ASSERT_EQUAL_MEMORY(&plain_report, &report, sizeof report);
    }
}

/* Weights of 1 and others, factors of 0. */
static void trials_are_added_with_the_bits_of_all_operations(void) {
    const number_t factors[] = {1.0f, 0.0f, 0.25f, 1.0f / 3.0f};
    for (uint32_t i = 0; i < CASES; i++) {
        const uint16_t beats = (uint16_t)(1u + below(BEATS_MOST));
        const law_t law = random_law(beats);
        number_t sum[BEATS_MOST] = {0}, plain_sum[BEATS_MOST] = {0};
        for (uint32_t j = 0; j < 3u; j++) {
            const law_trial_t trial = random_trial(beats);
            const law_weights_t weights = {factors[below(4)], factors[below(4)], factors[below(4)]};
            TEST_ASSERT_EQUAL(LAW_OK, law_add(&law, &weights, &trial, amplitude_rad, sum));
            plain_add(&law, &weights, &trial, amplitude_rad, plain_sum);
        }
        TEST_ASSERT_EQUAL_MEMORY(plain_sum, sum, beats * sizeof sum[0]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(an_update_has_the_bits_of_all_operations);
    RUN_TEST(trials_are_added_with_the_bits_of_all_operations);
    return UNITY_END();
}
