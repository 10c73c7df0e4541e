/* What the firmware keeps: uploads and their refusals, parameters, reboots, failing flash. */
#include "app_fixture.h"
#include "store/bytes.h"

#define BEATS 5u
#define SPEED 0.05f

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

/* Commits the reference in upload_bytes and checks that a refusal changes nothing. */
static void expect_reference_refused(fault_t expected, size_t length) {
    const uint32_t crc = app.learner.reference.crc;
    const memory_t memory = app.learner.memory;
    TEST_ASSERT_EQUAL(expected,
                      commit(VAULT_UPLOAD_REFERENCE, "/in/reference.bin", upload_bytes, length));
    TEST_ASSERT_EQUAL_HEX32(crc, app.learner.reference.crc);
    TEST_ASSERT_EQUAL_MEMORY(&memory, &app.learner.memory, sizeof memory);
}

static size_t encode_with(uint16_t beat, float speed_m_s) {
    static reference_t reference;
    reference.beats = BEATS;
    reference.beat_s = 1.0f;
    for (uint16_t k = 0; k < BEATS; k++) {
        reference.speed_m_s[k] = k == beat ? speed_m_s : SPEED;
    }
    return record_encode_reference(&reference, upload_bytes);
}

static void test_a_good_reference_is_taken_over_and_survives_a_reboot(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(BEATS, app.learner.reference.beats);
    const uint32_t crc = app.learner.reference.crc;
    TEST_ASSERT_NOT_EQUAL_UINT32(0, crc);
    reboot();
    TEST_ASSERT_EQUAL_HEX32(crc, app.learner.reference.crc);
    TEST_ASSERT_EQUAL_FLOAT(SPEED, app.learner.reference.speed_m_s[4]);
    TEST_ASSERT_EQUAL_HEX32(crc, app.learner.memory.reference_crc);
}

static void test_bad_references_are_refused_and_change_nothing(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    expect_reference_refused(FAULT_BAD_DATA, encode_with(2, NAN));
    expect_reference_refused(FAULT_BAD_DATA, encode_with(0, INFINITY));
    expect_reference_refused(FAULT_BAD_DATA, encode_with(4, -0.001f));
    expect_reference_refused(FAULT_TOO_FAST, encode_with(1, 0.31f));
    expect_reference_refused(FAULT_TOO_FAR, encode_flat_reference(60, SPEED));
    expect_reference_refused(FAULT_BAD_FORMAT, encode_with(1, SPEED * 2) - 4u);
    const size_t length = encode_with(1, SPEED * 2);
    upload_bytes[length - 1u] ^= 0x40u;
    expect_reference_refused(FAULT_BAD_FORMAT, length);
}

static void test_a_reference_off_the_servo_grid_is_refused(void) {
    static reference_t reference = {.beats = 1, .beat_s = 1.0f, .speed_m_s = {SPEED}};
    reference.beat_s = 0.99f;
    expect_reference_refused(FAULT_BAD_DATA, record_encode_reference(&reference, upload_bytes));
}

static void test_a_commit_must_name_the_file_that_is_there(void) {
    const size_t length = encode_flat_reference(BEATS, SPEED);
    (void)store_replace(&app.vault.store, "/in/reference.bin", upload_bytes, length);
    link_command_t request = {.id = LINK_COMMAND_COMMIT,
                              .file = VAULT_UPLOAD_REFERENCE,
                              .length_bytes = (uint32_t)length,
                              .crc = crc32_update(0, upload_bytes, length) ^ 1u};
    TEST_ASSERT_EQUAL(FAULT_BAD_FILE, commands_run(&app, &request));
    request.crc ^= 1u;
    request.length_bytes--;
    TEST_ASSERT_EQUAL(FAULT_BAD_FILE, commands_run(&app, &request));
    request.length_bytes++;
    request.file = VAULT_UPLOAD_SPEEDS;
    TEST_ASSERT_EQUAL(FAULT_BAD_FILE, commands_run(&app, &request));
    request.file = VAULT_UPLOAD_REFERENCE;
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_run(&app, &request));
}

