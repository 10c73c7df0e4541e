/* The law against hand-made numbers and an independent filter. */
#include "ilc/law.h"

#include "base/crc.h"
#include "base/units.h"
#include "unity.h"

#include <math.h>
#include <string.h>

#define PI 3.14159265358979323846
#define BEATS 40u

static law_t law;
static float u[BEATS_MAX];
static float e[BEATS_MAX];
static uint8_t measured[BEATS_MAX];
static uint8_t visits[BEATS_MAX];
static float scratch[BEATS_MAX];
static law_report_t report;

void setUp(void) {
    law = (law_t){.kp_rad_s_m = 4.0f, .amplitude_max_rad = 0.7853982f, .beat_s = 1.0f, .q_len = 1};
    memset(u, 0, sizeof u);
    memset(e, 0, sizeof e);
    memset(measured, 1, sizeof measured);
    memset(visits, 0, sizeof visits);
    memset(&report, 0x55, sizeof report);
}
void tearDown(void) {}

static law_result_t update(uint16_t beats) {
    const law_trial_t trial = {
        .beats = beats, .error_m_s = e, .measured = measured, .visits = visits};
    return law_update(&law, &trial, u, scratch, &report);
}

static void set(float *to, const float *values, size_t count) {
    memcpy(to, values, count * sizeof *to);
}

static void check(const float *expected, size_t count) {
    for (size_t k = 0; k < count; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, expected[k], u[k]);
    }
}

static void test_the_thesis_law(void) {
    set(u, (float[]){0.0f, 0.2f, 0.5f}, 3);
    set(e, (float[]){0.05f, 0.0f, -0.02f}, 3);
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){0.2f, 0.2f, 0.42f}, 3);
}

static void test_the_old_input_is_saturated_before_the_correction(void) {
    set(u, (float[]){3.0f, -3.0f}, 2);
    set(e, (float[]){0.1f, -0.1f}, 2);
    TEST_ASSERT_EQUAL(LAW_OK, update(2));
    check((float[]){1.1853982f, -0.4f}, 2);
    TEST_ASSERT_EQUAL(1, report.saturated_beats);
}

static void test_an_unreachable_target_does_not_wind_up(void) {
    for (int trial = 0; trial < 1000; trial++) {
        e[0] = 0.1f;
        TEST_ASSERT_EQUAL(LAW_OK, update(1));
        TEST_ASSERT_TRUE(u[0] <= law.amplitude_max_rad + 0.4001f);
    }
    e[0] = -0.05f;
    TEST_ASSERT_EQUAL(LAW_OK, update(1));
    TEST_ASSERT_TRUE(law_saturate(&law, u[0]) < law.amplitude_max_rad);
}

static void test_lead_and_tails(void) {
    law.lead_beats = 2;
    set(u, (float[]){0.1f, 0.1f, 0.1f, 2.0f}, 4);
    set(e, (float[]){0.9f, 0.9f, 0.01f, 0.02f}, 4);
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.14f, 0.18f, 0.18f, 0.8653982f}, 4);

    law.tail = LAW_TAIL_KEEP;
    set(u, (float[]){0.1f, 0.1f, 0.1f, 2.0f}, 4);
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.14f, 0.18f, 0.1f, 0.7853982f}, 4);
}

static void test_derivative_is_the_forward_difference(void) {
    law.kp_rad_s_m = 0.0f;
    law.kd_rad_s2_m = 3.0f;
    law.beat_s = 0.5f;
    set(e, (float[]){0.01f, 0.03f, 0.02f}, 3);
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){0.12f, -0.06f, -0.06f}, 3);

    law.lead_beats = 1;
    memset(u, 0, sizeof u);
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){-0.06f, -0.06f, -0.06f}, 3);
}

static void test_half_a_beat_on_is_the_mean_of_two_beats(void) {
    law.lead_beats = 0.5f;
    set(e, (float[]){0.01f, 0.03f, 0.02f, -0.04f}, 4);
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.08f, 0.1f, -0.04f, -0.16f}, 4);

    law.lead_beats = 1.5f;
    memset(u, 0, sizeof u);
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.1f, -0.04f, -0.16f, -0.16f}, 4);

    law.tail = LAW_TAIL_KEEP;
    set(u, (float[]){0.0f, 0.0f, 0.3f, 2.0f}, 4);
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.1f, -0.04f, 0.3f, 0.7853982f}, 4);
}

static void test_half_a_beat_takes_the_neighbour_that_was_measured(void) {
    law.lead_beats = 0.5f;
    set(e, (float[]){0.01f, (float)NAN, 0.02f, -0.04f, 1e30f, (float)NAN, 0.05f}, 7);
    measured[1] = measured[4] = measured[5] = 0;
    TEST_ASSERT_EQUAL(LAW_OK, update(7));
    check((float[]){0.04f, 0.08f, -0.04f, -0.16f, 0.0f, 0.2f, 0.2f}, 7);
}

/* The law is linear in e: away from the tail half a beat lies in the middle of its two neighbours.
 */
