/*
 * ERR_MAX_M_S: a trial that is stopped because a beat's speed was too far off, when that happens,
 * and that the law sees the beat that did it. The fish swims as fast as its tail beats, a beat
 * later than the amplitude says.
 */
#include "app_fixture.h"
#include "supervisor/stop_rules.h"

#include <stdio.h>

#define BEATS 12u
#define SPEED 0.05f
#define LIMIT 0.02f
#define SLOPE_M_S_RAD 0.1f /* of the fish: gain 4 corrects 0.4 of an error */
#define TRIALS_MAX 30u

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

static void set(uint16_t param, float value) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, param, value));
}

/* A camera whose last digits never stand still, as the firmware expects of one. */
static void run_at(float speed_m_s, uint32_t duration_ms) {
    for (uint32_t ms = 0; ms < duration_ms; ms += 10u) {
        swim_speed_m_s = speed_m_s + 1e-6f * (float)(hal.now_us / 10000u % 7u);
        run_ms(10);
    }
}

static void clear(void) { TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0)); }

/* What swims next stands on the board already, or is stored with the reference. */
static void start_next(void) {
    if (app.learner.reference.beats == 0) {
        TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
}

/* The sample of this moment is half a second old. */
static float speed_by_amplitude(void) {
    const int64_t since_us = (int64_t)(hal.now_us - app.trial.run.start_us) - 500000;
    if (app.trial.run.start_us == 0 || since_us < 0 || since_us >= (int64_t)BEATS * 1000000) {
        return 0.0f;
    }
    return SLOPE_M_S_RAD * app.trial.run.trial.amplitude_rad[since_us / 1000000];
}

/* Swims until the trial is stored, and is clear again. */
static void swim(void) {
    start_next();
    const uint64_t end_us = hal.now_us + (BEATS + 8u) * 1000000u;
    while (hal.now_us < end_us) {
        run_at(speed_by_amplitude(), 10);
    }
    if (app.supervisor.state == STATE_ABORTED) {
        clear();
    }
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

static void learn(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
}

/* Late by SPD_LATE_S and SPD_GAP_S, 2 s by default: two beats more are swum, and all of them count.
 */
static void test_the_tail_stops_once_the_beat_is_known(void) {
    set(PARAM_ERR_MAX_M_S, LIMIT);
    start_trial(BEATS, SPEED);
    run_at(SPEED, 4600);
    run_at(SPEED + 0.03f, 2300); /* seen from 4.1 s on: beat 4 is too fast */
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    run_at(SPEED + 0.03f, 300);
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, app.supervisor.reason);
    TEST_ASSERT_EQUAL(7, app.trial.executed);
    run_at(SPEED + 0.03f, 5000);
    TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[hal.pulse_count - 1u]);
    const trial_record_t *trial = &app.trial.run.trial;
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, trial->end);
    TEST_ASSERT_EQUAL(7, trial->executed);
    for (uint16_t k = 0; k < 7; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, k < 4 ? SPEED : SPEED + 0.03f, trial->speed_m_s[k]);
    }
}

static void test_the_first_guilty_beat_has_not_to_be_the_slow_one(void) {
    for (float off_m_s = -0.03f; off_m_s < 0.1f; off_m_s += 0.06f) {
        setUp();
        set(PARAM_ERR_MAX_M_S, LIMIT);
        swim_speed_m_s = SPEED + off_m_s;
        start_trial(BEATS, SPEED);
        run_ms(4000);
        TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, app.supervisor.reason);
    }
}

static void test_within_the_limit_or_without_one_it_swims_on(void) {
    static const float limits[] = {0.0f, 0.031f};
    for (uint32_t i = 0; i < 2; i++) {
        setUp();
        set(PARAM_ERR_MAX_M_S, limits[i]);
        swim_speed_m_s = SPEED + 0.03f;
        swim_whole_trial(BEATS, SPEED);
        TEST_ASSERT_EQUAL(FAULT_NONE, app.trial.run.trial.end);
    }
}

/* The beats of the end are known when the tail is off already. */
static void test_nothing_is_stopped_after_the_last_beat(void) {
    set(PARAM_ERR_MAX_M_S, LIMIT);
    start_trial(BEATS, SPEED);
    run_at(SPEED, (BEATS - 1u) * 1000u);
    run_at(SPEED + 0.03f, 1010); /* seen from half a second before beat 11 on */
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    run_at(SPEED + 0.03f, 50);
    TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
    run_at(SPEED + 0.03f, 5000);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.trial.run.trial.end);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, SPEED + 0.03f, app.trial.run.trial.speed_m_s[BEATS - 1u]);
}

static void test_a_beat_without_a_speed_is_not_too_far_off(void) {
    set(PARAM_ERR_MAX_M_S, LIMIT);
    camera_on = false;
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.trial.run.trial.end);
}

/* Speeds that come after the swim come too late to stop it. */
static void test_uploaded_speeds_stop_nothing(void) {
    set(PARAM_ERR_MAX_M_S, LIMIT);
    set(PARAM_SPD_SOURCE, 1.0f);
    swim_speed_m_s = 0.0f;
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.trial.run.trial.end);
}

/* What ended the swim first stays the reason. */
static void test_an_abort_before_it_keeps_its_reason(void) {
    set(PARAM_ERR_MAX_M_S, LIMIT);
    swim_speed_m_s = 0.0f;
    start_trial(BEATS, SPEED);
    run_ms(2500);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    run_ms(5000);
    TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, app.trial.run.trial.end);
    TEST_ASSERT_FLOAT_WITHIN(1e-5f, 0.0f, app.trial.run.trial.speed_m_s[1]);
}