static void test_the_same_reference_again_keeps_what_was_learned(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(2, app.learner.memory.iteration);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED * 0.9f));
    TEST_ASSERT_EQUAL(0, app.learner.memory.iteration);
    TEST_ASSERT_EQUAL(1, app.learner.memory.last_trial);
}

static void test_a_pending_trial_survives_a_reboot(void) {
    swim_whole_trial(BEATS, SPEED);
    const memory_t memory = app.learner.memory;
    reboot();
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(1, app.trial.run.trial.number);
    TEST_ASSERT_EQUAL(2, app.trial.next);
    TEST_ASSERT_EQUAL_MEMORY(memory.amplitude_rad, app.learner.memory.amplitude_rad, BEATS * 4u);
    TEST_ASSERT_EQUAL(FAULT_TRIAL_PENDING, upload_flat_reference(BEATS, SPEED / 2));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    const memory_t learned = app.learner.memory;
    reboot();
    TEST_ASSERT_FALSE(app.trial.run.pending);
    TEST_ASSERT_EQUAL_MEMORY(&learned, &app.learner.memory, sizeof learned);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
}

static void test_the_trial_number_never_comes_twice(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, 1));
    TEST_ASSERT_EQUAL(STORE_OK, store_remove(&app.vault.store, "/trials/0001.ulg"));
    reboot();
    TEST_ASSERT_EQUAL(2, app.trial.next);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED * 0.9f));
    TEST_ASSERT_EQUAL(2, app.trial.next);
}

static size_t encode_speeds(uint32_t trial, uint16_t beats, float speed_m_s) {
    static speed_upload_t speeds;
    speeds.trial = trial;
    speeds.beats = beats;
    for (uint16_t k = 0; k < beats; k++) {
        speeds.speed_m_s[k] = speed_m_s;
        speeds.sigma_m_s[k] = 0.001f;
    }
    return record_encode_speeds(&speeds, upload_bytes);
}

static fault_t upload_speeds(uint32_t trial, uint16_t beats, float speed_m_s) {
    const size_t length = encode_speeds(trial, beats, speed_m_s);
    return commit(VAULT_UPLOAD_SPEEDS, "/in/speeds.bin", upload_bytes, length);
}

static void test_speeds_uploaded_after_the_swim_are_learned_from(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_SPD_SOURCE, 1.0f));
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NOTHING_MEASURED, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL(FAULT_NO_TRIAL, upload_speeds(2, BEATS, 0.03f));
    TEST_ASSERT_EQUAL(FAULT_WRONG_BEATS, upload_speeds(1, BEATS - 1u, 0.03f));
    TEST_ASSERT_EQUAL(FAULT_BAD_DATA, upload_speeds(1, BEATS, 1.5f));
    uint32_t before_bytes = 0, after_bytes = 0;
    (void)store_size(&app.vault.store, "/trials/0001.ulg", &before_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_speeds(1, BEATS, 0.03f));
    (void)store_size(&app.vault.store, "/trials/0001.ulg", &after_bytes);
    TEST_ASSERT_GREATER_THAN_UINT32(before_bytes, after_bytes);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * SPEED + 4.0f * (SPEED - 0.03f),
                             app.learner.memory.amplitude_rad[3]);
}