static void test_half_leads_lie_between_the_whole_ones(void) {
    float low[BEATS], high[BEATS];
    law.kd_rad_s2_m = -1.5f;
    law.beat_s = 0.8f;
    for (uint32_t k = 0; k < BEATS; k++) {
        e[k] = 0.003f * (float)(k * 11u % 37u) - 0.05f;
    }
    for (uint32_t lead = 0; lead < 6u; lead++) {
        law.lead_beats = (float)lead;
        memset(u, 0, sizeof u);
        TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
        memcpy(low, u, sizeof low);
        law.lead_beats = (float)lead + 1.0f;
        memset(u, 0, sizeof u);
        TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
        memcpy(high, u, sizeof high);
        law.lead_beats = (float)lead + 0.5f;
        memset(u, 0, sizeof u);
        TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
        for (uint32_t k = 0; k + lead + 1u < BEATS; k++) {
            TEST_ASSERT_FLOAT_WITHIN(1e-6f, (low[k] + high[k]) / 2.0f, u[k]);
        }
    }
}

static void test_what_a_trial_corrects(void) {
    const law_trial_t trial = {.beats = 4, .error_m_s = e, .measured = measured};
    measured[1] = measured[2] = 0;
    const uint8_t wanted[][LAW_TAIL_COUNT][4] = {
        /* hold, keep, hold new, hold old */
        {{1, 0, 0, 1}, {1, 0, 0, 1}, {1, 0, 0, 1}, {1, 0, 0, 1}},
        {{1, 0, 1, 1}, {1, 0, 1, 0}, {1, 0, 1, 1}, {1, 0, 1, 0}},
        {{0, 0, 1, 1}, {0, 0, 1, 0}, {0, 0, 1, 1}, {0, 0, 1, 0}},
        {{0, 1, 1, 1}, {0, 1, 0, 0}, {0, 1, 1, 1}, {0, 1, 0, 0}},
    };
    for (uint32_t halves = 0; halves < 4u; halves++) {
        for (uint32_t k = 0; k < 4u; k++) {
            for (uint32_t tail = 0; tail < LAW_TAIL_COUNT; tail++) {
                law.lead_beats = (float)halves / 2.0f;
                law.tail = (law_tail_t)tail;
                TEST_ASSERT_EQUAL(wanted[halves][tail][k], law_corrects(&law, &trial, k));
            }
        }
    }
}

/* Against the update itself: what it moves is what one says it corrects. */
static void check_corrects(uint16_t beats) {
    const law_trial_t trial = {.beats = beats, .error_m_s = e, .measured = measured};
    for (uint32_t k = 0; k < beats; k++) {
        u[k] = 0.3f;
        e[k] = 0.01f + 0.003f * (float)(k * k);
    }
    TEST_ASSERT_EQUAL(LAW_OK, update(beats));
    for (uint32_t k = 0; k < beats; k++) {
        TEST_ASSERT_EQUAL(u[k] < 0.3f || u[k] > 0.3f, law_corrects(&law, &trial, k));
    }
}

static void test_what_moves_an_amplitude_corrects_it(void) {
    const float derivatives[] = {0.0f, -1.7f, 0.9f};
    for (uint32_t i = 0; i < 3u; i++) {
        for (uint32_t which = 1; which < 32u; which++) {
            for (uint32_t k = 0; k < 5u; k++) {
                measured[k] = (uint8_t)(which >> k & 1u);
            }
            for (uint32_t halves = 0; halves < 10u; halves++) {
                law.kd_rad_s2_m = derivatives[i];
                law.lead_beats = (float)halves / 2.0f;
                law.tail = (law_tail_t)((which + i) % LAW_TAIL_COUNT);
                check_corrects(5);
            }
        }
    }
    law.lead_beats = 0;
    measured[0] = 1;
    check_corrects(1);
}

static void random_series(void) {
    for (uint32_t k = 0; k < BEATS; k++) {
        u[k] = 0.02f * (float)(k * 7u % 41u);
        e[k] = 0.003f * (float)(k * 11u % 37u) - 0.05f;
        visits[k] = (uint8_t)(k * 37u);
    }
}

/* Each beat as if the gain had been set to its share; both runs see the same errors. */
static void test_the_gain_of_a_beat_fades_with_its_visits(void) {
    float faded[BEATS];
    law.lead_beats = 0.5f;
    law.fade = 0.3f;
    law.fade_from = 5;
    random_series();
    TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
    memcpy(faded, u, sizeof faded);
    law.fade = 0.0f;
    for (uint32_t k = 0; k < BEATS; k++) {
        const float beyond = visits[k] > 5u ? (float)visits[k] - 5.0f : 0.0f;
        random_series();
        law.kp_rad_s_m = 4.0f / (1.0f + 0.3f * beyond);
        TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
        TEST_ASSERT_EQUAL_MEMORY(&u[k], &faded[k], sizeof u[k]);
    }
}

static void test_both_gains_fade(void) {
    law.kp_rad_s_m = 0.0f;
    law.kd_rad_s2_m = 3.0f;
    law.fade = 1.0f;
    set(e, (float[]){0.01f, 0.03f, 0.02f}, 3);
    visits[0] = 2;
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){0.02f, -0.03f, -0.03f}, 3);
}

