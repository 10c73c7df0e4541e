/* A trial cut because the fish came too close to a wall: its last beats teach nothing. */
#include "app_fixture.h"

#define BEATS 6u
#define SPEED 0.05f
#define SWUM 4u
#define UPLOADED 0.031f

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

static fault_t come_near_a_wall(void) {
    const link_command_t request = {
        .id = LINK_COMMAND_ABORT, .wall = true, .port = HAL_PORT_RADIO, .system = HOST_SYSTEM};
    return app.link.handlers.command(app.link.handlers.context, &request);
}

static void guard_beats(float beats) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_GUARD_BEATS, beats));
}

/* Swims SWUM beats and a half, and is clear again. */
static void cut_trial(void) {
    start_trial(BEATS, SPEED);
    run_ms(SWUM * 1000u + 500u);
    TEST_ASSERT_EQUAL(FAULT_NONE, come_near_a_wall());
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_WALL, app.supervisor.reason);
    run_ms(5000);
    TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[hal.pulse_count - 1u]);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
}

static void assert_measured(uint16_t measured, float speed_m_s) {
    const trial_record_t *trial = &app.trial.run.trial;
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(FAULT_WALL, trial->end);
    TEST_ASSERT_EQUAL(SWUM, trial->executed);
    for (uint16_t k = 0; k < BEATS; k++) {
        if (k < measured) {
            TEST_ASSERT_FLOAT_WITHIN(1e-5f, speed_m_s, trial->speed_m_s[k]);
            TEST_ASSERT_TRUE(trial->sigma_m_s[k] > 0.0f);
        } else {
            TEST_ASSERT_FLOAT_IS_NAN(trial->speed_m_s[k]);
            TEST_ASSERT_FLOAT_IS_NAN(trial->sigma_m_s[k]);
        }
    }
}

static void test_the_last_beat_is_unmeasured(void) {
    cut_trial();
    assert_measured(SWUM - 1u, swim_speed_m_s);
}

static void test_as_many_beats_as_wanted_are(void) {
    for (uint16_t beats = 0; beats <= 10; beats++) {
        setUp();
        guard_beats(beats);
        cut_trial();
        assert_measured(beats < SWUM ? (uint16_t)(SWUM - beats) : 0u, swim_speed_m_s);
    }
}

static void test_an_abort_by_command_takes_no_beat_away(void) {
    start_trial(BEATS, SPEED);
    run_ms(SWUM * 1000u + 500u);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    run_ms(5000);
    TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, app.trial.run.trial.end);
    for (uint16_t k = 0; k < SWUM; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, swim_speed_m_s, app.trial.run.trial.speed_m_s[k]);
    }
}

static void test_guarded_beats_learn_nothing(void) {
    cut_trial();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_LEAD, 0.0f));
    const memory_t before = app.learner.memory;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
    for (uint16_t k = 0; k < BEATS; k++) {
        const float change_rad = app.learner.memory.amplitude_rad[k] - before.amplitude_rad[k];
        if (k < SWUM - 1u) {
            TEST_ASSERT_FLOAT_WITHIN(2e-5f, 4.0f * (SPEED - swim_speed_m_s), change_rad);
        } else {
            TEST_ASSERT_TRUE(change_rad == 0.0f);
        }
    }
}

static void test_with_all_beats_guarded_there_is_nothing_to_learn(void) {
    guard_beats(10.0f);
    cut_trial();
    TEST_ASSERT_EQUAL(FAULT_NOTHING_MEASURED,
                      command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, app.trial.run.trial.number));
}

static void upload(void) {
    static speed_upload_t speeds;
    speeds.trial = app.trial.run.trial.number;
    speeds.beats = BEATS;
    for (uint16_t k = 0; k < BEATS; k++) {
        speeds.speed_m_s[k] = UPLOADED;
        speeds.sigma_m_s[k] = 0.001f;
    }
    const size_t length = record_encode_speeds(&speeds, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_SPEEDS, "/in/speeds.bin", upload_bytes, length));
}

/* The trial may have been swum before a reboot; somebody who has seen that they are sound lowers
 * GUARD_BEATS and uploads again. */
static void test_uploaded_speeds_leave_guarded_beats_unmeasured(void) {
    cut_trial();
    upload();
    assert_measured(SWUM - 1u, UPLOADED);
    reboot();
    assert_measured(SWUM - 1u, UPLOADED);
    upload();
    assert_measured(SWUM - 1u, UPLOADED);
    guard_beats(0.0f);
    upload();
    assert_measured(SWUM, UPLOADED);
}

static void test_an_armed_board_disarms(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, come_near_a_wall());
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.supervisor.reason);
}

/* The fish coasts on: what it has swum is measured. */
static void test_a_wall_after_the_last_beat_cuts_nothing(void) {
    start_trial(BEATS, SPEED);
    run_ms(BEATS * 1000u + 500u);
    TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, come_near_a_wall());
    TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
    run_ms(5000);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.trial.run.trial.end);
    for (uint16_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, swim_speed_m_s, app.trial.run.trial.speed_m_s[k]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_last_beat_is_unmeasured);
    RUN_TEST(test_as_many_beats_as_wanted_are);
    RUN_TEST(test_an_abort_by_command_takes_no_beat_away);
    RUN_TEST(test_guarded_beats_learn_nothing);
    RUN_TEST(test_with_all_beats_guarded_there_is_nothing_to_learn);
    RUN_TEST(test_uploaded_speeds_leave_guarded_beats_unmeasured);
    RUN_TEST(test_an_armed_board_disarms);
    RUN_TEST(test_a_wall_after_the_last_beat_cuts_nothing);
    return UNITY_END();
}