static void test_uploaded_amplitudes_swim_next_and_stay_at_arming(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    static amplitudes_upload_t upload;
    upload.reference_crc = app.learner.reference.crc;
    upload.beats = BEATS;
    for (uint16_t k = 0; k < BEATS; k++) {
        upload.amplitude_rad[k] = 0.1f * (float)k;
    }
    size_t length = record_encode_amplitudes(&upload, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_AMPLITUDES, "/in/amplitudes.bin", upload_bytes, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL_FLOAT(0.3f, app.learner.memory.amplitude_rad[3]);
    TEST_ASSERT_EQUAL(MEMORY_INPUT_UPLOADED, app.learner.memory.input);
    (void)command(LINK_COMMAND_DISARM, 0);
    upload.reference_crc ^= 1u;
    length = record_encode_amplitudes(&upload, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_WRONG_BEATS,
                      commit(VAULT_UPLOAD_AMPLITUDES, "/in/amplitudes.bin", upload_bytes, length));
}

static void test_what_was_learned_comes_back_from_a_backup(void) {
    static uint8_t backup[RECORD_TRIAL_MAX_BYTES];
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    const size_t length = record_encode_memory(&app.learner.memory, backup);
    memset(hal.flash, 0xFF, sizeof hal.flash); /* erased with the chip */
    reboot();
    TEST_ASSERT_EQUAL(1, app.trial.next);
    TEST_ASSERT_EQUAL(FAULT_WRONG_BEATS,
                      commit(VAULT_UPLOAD_LEARNED, "/in/learned.bin", backup, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, commit(VAULT_UPLOAD_LEARNED, "/in/learned.bin", backup, length));
    TEST_ASSERT_EQUAL(2, app.trial.next);
    reboot();
    TEST_ASSERT_EQUAL(2, app.trial.next);
    TEST_ASSERT_EQUAL(length, record_encode_memory(&app.learner.memory, upload_bytes));
    TEST_ASSERT_EQUAL_MEMORY(backup, upload_bytes, length);
    backup[length - 1u] ^= 1u;
    TEST_ASSERT_EQUAL(FAULT_BAD_FORMAT,
                      commit(VAULT_UPLOAD_LEARNED, "/in/learned.bin", backup, length));
}

/* What another firmware stored: the record ends before the visits. */
static void test_what_an_older_firmware_learned_stays(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL(1, app.learner.memory.visits[BEATS - 1u]);
    const memory_t learned = app.learner.memory;
    app.learner.memory.peaks.count = 0;
    const size_t length = record_encode_memory(&app.learner.memory, upload_bytes) - BEATS;
    (void)bytes_put_u16(upload_bytes + 4, 1);
    const uint32_t front = crc32_update(0, upload_bytes, 8);
    (void)bytes_put_u32(upload_bytes + 8, crc32_update(front, upload_bytes + 12, length - 12u));
    TEST_ASSERT_EQUAL(STORE_OK,
                      store_replace(&app.vault.store, "/learned.bin", upload_bytes, length));
    reboot();
    TEST_ASSERT_EQUAL(2, app.learner.memory.iteration);
    TEST_ASSERT_EQUAL(0, app.learner.memory.visits[BEATS - 1u]);
    TEST_ASSERT_EQUAL_MEMORY(learned.amplitude_rad, app.learner.memory.amplitude_rad, BEATS * 4u);
    TEST_ASSERT_EQUAL_MEMORY(learned.best_rad, app.learner.memory.best_rad, BEATS * 4u);
}

static void test_the_first_input_follows_the_gain_of_the_moment(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 4.0f * SPEED, app.learner.memory.amplitude_rad[0]);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, commands_param_set(&app, PARAM_ILC_GAIN, 5.0f));
    (void)command(LINK_COMMAND_DISARM, 0);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 5.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 5.0f * SPEED, app.learner.memory.amplitude_rad[0]);
}

static void test_the_first_input_follows_the_gain_across_a_reboot(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, 1));
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 5.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_FLOAT_WITHIN(1e-6f, 5.0f * SPEED, app.learner.memory.amplitude_rad[0]);
}