static void test_no_fade_changes_no_bit(void) {
    float full[BEATS];
    law.kd_rad_s2_m = 0.7f;
    random_series();
    memset(visits, 0, sizeof visits);
    TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
    memcpy(full, u, sizeof full);
    random_series();
    TEST_ASSERT_EQUAL(LAW_OK, update(BEATS)); /* fade 0, many visits */
    TEST_ASSERT_EQUAL_MEMORY(full, u, sizeof full);
    random_series();
    law.fade = 10.0f;
    law.fade_from = 255; /* nobody gets there */
    TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
    TEST_ASSERT_EQUAL_MEMORY(full, u, sizeof full);
    random_series();
    law.fade_from = 0;
    const law_trial_t unvisited = {.beats = BEATS, .error_m_s = e};
    TEST_ASSERT_EQUAL(LAW_OK, law_update(&law, &unvisited, u, scratch, &report));
    TEST_ASSERT_EQUAL_MEMORY(full, u, sizeof full);
}

static void test_one_beat_has_no_derivative(void) {
    law.kd_rad_s2_m = 3.0f;
    e[0] = 0.05f;
    TEST_ASSERT_EQUAL(LAW_OK, update(1));
    check((float[]){0.2f}, 1);
}

static void test_unmeasured_beats_count_as_no_error(void) {
    set(e, (float[]){0.01f, (float)NAN, 0.03f, 1e30f}, 4);
    set(u, (float[]){0.1f, 0.1f, 0.1f, 0.1f}, 4);
    measured[1] = 0;
    measured[3] = 0;
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.14f, 0.1f, 0.22f, 0.1f}, 4);
    TEST_ASSERT_EQUAL(2, report.measured_beats);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.03f, report.max_abs_error_m_s);
    TEST_ASSERT_FLOAT_WITHIN(1e-8f, 0.02236068f, report.rms_error_m_s);
}

/* What is not known did not change: only 0 to 1 and 4 to 5 have both ends, and the last beat
 * repeats the difference before it. */
static void test_a_difference_with_an_unmeasured_end_is_none(void) {
    law.kp_rad_s_m = 0.0f;
    law.kd_rad_s2_m = 1.0f;
    set(e, (float[]){0.01f, 0.04f, (float)NAN, 0.5f, (float)NAN, 0.02f, 0.07f}, 7);
    measured[2] = measured[4] = 0;
    TEST_ASSERT_EQUAL(LAW_OK, update(7));
    check((float[]){0.03f, 0.0f, 0.0f, 0.0f, 0.0f, 0.05f, 0.05f}, 7);

    law.lead_beats = 0.5f; /* an unknown half of a mean counts as no change, too */
    memset(u, 0, sizeof u);
    TEST_ASSERT_EQUAL(LAW_OK, update(7));
    check((float[]){0.015f, 0.0f, 0.0f, 0.0f, 0.025f, 0.05f, 0.05f}, 7);

    law.lead_beats = 0.0f;
    measured[6] = 0; /* a trial that was cut has no cliff at its end */
    memset(u, 0, sizeof u);
    TEST_ASSERT_EQUAL(LAW_OK, update(7));
    check((float[]){0.03f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}, 7);
}

static void test_tails_that_hold_an_input(void) {
    const float old[] = {0.1f, 0.2f, 0.3f, 2.0f, -1.0f};
    set(e, (float[]){0.9f, 0.9f, 0.01f, 0.02f, 0.03f}, 5);
    law.lead_beats = 2.0f;
    law.tail = LAW_TAIL_HOLD_NEW;
    set(u, old, 5);
    TEST_ASSERT_EQUAL(LAW_OK, update(5));
    check((float[]){0.14f, 0.28f, 0.42f, 0.42f, 0.42f}, 5);
    law.tail = LAW_TAIL_HOLD_OLD;
    set(u, old, 5);
    TEST_ASSERT_EQUAL(LAW_OK, update(5));
    check((float[]){0.14f, 0.28f, 0.42f, 0.3f, 0.3f}, 5);

    law.lead_beats = 0.5f;
    set(u, (float[]){0.1f, 0.2f, 0.3f, 2.0f, -1.0f}, 5);
    TEST_ASSERT_EQUAL(LAW_OK, update(5)); /* the old input that is held is saturated, too */
    check((float[]){3.7f, 2.02f, 0.36f, 0.8853982f, 0.7853982f}, 5);
}

static void test_tails_are_held_ahead_of_the_filter(void) {
    law.lead_beats = 1.5f;
    law.tail = LAW_TAIL_HOLD_NEW;
    law.q_len = 2;
    set(e, (float[]){0.0f, 0.1f, 0.1f, 0.3f, 0.3f}, 5);
    TEST_ASSERT_EQUAL(LAW_OK, update(5)); /* .4 .8 1.2, held: 1.2 1.2; then 1 2 1 */
    check((float[]){1.6f / 3.0f, 0.8f, 1.1f, 1.2f, 1.2f}, 5);
}

