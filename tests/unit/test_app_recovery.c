/* What the whole firmware does when things go wrong: failing flash, lost files, hasty hosts. */
#include "app_fixture.h"

#define BEATS 5u
#define SPEED 0.05f

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

static void arm(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
}

/* The command while flash fails after |writes| more writes. */
static fault_t command_with_failing_flash(link_command_id_t id, uint32_t trial, uint32_t writes) {
    hal.flash_fail_after = hal.flash_writes + writes;
    const fault_t fault = command(id, trial);
    hal.flash_fail_after = 0;
    return fault;
}

/* Every block that begins with |magic|. */
static void wipe_records(const char *magic) {
    for (uint32_t at = 0; at < sizeof hal.flash; at += BLOCK_BYTES) {
        if (memcmp(hal.flash + at, magic, 4) == 0) {
            memset(hal.flash + at, 0xFF, BLOCK_BYTES);
        }
    }
}

static void test_a_lost_reference_leaves_a_board_that_boots_and_remembers(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    const memory_t learned = app.learner.memory;
    TEST_ASSERT_EQUAL(STORE_OK, store_remove(&app.vault.store, "/reference.bin"));
    wipe_records("TBRF");
    reboot();
    TEST_ASSERT_EQUAL(FAULT_STORE_OLDER, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(FAULT_NO_REFERENCE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL_MEMORY(&learned, &app.learner.memory, sizeof learned);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED / 2));
    TEST_ASSERT_EQUAL(0, app.learner.memory.iteration);
}

static void test_a_start_that_failed_to_save_swims_the_first_guess_next_time(void) {
    arm();
    uint32_t refused = 0;
    while (refused < 40u && command_with_failing_flash(LINK_COMMAND_START, app.trial.next,
                                                       refused + 1u) != FAULT_NONE) {
        TEST_ASSERT_EQUAL(FAULT_STORAGE, app.supervisor.reason);
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
        refused++;
    }
    TEST_ASSERT_GREATER_THAN_UINT32(2, refused);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    TEST_ASSERT_EQUAL(1, app.trial.run.trial.iteration);
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * SPEED, app.trial.run.trial.amplitude_rad[1]);
}

static void test_a_trial_is_learned_from_once(void) {
    swim_whole_trial(BEATS, SPEED);
    uint32_t writes = 1;
    while (writes < 40u &&
           command_with_failing_flash(LINK_COMMAND_LEARN, 1, writes) != FAULT_NONE) {
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
        TEST_ASSERT_TRUE(app.trial.run.pending);
        writes++;
    }
    TEST_ASSERT_GREATER_THAN_UINT32(1, writes);
    TEST_ASSERT_FALSE(app.trial.run.pending);
    const memory_t learned = app.learner.memory;
    TEST_ASSERT_EQUAL(2, learned.iteration);
    reboot(); /* its file is still there */
    TEST_ASSERT_FALSE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL_MEMORY(&learned, &app.learner.memory, sizeof learned);
}

static void test_a_trial_begun_right_after_an_abort_begins_at_its_first_beat(void) {
    start_trial(BEATS, SPEED);
    run_ms(400);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    run_ms(10);
    TEST_ASSERT_EQUAL_UINT64(0, app.trial.run.start_us);
    run_ms(600);
    TEST_ASSERT_GREATER_THAN_UINT64(900000u, app.trial.run.start_us);
    run_ms(BEATS * 1000u);
    TEST_ASSERT_EQUAL(STATE_SETTLING, app.supervisor.state);
    TEST_ASSERT_EQUAL(BEATS, app.trial.executed);
}

static void test_an_abort_disarms(void) {
    arm();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_START, app.trial.next));
}

static void test_a_host_that_goes_silent_disarms(void) {
    arm();
    host_alive = false;
    run_ms(4900);
    TEST_ASSERT_EQUAL(STATE_ARMED, app.supervisor.state);
    run_ms(300);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, app.supervisor.reason);
}

static void test_an_unattended_board_stays_armed(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_LINK_TIMEOUT_S, 0.0f));
    arm();
    host_alive = false;
    run_ms(20000);
    TEST_ASSERT_EQUAL(STATE_ARMED, app.supervisor.state);
}

static void test_a_start_from_an_earlier_boot_is_stale(void) {
    arm();
    const link_command_t request = {.id = LINK_COMMAND_START,
                                    .trial = app.trial.next,
                                    .issued_s = 500.0f,
                                    .port = HAL_PORT_RADIO,
                                    .system = HOST_SYSTEM};
    TEST_ASSERT_EQUAL(FAULT_STALE_COMMAND, commands_run(&app, &request));
    TEST_ASSERT_EQUAL(STATE_ARMED, app.supervisor.state);
}

/* The pending trial has these beats, and they are what is learned from. */
static void learn_from_beats(uint16_t executed) {
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(executed, app.trial.run.trial.executed);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_LEAD, 0.0f));
    const memory_t before = app.learner.memory;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
    for (uint16_t k = 0; k < BEATS; k++) {
        const bool changed = app.learner.memory.amplitude_rad[k] != before.amplitude_rad[k];
        TEST_ASSERT_EQUAL(k < executed, changed);
        TEST_ASSERT_EQUAL(k < executed, app.learner.memory.visits[k]);
    }
}

static void test_a_reboot_after_an_abort_keeps_the_trial(void) {
    start_trial(BEATS, SPEED);
    run_ms(3250);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_REBOOT, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_REBOOT, 0));
    run_ms(300);
    reboot();
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(3, app.trial.run.trial.executed);
    learn_from_beats(3);
}