static void test_arming_checks_the_reference_against_the_limits_of_the_moment(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_REF_MAX_M_S, SPEED * 0.9f));
    TEST_ASSERT_EQUAL(FAULT_TOO_FAST, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_REF_MAX_M_S, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_TANK_LEN_M, 0.5f));
    TEST_ASSERT_EQUAL(FAULT_TOO_FAR, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_failing_flash_refuses_uploaded_speeds_and_keeps_the_measured_ones(void) {
    swim_whole_trial(BEATS, SPEED);
    const float measured_m_s = app.trial.run.trial.speed_m_s[1];
    const size_t length = encode_speeds(1, BEATS, 0.03f);
    TEST_ASSERT_EQUAL(STORE_OK,
                      store_replace(&app.vault.store, "/in/speeds.bin", upload_bytes, length));
    hal.flash_fail_after = hal.flash_writes;
    const link_command_t request = {.id = LINK_COMMAND_COMMIT,
                                    .file = VAULT_UPLOAD_SPEEDS,
                                    .length_bytes = (uint32_t)length,
                                    .crc = crc32_update(0, upload_bytes, length)};
    TEST_ASSERT_EQUAL(FAULT_STORAGE, commands_run(&app, &request));
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL_FLOAT(measured_m_s, app.trial.run.trial.speed_m_s[1]);
}

static void test_bad_gains_are_refused(void) {
    const float bad[] = {0.0f, -1.0f, NAN, INFINITY, -INFINITY, 1e9f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        TEST_ASSERT_EQUAL(FAULT_BAD_PARAM, commands_param_set(&app, PARAM_ILC_GAIN, bad[i]));
        TEST_ASSERT_EQUAL_FLOAT(4.0f, app.params.value[PARAM_ILC_GAIN]);
    }
}

static void test_parameters_persist_only_when_saved(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 6.0f));
    reboot();
    TEST_ASSERT_EQUAL_FLOAT(4.0f, app.params.value[PARAM_ILC_GAIN]);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 6.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    reboot();
    TEST_ASSERT_EQUAL_FLOAT(6.0f, app.params.value[PARAM_ILC_GAIN]);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_RESET, 0));
    TEST_ASSERT_EQUAL_FLOAT(4.0f, app.params.value[PARAM_ILC_GAIN]);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_LOAD, 0));
    TEST_ASSERT_EQUAL_FLOAT(6.0f, app.params.value[PARAM_ILC_GAIN]);
}

static void test_failing_flash_refuses_the_update_and_keeps_the_old_input(void) {
    swim_whole_trial(BEATS, SPEED);
    const memory_t before = app.learner.memory;
    hal.flash_fail_after = hal.flash_writes;
    TEST_ASSERT_EQUAL(FAULT_STORAGE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL_MEMORY(before.amplitude_rad, app.learner.memory.amplitude_rad, BEATS * 4u);
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_STORAGE, app.supervisor.reason);
    hal.flash_fail_after = 0;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
}

static void test_flash_that_fails_while_armed_or_during_an_upload_is_a_fault(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    hal.flash_fail_after = hal.flash_writes;
    run_ms(200); /* the first guess is stored while armed */
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_STORAGE, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    run_ms(200);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(STORE_IO, store_replace(&app.vault.store, "/in/reference.bin", "x", 1));
    run_ms(20);
    TEST_ASSERT_EQUAL(FAULT_STORAGE, app.supervisor.reason);
}

static void test_a_full_store_is_no_fault(void) {
    static uint8_t piece[60u * BLOCK_BYTES];
    store_result_t result = STORE_OK;
    char path[] = "/in/a";
    for (size_t length = sizeof piece; length > 0; length /= 2u) {
        for (result = STORE_OK; result == STORE_OK; path[4]++) {
            result = store_replace(&app.vault.store, path, piece, length);
        }
        TEST_ASSERT_EQUAL(STORE_NO_SPACE, result);
    }
    TEST_ASSERT_EQUAL(FAULT_WRITE_FAILED, command(LINK_COMMAND_PARAMS_SAVE, 0));
    run_ms(200);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_contradicting_servo_parameters_do_not_arm(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_SERVO_MIN_US, 1600.0f));
    TEST_ASSERT_EQUAL(FAULT_SERVO_CONFIG, command(LINK_COMMAND_ARM, 0));
}

/* The monitor goes by what is stored; nothing stored stands for the defaults. */
static void test_servo_limits_wider_than_saved_do_not_arm(void) {
    static const struct {
        param_t param;
        float wider, narrower;
    } LIMITS[] = {{PARAM_SERVO_MIN_US, 899.0f, 1000.0f},
                  {PARAM_SERVO_MAX_US, 2101.0f, 2000.0f},
                  {PARAM_SERVO_SLEW_RAD_S, 0.0f, 3.0f}};
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    for (uint32_t i = 0; i < 3u; i++) {
        TEST_ASSERT_EQUAL(FAULT_NONE,
                          commands_param_set(&app, LIMITS[i].param, LIMITS[i].narrower));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISARM, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, LIMITS[i].param, LIMITS[i].wider));
        TEST_ASSERT_EQUAL(FAULT_SERVO_UNSAVED, command(LINK_COMMAND_ARM, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISARM, 0));
    }
}