static void test_a_lead_that_leaves_nothing_to_hold_keeps(void) {
    for (uint32_t tail = LAW_TAIL_KEEP; tail < LAW_TAIL_COUNT; tail++) {
        law.tail = (law_tail_t)tail;
        law.lead_beats = 2.5f;
        set(u, (float[]){0.1f, 2.0f, 0.3f}, 3);
        set(e, (float[]){0.1f, 0.1f, 0.1f}, 3);
        TEST_ASSERT_EQUAL(LAW_OK, update(3));
        check((float[]){0.1f, 0.7853982f, 0.3f}, 3);
        law.lead_beats = 2.0f; /* one beat is corrected, and held to the end */
        set(u, (float[]){0.1f, 0.2f, 0.3f}, 3);
        TEST_ASSERT_EQUAL(LAW_OK, update(3));
        const float held = tail == LAW_TAIL_HOLD_NEW ? 0.5f : 0.1f;
        const bool keeps = tail == LAW_TAIL_KEEP;
        check((float[]){0.5f, keeps ? 0.2f : held, keeps ? 0.3f : held}, 3);
    }
}

/* The contract read plainly, in double: e or de at a place on the beats' own grid. */
static double plain_error(double place) {
    const uint32_t near[2] = {(uint32_t)floor(place), (uint32_t)ceil(place)};
    double sum = 0.0, seen = 0.0;
    for (uint32_t i = 0; i < 2u; i++) {
        sum += measured[near[i]] ? (double)e[near[i]] : 0.0;
        seen += measured[near[i]] ? 1.0 : 0.0;
    }
    return seen > 0.0 ? sum / seen : 0.0;
}

static double plain_difference(double place, uint32_t beats) {
    double sum = 0.0;
    const uint32_t near[2] = {(uint32_t)floor(place), (uint32_t)ceil(place)};
    for (uint32_t i = 0; i < 2u; i++) {
        const uint32_t from = near[i] == beats - 1u ? beats - 2u : near[i];
        if (measured[from] && measured[from + 1u]) {
            sum += ((double)e[from + 1u] - (double)e[from]) / (double)law.beat_s;
        }
    }
    return sum / 2.0;
}

static double plain_old(uint32_t k) {
    return fmin(fmax((double)u[k], (double)law.amplitude_min_rad), (double)law.amplitude_max_rad);
}

static void plain_update(uint32_t beats, double *out) {
    const double last = beats - 1u, lead = (double)law.lead_beats;
    const bool hold_new = law.tail == LAW_TAIL_HOLD_NEW, hold_old = law.tail == LAW_TAIL_HOLD_OLD;
    int32_t corrected = -1; /* the last beat that is */
    for (uint32_t k = 0; k < beats; k++) {
        double place = k + lead;
        out[k] = plain_old(k);
        if (place > last && law.tail == LAW_TAIL_HOLD) {
            place = last;
        }
        if (place <= last) {
            corrected = (int32_t)k;
            out[k] += (double)law.kp_rad_s_m * plain_error(place) +
                      (double)law.kd_rad_s2_m * plain_difference(place, beats);
        } else if (corrected >= 0 && (hold_new || hold_old)) {
            out[k] = hold_new ? out[corrected] : plain_old((uint32_t)corrected);
        }
    }
}

static void test_all_leads_and_tails_against_a_plain_reading(void) {
    double wanted[BEATS];
    law.kd_rad_s2_m = -0.7f;
    law.beat_s = 0.8f;
    law.amplitude_min_rad = -0.2f;
    for (uint32_t tail = 0; tail < LAW_TAIL_COUNT; tail++) {
        for (uint32_t halves = 0; halves < 2u * BEATS; halves++) {
            law.tail = (law_tail_t)tail;
            law.lead_beats = (float)halves / 2.0f;
            for (uint32_t k = 0; k < BEATS; k++) {
                u[k] = 0.05f * (float)(k * 7u % 41u) - 0.5f;
                e[k] = 0.003f * (float)(k * 11u % 37u) - 0.05f;
                measured[k] = (k * 5u + halves) % 7u != 3u;
            }
            plain_update(BEATS, wanted);
            TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
            for (uint32_t k = 0; k < BEATS; k++) {
                TEST_ASSERT_FLOAT_WITHIN(1e-6f, (float)wanted[k], u[k]);
            }
        }
    }
}

static void test_the_range_may_begin_below_zero(void) {
    law.amplitude_min_rad = -0.3f;
    law.amplitude_max_rad = -0.1f;
    set(u, (float[]){-1.0f, -0.2f, 0.5f}, 3);
    set(e, (float[]){0.01f, 0.01f, 0.01f}, 3);
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){-0.26f, -0.16f, -0.06f}, 3);
    TEST_ASSERT_EQUAL(1, report.saturated_beats);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, -0.3f, law_saturate(&law, -2.0f));
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, -0.1f, law_saturate(&law, 0.0f));
    TEST_ASSERT_TRUE(isnan(law_saturate(&law, (float)NAN)));
}

static law_result_t add(law_weights_t weights, uint16_t beats, float *sum) {
    const law_trial_t trial = {
        .beats = beats, .error_m_s = e, .measured = measured, .visits = visits};
    return law_add(&law, &weights, &trial, u, sum);
}

