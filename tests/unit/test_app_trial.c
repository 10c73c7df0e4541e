/* Trials on the mocked board: from arming to the learned input, and every way to be cut short. */
#include "app_fixture.h"
#include "blink/blink.h"

#define BEATS 5u
#define SPEED 0.05f

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

static uint16_t last_pulse(void) { return hal.pulses[hal.pulse_count - 1u]; }

static void test_boots_idle_with_the_tail_off(void) {
    run_ms(1000);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    for (size_t i = 0; i < hal.pulse_count; i++) {
        TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[i]);
    }
}

static void test_arming_needs_a_reference(void) {
    TEST_ASSERT_EQUAL(FAULT_NO_REFERENCE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_arming_moves_nothing(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    hal.pulse_count = 0;
    run_ms(2000);
    for (size_t i = 0; i < hal.pulse_count; i++) {
        TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[i]);
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISARM, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_a_trial_swims_every_beat_and_becomes_pending(void) {
    start_trial(BEATS, SPEED);
    hal.pulse_count = 0;
    run_ms(BEATS * 1000u + 20u);
    size_t moved = 0;
    for (size_t i = 0; i < hal.pulse_count; i++) {
        moved += hal.pulses[i] != 0 && hal.pulses[i] != 4500u;
    }
    /* Two of the 50 frames of a beat are at the centre: the start and the middle. */
    TEST_ASSERT_EQUAL(BEATS * 48u, moved);
    TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
    run_ms(5000);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT16(0, last_pulse());
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(BEATS, app.trial.run.trial.executed);
    for (uint16_t k = 0; k < BEATS; k++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-5f, swim_speed_m_s, app.trial.run.trial.speed_m_s[k]);
    }
}

static void test_learning_adds_gain_times_error(void) {
    swim_whole_trial(BEATS, SPEED);
    const float gain = app.params.value[PARAM_ILC_GAIN];
    const float first_rad = gain * SPEED;
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, first_rad, app.learner.memory.amplitude_rad[2]);
    const uint32_t trial = app.trial.run.trial.number;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, first_rad + gain * (SPEED - swim_speed_m_s),
                             app.learner.memory.amplitude_rad[2]);
    TEST_ASSERT_EQUAL(2, app.learner.memory.iteration);
    TEST_ASSERT_FALSE(app.trial.run.pending);
}

static void test_a_repeated_learn_does_nothing(void) {
    swim_whole_trial(BEATS, SPEED);
    const uint32_t trial = app.trial.run.trial.number;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial));
    const memory_t learned = app.learner.memory;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial));
    TEST_ASSERT_EQUAL_MEMORY(&learned, &app.learner.memory, sizeof learned);
    TEST_ASSERT_EQUAL(FAULT_NO_TRIAL, command(LINK_COMMAND_LEARN, trial + 1u));
    TEST_ASSERT_EQUAL(FAULT_NO_TRIAL, command(LINK_COMMAND_LEARN, 0));
}

static void test_a_repeated_start_does_nothing_and_another_is_refused(void) {
    start_trial(BEATS, SPEED);
    const uint32_t trial = app.trial.run.trial.number;
    run_ms(1500);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, trial));
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_START, trial + 1u));
    TEST_ASSERT_EQUAL(1, app.trial.executed);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
}

static void test_a_start_must_be_fresh_and_for_the_next_trial(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    run_ms(5000);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_START, app.trial.next));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_TRIAL_NUMBER, command(LINK_COMMAND_START, app.trial.next + 1u));
    link_command_t request = {.id = LINK_COMMAND_START,
                              .trial = app.trial.next,
                              .issued_s = 2.9f,
                              .port = HAL_PORT_RADIO,
                              .system = HOST_SYSTEM};
    TEST_ASSERT_EQUAL(FAULT_STALE_COMMAND, commands_run(&app, &request));
    request.issued_s = NAN;
    TEST_ASSERT_EQUAL(FAULT_STALE_COMMAND, commands_run(&app, &request));
    request.issued_s = 3.1f;
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_run(&app, &request));
}

/* Between two ticks nobody touches it: what the test writes there stays. */
static void pass_without_tick(void) {
    const bool shown = hal.led;
    TEST_ASSERT_TRUE(hal.now_us % 20000u == 0);
    hal.led = !shown;
    run_ms(10);
    TEST_ASSERT_EQUAL(!shown, hal.led);
    hal.led = shown;
}