/* RAM that changes after arming moves the tail no further than what is stored. */
static void test_a_limit_that_changes_in_ram_cuts_the_swim(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    app.params.value[PARAM_SERVO_CENTRE_US] = 2120.0f;
    app.params.value[PARAM_SERVO_MAX_US] = 2200.0f;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    run_ms(200);
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_MONITOR, app.supervisor.reason);
    for (size_t i = 0; i < hal.pulse_count; i++) {
        TEST_ASSERT_EQUAL_UINT16(0, hal.pulses[i]);
    }
}

static void test_a_lead_as_long_as_the_trial_does_not_arm(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_LEAD, BEATS));
    TEST_ASSERT_EQUAL(FAULT_BAD_LAW, command(LINK_COMMAND_ARM, 0));
}

static void test_the_best_comes_back_on_request(void) {
    TEST_ASSERT_EQUAL(FAULT_NO_BEST, command(LINK_COMMAND_RESTORE_BEST, 0));
    swim_whole_trial(BEATS, SPEED);
    const float swum_rad = app.trial.run.trial.amplitude_rad[1];
    TEST_ASSERT_EQUAL(FAULT_TRIAL_PENDING, command(LINK_COMMAND_RESTORE_BEST, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_RESTORE_BEST, 0));
    TEST_ASSERT_EQUAL_FLOAT(swum_rad, app.learner.memory.amplitude_rad[1]);
}

static void test_a_watchdog_reset_is_told_and_must_be_cleared(void) {
    hal.reset_cause = HAL_RESET_WATCHDOG;
    reboot();
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_WATCHDOG, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_a_crash_is_told_and_kept_in_a_file(void) {
    hal.crashed = true;
    hal.crash = (hal_crash_t){.kind = HAL_CRASH_ASSERTION,
                              .pc = 0x80123u,
                              .registers = {0, 7u},
                              .time_us = 5000000000u,
                              .where = "gait.c:12",
                              .stack_words = 2,
                              .stack = {11u, 22u}};
    hal.reset_cause = HAL_RESET_SOFTWARE;
    reboot();
    TEST_ASSERT_EQUAL(FAULT_CRASH, app.supervisor.reason);
    TEST_ASSERT_FALSE(hal.crashed);
    uint32_t length = 0;
    crash_report_t report;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, "/crash.bin", &length));
    TEST_ASSERT_EQUAL(STORE_OK,
                      store_load(&app.vault.store, "/crash.bin", app.vault.record, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, record_decode_crash(app.vault.record, length, &report));
    TEST_ASSERT_EQUAL_STRING(link_build_id(), report.build_id);
    TEST_ASSERT_EQUAL_STRING("gait.c:12", report.crash.where);
    TEST_ASSERT_EQUAL_HEX32(0x80123u, report.crash.pc);
    TEST_ASSERT_EQUAL_UINT64(5000000000u, report.crash.time_us);
    TEST_ASSERT_EQUAL(22u, report.crash.stack[1]);
    TEST_ASSERT_EQUAL_STRING("cause", report.register_names[1]);
    TEST_ASSERT_EQUAL(7u, report.crash.registers[1]);
    TEST_ASSERT_EQUAL_STRING("", report.register_names[2]);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, "/crash.bin", &length));
}

static void test_a_crash_that_cannot_be_stored_is_kept_for_the_next_boot(void) {
    hal.crashed = true;
    hal.crash = (hal_crash_t){.kind = HAL_CRASH_BUS_FAULT};
    hal.flash_fail_after = hal.flash_writes;
    reboot();
    TEST_ASSERT_TRUE(hal.crashed);
    hal.flash_fail_after = 0;
    reboot();
    TEST_ASSERT_FALSE(hal.crashed);
    TEST_ASSERT_EQUAL(FAULT_CRASH, app.supervisor.reason);
}