static void test_weighted_trials_add_up(void) {
    float sum[3] = {0};
    law.kd_rad_s2_m = 2.0f;
    law.beat_s = 0.5f;
    set(u, (float[]){0.2f, 0.4f, 2.0f}, 3);
    set(e, (float[]){0.01f, 0.03f, (float)NAN}, 3);
    measured[2] = 0;
    TEST_ASSERT_EQUAL(LAW_OK, add((law_weights_t){0.75f, 0.5f, -1.0f}, 3, sum));
    set(u, (float[]){0.1f, -0.4f, 0.3f}, 3);
    set(e, (float[]){0.05f, -0.02f, 0.01f}, 3);
    measured[2] = 1;
    TEST_ASSERT_EQUAL(LAW_OK, add((law_weights_t){0.25f, 2.0f, 0.0f}, 3, sum));
    const float wanted[] = {0.15f + 0.02f - 0.08f + 0.025f + 0.4f, 0.3f + 0.06f - 0.16f,
                            0.58904862f + 0.075f + 0.08f};
    for (uint32_t k = 0; k < 3u; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, wanted[k], sum[k]);
    }
    law.step_max_rad = 0.1f; /* of what was last swum */
    law_finish(&law, 3, sum, u);
    check((float[]){0.2f, 0.1f, 0.4f}, 3);
}

static void test_the_old_tail_holds_what_was_last_swum(void) {
    float sum[3] = {0.5f, 0.6f, 0.7f};
    set(u, (float[]){0.1f, 2.0f, 0.3f}, 3);
    law.lead_beats = 1.0f;
    law.tail = LAW_TAIL_HOLD_OLD;
    law_finish(&law, 3, sum, u);
    check((float[]){0.5f, 0.6f, 0.7853982f}, 3);
}

static void test_a_trial_without_speeds_adds_its_input(void) {
    float sum[2] = {0.1f, 0.1f};
    memset(measured, 0, sizeof measured);
    set(u, (float[]){0.2f, 2.0f}, 2);
    TEST_ASSERT_EQUAL(LAW_OK, add((law_weights_t){0.5f, 1.0f, 1.0f}, 2, sum));
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.2f, sum[0]);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 0.4926991f, sum[1]);
}

static void check_not_added(law_result_t expected, law_weights_t weights) {
    const float before[2] = {0.1f, 0.2f};
    float sum[2] = {0.1f, 0.2f};
    TEST_ASSERT_EQUAL(expected, add(weights, 2, sum));
    TEST_ASSERT_EQUAL_MEMORY(before, sum, sizeof sum);
}

static void test_what_cannot_be_added_leaves_the_sum(void) {
    const float bad[] = {(float)NAN, (float)INFINITY, -(float)INFINITY};
    set(u, (float[]){0.2f, 0.3f}, 2);
    set(e, (float[]){0.1f, 0.2f}, 2);
    for (int i = 0; i < 3; i++) {
        check_not_added(LAW_BAD_INPUT, (law_weights_t){bad[i], 1.0f, 1.0f});
        check_not_added(LAW_BAD_INPUT, (law_weights_t){1.0f, bad[i], 1.0f});
        check_not_added(LAW_BAD_INPUT, (law_weights_t){1.0f, 1.0f, bad[i]});
        e[1] = bad[i];
        check_not_added(LAW_BAD_INPUT, (law_weights_t){1.0f, 1.0f, 1.0f});
        e[1] = 0.2f;
        u[1] = bad[i];
        check_not_added(LAW_BAD_INPUT, (law_weights_t){1.0f, 1.0f, 1.0f});
        u[1] = 0.3f;
    }
    check_not_added(LAW_BAD_INPUT, (law_weights_t){1e31f, 1.0f, 1.0f});
    check_not_added(LAW_BAD_INPUT, (law_weights_t){1.0f, 1e31f, 1.0f});
    law.kd_rad_s2_m = 1.0f;
    check_not_added(LAW_BAD_INPUT, (law_weights_t){1.0f, 1.0f, 1e31f});
    law.q_len = 2;
    check_not_added(LAW_BAD_CONFIG, (law_weights_t){1.0f, 1.0f, 1.0f});
}

static void test_one_whole_trial_added_and_finished_is_the_update(void) {
    const law_weights_t whole = {1.0f, 1.0f, 1.0f};
    float updated[BEATS], sum[BEATS];
    for (uint32_t tail = 0; tail < LAW_TAIL_COUNT; tail++) {
        law = (law_t){.kp_rad_s_m = 4.1f,
                      .kd_rad_s2_m = 0.3f,
                      .amplitude_min_rad = -0.1f,
                      .amplitude_max_rad = 0.7f,
                      .step_max_rad = 0.25f,
                      .beat_s = 0.9f,
                      .lead_beats = 2.5f,
                      .fade = 0.17f,
                      .q_len = 5,
                      .tail = (law_tail_t)tail};
        random_series();
        measured[7] = 0;
        TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
        memcpy(updated, u, sizeof updated);
        random_series();
        memset(sum, 0, sizeof sum);
        TEST_ASSERT_EQUAL(LAW_OK, add(whole, BEATS, sum));
        law_finish(&law, BEATS, sum, u);
        TEST_ASSERT_EQUAL_MEMORY(updated, u, sizeof updated);
    }
}