static void test_the_led_shows_the_trial_from_its_start_on(void) {
    run_ms(20);
    TEST_ASSERT_FALSE(hal.led);
    start_trial(BEATS, SPEED);
    const uint32_t trial = app.trial.run.trial.number;
    uint32_t dark_frames = 0;
    for (uint32_t i = 0; i < BEATS * 50u + 300u; i++) {
        pass_without_tick();
        run_ms(10);
        const uint64_t start_us = app.trial.run.start_us;
        if (start_us == 0 || hal.now_us < start_us) {
            TEST_ASSERT_EQUAL(app.supervisor.state == STATE_RUNNING, hal.led);
            continue;
        }
        const uint32_t frame = (uint32_t)((hal.now_us - start_us) / 20000u);
        TEST_ASSERT_EQUAL(frame < BEATS * 50u && blink_on(frame, trial), hal.led);
        dark_frames += frame >= BEATS * 50u;
    }
    TEST_ASSERT_TRUE(dark_frames > 200);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_an_abort_coasts_to_the_centre_and_stays_stopped(void) {
    start_trial(BEATS, SPEED);
    run_ms(2250);
    hal.pulse_count = 0;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    run_ms(700);
    TEST_ASSERT_EQUAL_UINT16(0, last_pulse());
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.supervisor.reason);
}

static void test_disarming_is_never_refused(void) {
    start_trial(BEATS, SPEED);
    run_ms(1500);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISARM, 0));
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISARM, 0));
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
}

static void test_an_aborted_trial_is_learned_from_as_far_as_it_swam(void) {
    start_trial(BEATS, SPEED);
    run_ms(2250);
    (void)command(LINK_COMMAND_ABORT, 0);
    run_ms(5000);
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(2, app.trial.run.trial.executed);
    TEST_ASSERT_EQUAL(FAULT_ABORT_COMMAND, app.trial.run.trial.end);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_LEAD, 0.0f));
    const float before_rad = app.learner.memory.amplitude_rad[3];
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * SPEED + 4.0f * (SPEED - swim_speed_m_s),
                             app.learner.memory.amplitude_rad[1]);
    TEST_ASSERT_EQUAL_FLOAT(before_rad, app.learner.memory.amplitude_rad[3]);
    TEST_ASSERT_EQUAL(0, app.learner.memory.best_iteration);
}

static void test_an_abort_before_the_first_beat_leaves_nothing_to_learn(void) {
    start_trial(BEATS, SPEED);
    const uint32_t trial = app.trial.run.trial.number;
    run_ms(400);
    (void)command(LINK_COMMAND_ABORT, 0);
    run_ms(5000);
    (void)command(LINK_COMMAND_CLEAR, 0);
    TEST_ASSERT_FALSE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(FAULT_NO_TRIAL, command(LINK_COMMAND_LEARN, trial));
    TEST_ASSERT_EQUAL(trial + 1u, app.trial.next);
}

static void test_a_trial_without_speeds_is_not_learned_from(void) {
    camera_on = false;
    swim_whole_trial(BEATS, SPEED);
    const memory_t before = app.learner.memory;
    TEST_ASSERT_EQUAL(FAULT_NOTHING_MEASURED, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
    TEST_ASSERT_EQUAL_MEMORY(&before, &app.learner.memory, sizeof before);
    TEST_ASSERT_EQUAL(FAULT_TRIAL_PENDING, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, app.trial.run.trial.number));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
}

static void test_a_silent_host_stops_the_tail_and_the_trial_stays(void) {
    start_trial(12, SPEED / 2);
    run_ms(3000);
    host_alive = false;
    run_ms(4900);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    run_ms(600);
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_LINK_LOST, app.supervisor.reason);
    run_ms(600);
    TEST_ASSERT_EQUAL_UINT16(0, last_pulse());
    host_alive = true;
    run_ms(5000);
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

static void test_another_host_does_not_keep_the_tail_going(void) {
    start_trial(12, SPEED / 2);
    host_alive = false;
    for (int i = 0; i < 12; i++) {
        app.link.handlers.heartbeat(&app, HAL_PORT_RADIO, HOST_SYSTEM - 1u, 190);
        app.link.handlers.heartbeat(&app, HAL_PORT_CONSOLE, HOST_SYSTEM, 190);
        run_ms(500);
    }
    TEST_ASSERT_EQUAL(FAULT_LINK_LOST, app.supervisor.reason);
}

static void test_an_unattended_trial_swims_to_its_end(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_LINK_TIMEOUT_S, 0.0f));
    host_alive = false;
    swim_whole_trial(12, SPEED / 2);
    TEST_ASSERT_EQUAL(12, app.trial.run.trial.executed);
}

static void test_a_low_battery_does_not_arm_and_a_critical_one_stops(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    hal.battery_mv = 6500;
    TEST_ASSERT_EQUAL(FAULT_BATTERY_LOW, command(LINK_COMMAND_ARM, 0));
    hal.battery_mv = 8000;
    start_trial(BEATS, SPEED);
    run_ms(1500);
    hal.battery_mv = 5900;
    run_ms(960);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    run_ms(80);
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_BATTERY_CRITICAL, app.supervisor.reason);
}