/* The last voltage it has is enough to swim with: every beat counts. */
static void test_an_empty_battery_takes_no_beat_away(void) {
    start_trial(BEATS, SPEED);
    run_ms(2600);
    hal.battery_mv = 5000;
    run_ms(1100); /* BATT_SAG_S and a frame */
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_BATTERY_CRITICAL, app.supervisor.reason);
    run_ms(5000);
    reboot(); /* or it is changed */
    TEST_ASSERT_EQUAL(FAULT_BATTERY_CRITICAL, app.trial.run.trial.end);
    learn_from_beats(3);
}

/* Nothing of it was ever pending: what was learned stands, and the number is used up. */
static void test_power_lost_in_mid_swim_teaches_nothing(void) {
    start_trial(BEATS, SPEED);
    const uint32_t number = app.trial.run.trial.number;
    run_ms(3250);
    const memory_t before = app.learner.memory;
    reboot();
    TEST_ASSERT_FALSE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(FAULT_NO_TRIAL, command(LINK_COMMAND_LEARN, number));
    TEST_ASSERT_EQUAL_MEMORY(&before, &app.learner.memory, sizeof before);
    TEST_ASSERT_EQUAL_UINT32(number + 1u, app.trial.next);
}

static void test_a_board_about_to_reboot_does_not_arm(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_REBOOT, 0));
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_ARM, 0));
}

static void test_an_aborted_trial_without_speeds_is_not_learned_from(void) {
    camera_on = false;
    start_trial(BEATS, SPEED);
    run_ms(3250);
    (void)command(LINK_COMMAND_ABORT, 0);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    const memory_t before = app.learner.memory;
    TEST_ASSERT_EQUAL(FAULT_NOTHING_MEASURED, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL_MEMORY(&before, &app.learner.memory, sizeof before);
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

static void test_an_endless_beat_is_refused(void) {
    static reference_t reference = {.beats = 1, .beat_s = 1e30f};
    const size_t length = record_encode_reference(&reference, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_BAD_DATA,
                      commit(VAULT_UPLOAD_REFERENCE, "/in/reference.bin", upload_bytes, length));
}

static void store_params_and_reboot(void) {
    const size_t length = record_encode_params(&app.params, app.vault.record);
    TEST_ASSERT_EQUAL(STORE_OK,
                      store_replace(&app.vault.store, PARAMS_PATH, app.vault.record, length));
    reboot();
}

static void test_the_imu_is_set_up_as_the_stored_parameters_say(void) {
    app.params.value[PARAM_IMU_RATE_HZ] = 50.0f;
    app.params.value[PARAM_IMU_MOUNT] = 3.0f;
    store_params_and_reboot();
    TEST_ASSERT_EQUAL_UINT16(50, app.sensor.imu.driver.config.rate_hz);
    TEST_ASSERT_EQUAL(3, app.sensor.imu.driver.config.mount);
}

static bool sets_the_imu_up(param_t param) {
    return param >= PARAM_IMU_BAUD && param <= PARAM_IMU_MOUNT;
}

/* 400 frames a second do not fit 9600 baud: each of the IMU's parameters is as it is by itself. */
static void test_imu_parameters_that_contradict_each_other_are_all_dropped(void) {
    for (param_t param = 0; param < PARAM_COUNT; param++) {
        if (sets_the_imu_up(param)) {
            app.params.value[param] = param_info(param)->high;
        }
    }
    app.params.value[PARAM_IMU_BAUD] = 9600.0f;
    app.params.value[PARAM_AMP_MAX_RAD] = 0.3f;
    store_params_and_reboot();
    for (param_t param = 0; param < PARAM_COUNT; param++) {
        if (sets_the_imu_up(param)) {
            TEST_ASSERT_EQUAL_FLOAT(param_info(param)->fallback, app.params.value[param]);
        }
    }
    TEST_ASSERT_EQUAL_FLOAT(0.3f, app.params.value[PARAM_AMP_MAX_RAD]);
    TEST_ASSERT_EQUAL(0, app.sensor.imu.driver.config.mount);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_lost_reference_leaves_a_board_that_boots_and_remembers);
    RUN_TEST(test_a_start_that_failed_to_save_swims_the_first_guess_next_time);
    RUN_TEST(test_a_trial_is_learned_from_once);
    RUN_TEST(test_a_trial_begun_right_after_an_abort_begins_at_its_first_beat);
    RUN_TEST(test_an_abort_disarms);
    RUN_TEST(test_a_host_that_goes_silent_disarms);
    RUN_TEST(test_an_unattended_board_stays_armed);
    RUN_TEST(test_a_start_from_an_earlier_boot_is_stale);
    RUN_TEST(test_a_reboot_after_an_abort_keeps_the_trial);
    RUN_TEST(test_an_empty_battery_takes_no_beat_away);
    RUN_TEST(test_power_lost_in_mid_swim_teaches_nothing);
    RUN_TEST(test_a_board_about_to_reboot_does_not_arm);
    RUN_TEST(test_an_aborted_trial_without_speeds_is_not_learned_from);
    RUN_TEST(test_an_endless_beat_is_refused);
    RUN_TEST(test_the_imu_is_set_up_as_the_stored_parameters_say);
    RUN_TEST(test_imu_parameters_that_contradict_each_other_are_all_dropped);
    return UNITY_END();
}