static void test_a_dead_crystal_is_told_and_the_tail_stays_off(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    hal.clock_inexact = true;
    reboot();
    TEST_ASSERT_EQUAL(FAULT_CLOCK, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(FAULT_CLOCK, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_the_watchdog_is_fed_while_the_tick_lives(void) {
    run_ms(200);
    const uint32_t fed = hal.watchdog_feeds;
    TEST_ASSERT_GREATER_THAN(10u, fed);
    hal.now_us += 200000u;
    app_poll(&app);
    app_poll(&app);
    TEST_ASSERT_EQUAL(fed, hal.watchdog_feeds);
    app_tick_isr(&app);
    app_poll(&app);
    TEST_ASSERT_EQUAL(fed + 1u, hal.watchdog_feeds);
}

static void test_the_imu_line_runs_at_the_speed_of_the_parameter(void) {
    TEST_ASSERT_EQUAL(115200u, hal.baud[HAL_PORT_IMU]);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_IMU_BAUD, 460800.0f));
    TEST_ASSERT_EQUAL(460800u, hal.baud[HAL_PORT_IMU]);
    hal.baud_max = 500000u;
    TEST_ASSERT_EQUAL(FAULT_BAD_PARAM, commands_param_set(&app, PARAM_IMU_BAUD, 921600.0f));
    TEST_ASSERT_EQUAL_FLOAT(460800.0f, app.params.value[PARAM_IMU_BAUD]);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_RESET, 0));
    TEST_ASSERT_EQUAL(115200u, hal.baud[HAL_PORT_IMU]);
}

static void test_a_reboot_command_waits_for_its_acknowledgement(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_REBOOT, 0));
    run_ms(100);
    TEST_ASSERT_EQUAL(0, hal.resets);
    run_ms(200);
    TEST_ASSERT_EQUAL(1, hal.resets);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_good_reference_is_taken_over_and_survives_a_reboot);
    RUN_TEST(test_bad_references_are_refused_and_change_nothing);
    RUN_TEST(test_a_reference_off_the_servo_grid_is_refused);
    RUN_TEST(test_a_commit_must_name_the_file_that_is_there);
    RUN_TEST(test_the_same_reference_again_keeps_what_was_learned);
    RUN_TEST(test_a_pending_trial_survives_a_reboot);
    RUN_TEST(test_the_trial_number_never_comes_twice);
    RUN_TEST(test_speeds_uploaded_after_the_swim_are_learned_from);
    RUN_TEST(test_uploaded_amplitudes_swim_next_and_stay_at_arming);
    RUN_TEST(test_what_was_learned_comes_back_from_a_backup);
    RUN_TEST(test_what_an_older_firmware_learned_stays);
    RUN_TEST(test_the_first_input_follows_the_gain_of_the_moment);
    RUN_TEST(test_the_first_input_follows_the_gain_across_a_reboot);
    RUN_TEST(test_arming_checks_the_reference_against_the_limits_of_the_moment);
    RUN_TEST(test_failing_flash_refuses_uploaded_speeds_and_keeps_the_measured_ones);
    RUN_TEST(test_bad_gains_are_refused);
    RUN_TEST(test_parameters_persist_only_when_saved);
    RUN_TEST(test_failing_flash_refuses_the_update_and_keeps_the_old_input);
    RUN_TEST(test_flash_that_fails_while_armed_or_during_an_upload_is_a_fault);
    RUN_TEST(test_a_full_store_is_no_fault);
    RUN_TEST(test_contradicting_servo_parameters_do_not_arm);
    RUN_TEST(test_servo_limits_wider_than_saved_do_not_arm);
    RUN_TEST(test_a_limit_that_changes_in_ram_cuts_the_swim);
    RUN_TEST(test_a_lead_as_long_as_the_trial_does_not_arm);
    RUN_TEST(test_the_best_comes_back_on_request);
    RUN_TEST(test_a_watchdog_reset_is_told_and_must_be_cleared);
    RUN_TEST(test_a_crash_is_told_and_kept_in_a_file);
    RUN_TEST(test_a_crash_that_cannot_be_stored_is_kept_for_the_next_boot);
    RUN_TEST(test_a_dead_crystal_is_told_and_the_tail_stays_off);
    RUN_TEST(test_the_watchdog_is_fed_while_the_tick_lives);
    RUN_TEST(test_the_imu_line_runs_at_the_speed_of_the_parameter);
    RUN_TEST(test_a_reboot_command_waits_for_its_acknowledgement);
    return UNITY_END();
}