static void test_a_reading_at_the_limit_warns_does_not_arm_and_stops(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    hal.battery_mv = 12000;
    run_ms(1000);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_TRUE(app.loop.status.battery.at_limit);
    TEST_ASSERT_TRUE(app.trial.battery.limit_told);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    TEST_ASSERT_EQUAL(FAULT_BATTERY_SENSE, command(LINK_COMMAND_ARM, 0));
    hal.battery_mv = 8000;
    start_trial(BEATS, SPEED);
    run_ms(1500);
    hal.battery_mv = 12000;
    run_ms(960);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    run_ms(80);
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_BATTERY_SENSE, app.supervisor.reason);
}

/* As docs/how-to/wiring.md says: a board on USB power, with whatever its open pin reads. */
static void test_a_bare_board_runs_with_the_documented_values(void) {
    static const uint16_t open_pin_mv[] = {0, 4000, 12000};
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_BATT_LOW_V, 0.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_BATT_CRIT_V, 0.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, 1));
    for (uint32_t i = 0; i < sizeof open_pin_mv / sizeof open_pin_mv[0]; i++) {
        hal.battery_mv = open_pin_mv[i];
        run_ms(1500);
        TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    }
    TEST_ASSERT_FALSE(app.trial.battery.limit_told);
}

static void test_the_divider_is_a_parameter(void) {
    hal.battery_mv = 8000;
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_BATT_DIVIDER, 3.3f));
    run_ms(20);
    TEST_ASSERT_EQUAL(8800, app.loop.status.battery.mv);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_BATT_ADC_V, 3.0f));
    run_ms(20);
    TEST_ASSERT_EQUAL(8000, app.loop.status.battery.mv);
}

static void test_a_second_trial_of_the_same_board_starts_afresh(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(2, app.trial.run.trial.number);
    TEST_ASSERT_EQUAL(2, app.trial.run.trial.iteration);
    TEST_ASSERT_EQUAL(BEATS, app.trial.run.trial.executed);
}

/* They would lie in open slots; nobody measures the time to come. */
static void test_speeds_of_a_time_to_come_are_dropped(void) {
    start_trial(BEATS, SPEED);
    run_ms(3000);
    const uint32_t early = app.trial.run.speed.counters.early;
    const uint32_t accepted = app.trial.run.speed.counters.accepted;
    link_vision_t sample = {.speed_m_s = 0.3f, .sigma_m_s = 0.001f};
    sample.time_us = hal.now_us + 1000000u;
    app.link.handlers.vision(app.link.handlers.context, &sample);
    sample.time_us = hal.now_us + 4000000u;
    app.link.handlers.vision(app.link.handlers.context, &sample);
    TEST_ASSERT_EQUAL_UINT32(early + 2u, app.trial.run.speed.counters.early);
    sample.time_us = hal.now_us + 300000u; /* a clock that is a little ahead */
    app.link.handlers.vision(app.link.handlers.context, &sample);
    TEST_ASSERT_EQUAL_UINT32(accepted + 1u, app.trial.run.speed.counters.accepted);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_boots_idle_with_the_tail_off);
    RUN_TEST(test_arming_needs_a_reference);
    RUN_TEST(test_arming_moves_nothing);
    RUN_TEST(test_a_trial_swims_every_beat_and_becomes_pending);
    RUN_TEST(test_learning_adds_gain_times_error);
    RUN_TEST(test_a_repeated_learn_does_nothing);
    RUN_TEST(test_a_repeated_start_does_nothing_and_another_is_refused);
    RUN_TEST(test_a_start_must_be_fresh_and_for_the_next_trial);
    RUN_TEST(test_the_led_shows_the_trial_from_its_start_on);
    RUN_TEST(test_an_abort_coasts_to_the_centre_and_stays_stopped);
    RUN_TEST(test_disarming_is_never_refused);
    RUN_TEST(test_an_aborted_trial_is_learned_from_as_far_as_it_swam);
    RUN_TEST(test_an_abort_before_the_first_beat_leaves_nothing_to_learn);
    RUN_TEST(test_a_trial_without_speeds_is_not_learned_from);
    RUN_TEST(test_a_silent_host_stops_the_tail_and_the_trial_stays);
    RUN_TEST(test_another_host_does_not_keep_the_tail_going);
    RUN_TEST(test_an_unattended_trial_swims_to_its_end);
    RUN_TEST(test_a_low_battery_does_not_arm_and_a_critical_one_stops);
    RUN_TEST(test_a_reading_at_the_limit_warns_does_not_arm_and_stops);
    RUN_TEST(test_a_bare_board_runs_with_the_documented_values);
    RUN_TEST(test_the_divider_is_a_parameter);
    RUN_TEST(test_a_second_trial_of_the_same_board_starts_afresh);
    RUN_TEST(test_speeds_of_a_time_to_come_are_dropped);
    return UNITY_END();
}