static void test_the_trial_survives_a_restart_and_teaches(void) {
    set(PARAM_ERR_MAX_M_S, LIMIT);
    set(PARAM_ILC_LEAD, 0.0f);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    swim();
    const trial_record_t trial = app.trial.run.trial;
    const memory_t before = app.learner.memory;
    TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, trial.end);
    TEST_ASSERT_EQUAL(3, trial.executed);
    reboot();
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, app.trial.run.trial.end);
    TEST_ASSERT_EQUAL(trial.executed, app.trial.run.trial.executed);
    TEST_ASSERT_EQUAL_MEMORY(trial.speed_m_s, app.trial.run.trial.speed_m_s, BEATS * sizeof(float));
    learn();
    for (uint16_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_EQUAL(k < trial.executed, app.learner.memory.visits[k]);
        TEST_ASSERT_EQUAL(
            k<trial.executed, app.learner.memory.amplitude_rad[k]> before.amplitude_rad[k]);
    }
}

/* The first beat that was too far off. */
static uint16_t guilty(const trial_record_t *trial) {
    uint16_t k = 0;
    while (k < trial->executed &&
           !(fabsf(app.learner.reference.speed_m_s[k] - trial->speed_m_s[k]) > LIMIT)) {
        k++;
    }
    return k;
}

/* Speeds of the pending trial anew, without those from |beat| on. */
static void mask_from(uint16_t beat) {
    static speed_upload_t speeds;
    speeds.trial = app.trial.run.trial.number;
    speeds.beats = BEATS;
    for (uint16_t k = 0; k < BEATS; k++) {
        const bool kept = k < beat && k < app.trial.run.trial.executed;
        speeds.speed_m_s[k] = kept ? app.trial.run.trial.speed_m_s[k] : NAN;
        speeds.sigma_m_s[k] = kept ? app.trial.run.trial.sigma_m_s[k] : NAN;
    }
    const size_t length = record_encode_speeds(&speeds, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_SPEEDS, "/in/speeds.bin", upload_bytes, length));
}

/* A flat reference whose second half is too fast for the first guess: that would swim 0.4 of it. */
static void upload_rise(void) {
    static reference_t reference;
    reference.beats = BEATS;
    reference.beat_s = 1.0f;
    for (uint16_t k = 0; k < BEATS; k++) {
        reference.speed_m_s[k] = k < 4u ? 0.03f : 0.08f;
    }
    const size_t length = record_encode_reference(&reference, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_REFERENCE, "/in/reference.bin", upload_bytes, length));
}

/* Trials until one is whole, or TRIALS_MAX. */
static uint32_t trials_to_get_through(bool masked, uint16_t *last_guilty) {
    uint32_t trial = 0;
    bool whole = false;
    while (trial < TRIALS_MAX && !whole) {
        trial++;
        swim();
        whole = app.trial.run.trial.end == FAULT_NONE;
        if (!whole) {
            *last_guilty = guilty(&app.trial.run.trial);
            TEST_ASSERT_TRUE(*last_guilty < app.trial.run.trial.executed);
            TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, app.trial.run.trial.end);
        }
        if (masked && !whole) {
            mask_from(*last_guilty);
        }
        learn();
    }
    return trial;
}

static void prepare_series(void) {
    setUp();
    set(PARAM_ERR_MAX_M_S, LIMIT);
    set(PARAM_ILC_LEAD, 0.0f); /* this fish answers at once */
    set(PARAM_DU_MAX_RAD, 0.0f);
    set(PARAM_AMP_MAX_RAD, 1.0f);
    upload_rise();
}

static void test_with_the_guilty_beat_the_series_gets_through(void) {
    uint16_t last = 0;
    prepare_series();
    const uint32_t trials = trials_to_get_through(false, &last);
    printf("through after %u trials\n", (unsigned)trials);
    TEST_ASSERT_TRUE(trials > 2u && trials < 12u);
    TEST_ASSERT_EQUAL(BEATS, app.trial.run.trial.executed);
}

static void test_without_it_the_series_ends_there_for_ever(void) {
    uint16_t last = 0;
    prepare_series();
    TEST_ASSERT_EQUAL(TRIALS_MAX, trials_to_get_through(true, &last));
    TEST_ASSERT_EQUAL(4, last);
    TEST_ASSERT_EQUAL(FAULT_ERROR_LIMIT, app.trial.run.trial.end);
}

/* What each end of a swim leaves of its beats. */
static void test_which_beats_count_by_the_end_of_the_swim(void) {
    for (uint16_t row = 0; row < fault_count(); row++) {
        const fault_t end = (fault_t)fault_row(row)->number;
        TEST_ASSERT_EQUAL(end == FAULT_WALL ? 7 : 10, stop_rules_trusted_beats(end, 10, 3));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_tail_stops_once_the_beat_is_known);
    RUN_TEST(test_the_first_guilty_beat_has_not_to_be_the_slow_one);
    RUN_TEST(test_within_the_limit_or_without_one_it_swims_on);
    RUN_TEST(test_nothing_is_stopped_after_the_last_beat);
    RUN_TEST(test_a_beat_without_a_speed_is_not_too_far_off);
    RUN_TEST(test_uploaded_speeds_stop_nothing);
    RUN_TEST(test_an_abort_before_it_keeps_its_reason);
    RUN_TEST(test_the_trial_survives_a_restart_and_teaches);
    RUN_TEST(test_with_the_guilty_beat_the_series_gets_through);
    RUN_TEST(test_without_it_the_series_ends_there_for_ever);
    RUN_TEST(test_which_beats_count_by_the_end_of_the_swim);
    return UNITY_END();
}