static void test_no_flags_means_all_measured(void) {
    const law_trial_t trial = {.beats = 3, .error_m_s = e, .measured = NULL};
    e[2] = -0.3f;
    TEST_ASSERT_EQUAL(LAW_OK, law_judge(&law, &trial, u, &report));
    TEST_ASSERT_EQUAL(3, report.measured_beats);
    TEST_ASSERT_FLOAT_WITHIN(1e-7f, 0.3f, report.max_abs_error_m_s);
}

static void check_filter(uint16_t q_len, float scale, const float *in, const float *expected) {
    float out[11];
    law_zero_phase(in, out, 11, q_len);
    for (size_t k = 0; k < 11; k++) {
        TEST_ASSERT_FLOAT_WITHIN(2e-6f, expected[k], scale * out[k]);
    }
}

static void test_filter_goldens(void) {
    check_filter(4, 16.0f, (float[]){0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0},
                 (float[]){0, 0, 1.0666667f, 2, 3, 4, 3, 2, 1.0666667f, 0, 0});
    check_filter(4, 1.0f, (float[]){0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10},
                 (float[]){1, 1.5384615f, 2.2f, 3, 4, 5, 6, 7, 7.8f, 8.4615385f, 9});
    check_filter(3, 1.0f, (float[]){0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1},
                 (float[]){0, 0, 0, 0.1111111f, 0.3333333f, 0.6666667f, 0.8888889f, 1, 1, 1, 1});
}

/* Two passes of a moving mean, one each way, in double: (6.42) as the thesis writes it. */
static void test_filter_is_two_moving_means_away_from_the_ends(void) {
    enum { N0 = 5, COUNT = 40 };
    float in[COUNT], out[COUNT];
    double pass[COUNT] = {0};
    for (int k = 0; k < COUNT; k++) {
        in[k] = (float)((k * 37 % 23) - 11) * 0.01f;
    }
    law_zero_phase(in, out, COUNT, N0);
    for (int k = N0 - 1; k < COUNT; k++) {
        for (int j = 0; j < N0; j++) {
            pass[k] += (double)in[k - j] / N0;
        }
    }
    for (int k = N0 - 1; k <= COUNT - N0; k++) {
        double twice = 0.0;
        for (int j = 0; j < N0; j++) {
            twice += pass[k + j] / N0;
        }
        TEST_ASSERT_TRUE(fabs((double)out[k] - twice) < 1e-7);
    }
}

static void test_filter_mirrors_bit_for_bit(void) {
    float in[31], mirrored[31], out[31], out_mirrored[31];
    for (uint32_t k = 0; k < 31u; k++) {
        in[k] = 0.1f * (float)(k * 17u % 13u) + 1e-3f * (float)k;
        mirrored[30u - k] = in[k];
    }
    law_zero_phase(in, out, 31, 16);
    law_zero_phase(mirrored, out_mirrored, 31, 16);
    for (uint32_t k = 0; k < 31u; k++) {
        TEST_ASSERT_EQUAL_MEMORY(&out[k], &out_mirrored[30u - k], sizeof(float));
    }
}

static void test_filter_length_one_changes_no_bit(void) {
    const float in[3] = {0.1f, -0.3f, 1e-30f};
    float out[3];
    law_zero_phase(in, out, 3, 1);
    TEST_ASSERT_EQUAL_MEMORY(in, out, sizeof in);
}

static void test_the_filter_acts_on_the_corrected_input(void) {
    law.q_len = 2;
    set(u, (float[]){0.4f, 0.4f, 0.4f}, 3);
    set(e, (float[]){0.0f, 0.1f, 0.0f}, 3);
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){0.4f + 0.4f / 3.0f, 0.6f, 0.4f + 0.4f / 3.0f}, 3);
}

static void test_steps_are_limited_after_the_filter(void) {
    law.step_max_rad = 0.15f;
    set(u, (float[]){0.3f, 0.3f, 2.0f, 0.3f}, 4);
    set(e, (float[]){0.1f, -0.1f, 0.1f, 0.01f}, 4);
    TEST_ASSERT_EQUAL(LAW_OK, update(4));
    check((float[]){0.45f, 0.15f, 0.9353982f, 0.34f}, 4);

    law.q_len = 2;
    set(u, (float[]){0.0f, 0.0f, 0.0f}, 3);
    set(e, (float[]){0.0f, 0.1f, 0.0f}, 3);
    TEST_ASSERT_EQUAL(LAW_OK, update(3));
    check((float[]){0.4f / 3.0f, 0.15f, 0.4f / 3.0f}, 3);
}

static void check_refused(law_result_t expected, uint16_t beats) {
    float before[BEATS_MAX];
    law_report_t untouched;
    memcpy(before, u, sizeof u);
    memcpy(&untouched, &report, sizeof report);
    TEST_ASSERT_EQUAL(expected, update(beats));
    TEST_ASSERT_EQUAL_MEMORY(before, u, sizeof u);
    TEST_ASSERT_EQUAL_MEMORY(&untouched, &report, sizeof report);
    const law_trial_t trial = {.beats = beats, .error_m_s = e, .measured = measured};
    TEST_ASSERT_EQUAL(expected, law_judge(&law, &trial, u, &report));
    TEST_ASSERT_EQUAL_MEMORY(&untouched, &report, sizeof report);
}

static void check_bad_field(float *field, float value) {
    const float good = *field;
    *field = value;
    check_refused(LAW_BAD_CONFIG, 5);
    *field = good;
}

static void test_bad_configurations(void) {
    const float bad[] = {(float)NAN, (float)INFINITY, -(float)INFINITY};
    for (int i = 0; i < 3; i++) {
        check_bad_field(&law.kp_rad_s_m, bad[i]);
        check_bad_field(&law.kd_rad_s2_m, bad[i]);
        check_bad_field(&law.amplitude_min_rad, bad[i]);
        check_bad_field(&law.amplitude_max_rad, bad[i]);
        check_bad_field(&law.step_max_rad, bad[i]);
        check_bad_field(&law.beat_s, bad[i]);
        check_bad_field(&law.lead_beats, bad[i]);
        check_bad_field(&law.fade, bad[i]);
    }
    check_bad_field(&law.amplitude_max_rad, 0.0f);
    check_bad_field(&law.amplitude_max_rad, -1.0f);
    check_bad_field(&law.amplitude_max_rad, 2e30f);
    check_bad_field(&law.amplitude_min_rad, -2e30f);
    check_bad_field(&law.amplitude_min_rad, law.amplitude_max_rad);
    check_bad_field(&law.step_max_rad, -0.1f);
    check_bad_field(&law.lead_beats, -0.5f);
    check_bad_field(&law.lead_beats, 0.25f);
    check_bad_field(&law.lead_beats, 3e38f);
    check_bad_field(&law.fade, -0.1f);
    check_bad_field(&law.beat_s, 0.0f);
    law.tail = LAW_TAIL_COUNT;
    check_refused(LAW_BAD_CONFIG, 5);
}

static void test_lengths(void) {
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, law_check(&law, 0));
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, 1));
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, UINT16_MAX));
    law.lead_beats = 5;
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, law_check(&law, 5));
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, 6));
    law.lead_beats = 4.5f;
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, 5));
    law.lead_beats = 0.5f;
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, 1));
    law.lead_beats = 0;
    law.q_len = 0;
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, law_check(&law, 5));
    law.q_len = 4;
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, law_check(&law, 6));
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, 7));
    law.q_len = LAW_Q_LEN_MAX;
    TEST_ASSERT_EQUAL(LAW_OK, law_check(&law, 2u * LAW_Q_LEN_MAX - 1u));
    law.q_len = LAW_Q_LEN_MAX + 1u;
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, law_check(&law, UINT16_MAX));
    law.q_len = UINT16_MAX;
    TEST_ASSERT_EQUAL(LAW_BAD_CONFIG, law_check(&law, UINT16_MAX));
}

static void test_one_bad_number_refuses_the_whole_trial(void) {
    const float bad[] = {(float)NAN, (float)INFINITY, -(float)INFINITY};
    for (int i = 0; i < 3; i++) {
        e[4] = bad[i];
        check_refused(LAW_BAD_INPUT, 5);
        e[4] = 0.0f;
        u[4] = bad[i];
        check_refused(LAW_BAD_INPUT, 5);
        u[4] = 0.0f;
    }
    TEST_ASSERT_EQUAL(LAW_OK, update(5));
}

static void test_finite_numbers_that_would_overflow_are_refused(void) {
    e[0] = 3e38f;
    check_refused(LAW_BAD_INPUT, 5);
    law.kp_rad_s_m = 0.001f;
    e[0] = 1e25f; /* its square is too large for the RMS */
    check_refused(LAW_BAD_INPUT, 5);
    e[0] = 1e18f;
    law.kp_rad_s_m = 1e18f;
    check_refused(LAW_BAD_INPUT, 5);
    law.kp_rad_s_m = 0.0f;
    law.kd_rad_s2_m = 1e30f;
    law.beat_s = 1e-30f;
    check_refused(LAW_BAD_INPUT, 5);
    e[0] = 0.0f;
    check_refused(LAW_BAD_INPUT, 5);
}

static void test_nothing_measured(void) {
    memset(measured, 0, sizeof measured);
    check_refused(LAW_NOTHING_MEASURED, 5);
}

/* Simple fractions in, every stage on: computed on x86-64, must come out on the Cortex-M3 too. */
static void test_bits_are_the_same_on_every_target(void) {
    law = (law_t){.kp_rad_s_m = 4.1f,
                  .kd_rad_s2_m = 0.3f,
                  .amplitude_max_rad = 0.7f,
                  .step_max_rad = 0.25f,
                  .beat_s = 0.9f,
                  .lead_beats = 2,
                  .q_len = 5};
    for (uint32_t k = 0; k < BEATS; k++) {
        u[k] = 0.02f * (float)(k * 7u % 41u);
        e[k] = 0.003f * (float)(k * 11u % 37u) - 0.05f;
        measured[k] = k % 9u != 4u;
    }
    TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
    uint32_t crc = crc32_update(0, u, BEATS * sizeof u[0]);
    crc = crc32_update(crc, &report.rms_error_m_s, sizeof report.rms_error_m_s);
    TEST_ASSERT_EQUAL_HEX32(0x0CEFF37Eu, crc);
}

static void test_bits_of_half_leads_and_faded_gains_too(void) {
    random_series();
    law = (law_t){.kp_rad_s_m = 4.1f,
                  .kd_rad_s2_m = 0.3f,
                  .amplitude_max_rad = 0.7f,
                  .beat_s = 0.9f,
                  .lead_beats = 2.5f,
                  .fade = 0.17f,
                  .fade_from = 3,
                  .q_len = 5};
    for (uint32_t k = 0; k < BEATS; k++) {
        measured[k] = k % 9u != 4u;
    }
    TEST_ASSERT_EQUAL(LAW_OK, update(BEATS));
    TEST_ASSERT_EQUAL_HEX32(0xC6E7816Cu, crc32_update(0, u, BEATS * sizeof u[0]));
}

static void test_bits_of_held_tails_and_weights_too(void) {
    float sum[BEATS] = {0};
    law = (law_t){.kp_rad_s_m = 4.1f,
                  .kd_rad_s2_m = 0.3f,
                  .amplitude_min_rad = -0.2f,
                  .amplitude_max_rad = 0.7f,
                  .beat_s = 0.9f,
                  .lead_beats = 3.5f,
                  .q_len = 4,
                  .tail = LAW_TAIL_HOLD_NEW};
    random_series();
    TEST_ASSERT_EQUAL(LAW_OK, add((law_weights_t){0.6f, 0.3f, 0.7f}, BEATS, sum));
    for (uint32_t k = 0; k < BEATS; k++) {
        u[k] = 0.02f * (float)(k * 13u % 43u) - 0.3f;
        measured[k] = k % 9u != 4u;
    }
    TEST_ASSERT_EQUAL(LAW_OK, add((law_weights_t){0.4f, 1.3f, 0.2f}, BEATS, sum));
    law_finish(&law, BEATS, sum, u);
    TEST_ASSERT_EQUAL_HEX32(0x3C9F5DE7u, crc32_update(0, u, BEATS * sizeof u[0]));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_thesis_law);
    RUN_TEST(test_the_old_input_is_saturated_before_the_correction);
    RUN_TEST(test_an_unreachable_target_does_not_wind_up);
    RUN_TEST(test_lead_and_tails);
    RUN_TEST(test_derivative_is_the_forward_difference);
    RUN_TEST(test_half_a_beat_on_is_the_mean_of_two_beats);
    RUN_TEST(test_half_a_beat_takes_the_neighbour_that_was_measured);
    RUN_TEST(test_half_leads_lie_between_the_whole_ones);
    RUN_TEST(test_what_a_trial_corrects);
    RUN_TEST(test_what_moves_an_amplitude_corrects_it);
    RUN_TEST(test_the_gain_of_a_beat_fades_with_its_visits);
    RUN_TEST(test_both_gains_fade);
    RUN_TEST(test_no_fade_changes_no_bit);
    RUN_TEST(test_one_beat_has_no_derivative);
    RUN_TEST(test_unmeasured_beats_count_as_no_error);
    RUN_TEST(test_a_difference_with_an_unmeasured_end_is_none);
    RUN_TEST(test_tails_that_hold_an_input);
    RUN_TEST(test_tails_are_held_ahead_of_the_filter);
    RUN_TEST(test_a_lead_that_leaves_nothing_to_hold_keeps);
    RUN_TEST(test_all_leads_and_tails_against_a_plain_reading);
    RUN_TEST(test_the_range_may_begin_below_zero);
    RUN_TEST(test_weighted_trials_add_up);
    RUN_TEST(test_the_old_tail_holds_what_was_last_swum);
    RUN_TEST(test_a_trial_without_speeds_adds_its_input);
    RUN_TEST(test_what_cannot_be_added_leaves_the_sum);
    RUN_TEST(test_one_whole_trial_added_and_finished_is_the_update);
    RUN_TEST(test_no_flags_means_all_measured);
    RUN_TEST(test_filter_goldens);
    RUN_TEST(test_filter_is_two_moving_means_away_from_the_ends);
    RUN_TEST(test_filter_mirrors_bit_for_bit);
    RUN_TEST(test_filter_length_one_changes_no_bit);
    RUN_TEST(test_the_filter_acts_on_the_corrected_input);
    RUN_TEST(test_steps_are_limited_after_the_filter);
    RUN_TEST(test_bad_configurations);
    RUN_TEST(test_lengths);
    RUN_TEST(test_one_bad_number_refuses_the_whole_trial);
    RUN_TEST(test_finite_numbers_that_would_overflow_are_refused);
    RUN_TEST(test_nothing_measured);
    RUN_TEST(test_bits_are_the_same_on_every_target);
    RUN_TEST(test_bits_of_half_leads_and_faded_gains_too);
    RUN_TEST(test_bits_of_held_tails_and_weights_too);
    return UNITY_END();
}
