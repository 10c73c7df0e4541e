/* Laws that average: the board against the learner that keeps its trials in RAM, bit for bit; what
 * ends an average; and laws that are refused. */
#include "learner.h"
#include "past_fixture.h"
#include "settings/settings.h"

#include <stdio.h>

#define BEATS 9u
#define TRIALS 12u
#define SPEED 0.05f
#define CUT_EVERY 3u /* trials, one of which is aborted */

static buffer_learner_t learner;
static float buffer_learner_memory[BEATS * 3u * (LEARNER_WINDOW_MAX + 1u)];
static uint32_t random_state;

static float random_0_1(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return (float)(random_state >> 8) / 16777216.0f;
}

void setUp(void) {
    random_state = 1;
    fixture_reset();
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ROLLBACK_RATIO, 0.0f));
}
void tearDown(void) {
    if (Unity.CurrentTestFailed) {
        printf("trial %u, random state %u\n", (unsigned)app.trial.run.trial.number,
               (unsigned)random_state);
    }
}

static void expect_refused(param_t param, float value, fault_t fault) {
    const float before = app.params.value[param];
    TEST_ASSERT_EQUAL(fault, commands_param_set(&app, param, value));
    TEST_ASSERT_EQUAL_FLOAT(before, app.params.value[param]);
}

static void save_params(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
}

/* The next trial, aborted after |beats| of them; pending afterwards, with these speeds. */
static void swim(uint16_t beats, const float *speed_m_s) {
    static speed_upload_t speeds;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    run_ms(beats * 1000u + 300u);
    if (beats < BEATS) {
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    } else {
        run_ms(5000);
    }
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL(beats, app.trial.run.trial.executed);
    speeds.trial = app.trial.run.trial.number;
    speeds.beats = BEATS;
    for (uint32_t k = 0; k < BEATS; k++) {
        speeds.speed_m_s[k] = speed_m_s[k];
        speeds.sigma_m_s[k] = 0.001f;
    }
    const size_t length = record_encode_speeds(&speeds, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_SPEEDS, "/in/speeds.bin", upload_bytes, length));
}

/* One trial with random speeds, some of them missing. */
static void swim_any(uint32_t number, float *speed_m_s, uint16_t *beats) {
    *beats = number % CUT_EVERY == 0 ? (uint16_t)(2u + number % 5u) : BEATS;
    for (uint32_t k = 0; k < BEATS; k++) {
        speed_m_s[k] = random_0_1() < 0.1f ? NAN : 0.1f * random_0_1();
    }
    speed_m_s[0] = 0.01f;
    swim(*beats, speed_m_s);
}

static void swim_and_learn(uint32_t number) {
    float speed_m_s[BEATS];
    uint16_t beats = 0;
    swim_any(number, speed_m_s, &beats);
    learn();
}

static void begin_learner(past_kind_t past, uint16_t window) {
    buffer_learner_config_t config = {
        .law = settings_law(&app.params, 1.0f),
        .samples = BEATS,
        .past = past,
        .history = LEARNER_HISTORY_NONE,
        .window = window,
    };
    for (uint32_t j = 0; j < window; j++) {
        const float even = 1.0f / (float)window;
        config.weight[j] = (law_weights_t){even, even, even};
    }
    float first[BEATS];
    for (uint32_t k = 0; k < BEATS; k++) {
        first[k] = config.law.kp_rad_s_m * SPEED;
    }
    TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_init(&learner, &config, first, buffer_learner_memory,
                                                  sizeof buffer_learner_memory));
}

static void expect_same_as_learner(void) {
    float amplitude[BEATS];
    for (uint16_t k = 0; k < BEATS; k++) {
        amplitude[k] = learner.amplitude[k];
    }
    TEST_ASSERT_EQUAL_MEMORY(amplitude, app.learner.memory.amplitude_rad, sizeof amplitude);
}

/* The board restarts in the middle of it. */
static void check_against_learner(past_kind_t past, uint16_t window) {
    set(PARAM_ILC_KIND, (float)past);
    set(PARAM_ILC_WINDOW, (float)window);
    save_params();
    begin_learner(past, window);
    for (uint32_t number = 1; number <= TRIALS; number++) {
        float speed_m_s[BEATS];
        uint16_t beats = 0;
        swim_any(number, speed_m_s, &beats);
        if (number % 4u == 0) {
            reboot();
        }
        learn();
        for (uint16_t k = 0; k < BEATS; k++) {
            (void)buffer_learner_measure(&learner, k, SPEED - speed_m_s[k]);
        }
        law_report_t report;
        TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, beats, &report));
        expect_same_as_learner();
        if (number % 5u == 0) {
            reboot();
        }
    }
}

static void prepare_law(float kd) {
    set(PARAM_ILC_LEAD, 0.5f);
    set(PARAM_ILC_KD, kd);
    set(PARAM_ILC_Q_LEN, 2.0f);
    set(PARAM_ILC_GAIN, 2.5f);
}

static void test_the_last_trial_gives_the_bits_of_the_learner(void) {
    prepare_law(0.3f);
    check_against_learner(PAST_LAST, 2);
}

static void test_the_mean_gives_the_bits_of_the_learner(void) {
    prepare_law(0.0f);
    check_against_learner(PAST_MEAN, 2);
}

static void test_windows_give_the_bits_of_the_learner(void) {
    prepare_law(0.3f);
    check_against_learner(PAST_WINDOW, 3);
}

static void test_the_longest_window_gives_the_bits_of_the_learner(void) {
    prepare_law(-0.2f);
    check_against_learner(PAST_WINDOW, PAST_WINDOW_MAX);
}

static uint32_t past_files(void) {
    uint32_t count = 0;
    for (char number = '0'; number < '0' + (char)VAULT_PAST_PLACES; number++) {
        char path[] = PAST_PATH;
        path[5] = number;
        uint32_t size_bytes = 0;
        count += store_size(&app.vault.store, path, &size_bytes) == STORE_OK;
    }
    return count;
}

static void test_the_last_trial_alone_keeps_no_past(void) {
    for (uint32_t number = 1; number <= 3u; number++) {
        swim_and_learn(number);
    }
    TEST_ASSERT_EQUAL(0, past_files());
}

static void upload_amplitudes(void) {
    static amplitudes_upload_t upload;
    upload.reference_crc = app.learner.reference.crc;
    upload.beats = BEATS;
    memcpy(upload.amplitude_rad, app.learner.memory.amplitude_rad, BEATS * sizeof(float));
    const size_t length = record_encode_amplitudes(&upload, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_AMPLITUDES, "/in/amplitudes.bin", upload_bytes, length));
}

static void restore_best(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_RESTORE_BEST, 0));
}

static void another_reference_and_back(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, 0.5f * SPEED));
    TEST_ASSERT_EQUAL(0, past_files());
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
}

static void a_trial_of_another_law(void) {
    const float kind = app.params.value[PARAM_ILC_KIND];
    set(PARAM_ILC_KIND, PAST_LAST);
    swim_and_learn(1);
    set(PARAM_ILC_KIND, kind);
}

static void damage_the_newest(void) {
    char path[] = PAST_PATH;
    path[5] = (char)('0' + (app.learner.memory.iteration - 1u) % VAULT_PAST_PLACES);
    const size_t length = vault_read(&app.vault, path);
    TEST_ASSERT_GREATER_THAN(0, length);
    app.vault.record[length - 1u] ^= 1u;
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, path, app.vault.record, length));
}

static void just_reboot(void) {
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void a_discarded_trial(void) {
    float speed_m_s[BEATS];
    uint16_t beats = 0;
    swim_any(1, speed_m_s, &beats);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, app.trial.run.trial.number));
}

static void check_average_after(void (*event)(void), bool goes_on) {
    for (float kind = PAST_MEAN; kind <= (float)PAST_WINDOW; kind++) {
        setUp();
        set(PARAM_ILC_KIND, kind);
        set(PARAM_ILC_WINDOW, (float)PAST_WINDOW_MAX);
        save_params();
        float all[BEATS];
        for (uint32_t k = 0; k < BEATS; k++) {
            all[k] = 0.04f;
        }
        swim(BEATS, all); /* a best one */
        learn();
        swim_and_learn(2);
        TEST_ASSERT_EQUAL(2, trials_in_average());
        event();
        swim_and_learn(1);
        TEST_ASSERT_EQUAL(goes_on ? 3 : 1, trials_in_average());
        swim_and_learn(1);
        TEST_ASSERT_EQUAL(goes_on ? 4 : 2, trials_in_average());
    }
}

static void test_what_ends_an_average(void) {
    check_average_after(upload_amplitudes, false);
    check_average_after(restore_best, false);
    check_average_after(another_reference_and_back, false);
    check_average_after(a_trial_of_another_law, false);
    check_average_after(damage_the_newest, false);
}

static void test_what_does_not_end_an_average(void) {
    check_average_after(just_reboot, true);
    check_average_after(a_discarded_trial, true);
}

/* The first record lies in the same place for both kinds, and names the learned input of now. */
static void test_the_kinds_do_not_mix(void) {
    for (uint32_t first = PAST_MEAN; first <= PAST_WINDOW; first++) {
        setUp();
        set(PARAM_ILC_KIND, (float)first);
        swim_and_learn(1);
        set(PARAM_ILC_KIND, (float)(PAST_MEAN + PAST_WINDOW - first));
        swim_and_learn(2);
        TEST_ASSERT_EQUAL(1, trials_in_average());
        swim_and_learn(4);
        TEST_ASSERT_EQUAL(2, trials_in_average());
    }
}

/* A window over a damaged file is that over the newer trials. */
static void test_a_hole_ends_the_window(void) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    set(PARAM_ILC_WINDOW, 8.0f);
    swim_and_learn(1);
    swim_and_learn(2);
    damage_the_newest();
    begin_learner(PAST_WINDOW, PAST_WINDOW_MAX);
    memcpy(learner.amplitude, app.learner.memory.amplitude_rad, BEATS * sizeof(float));
    for (uint32_t number = 1; number <= 2u; number++) {
        float speed_m_s[BEATS];
        uint16_t beats = 0;
        swim_any(number, speed_m_s, &beats);
        learn();
        for (uint16_t k = 0; k < BEATS; k++) {
            (void)buffer_learner_measure(&learner, k, SPEED - speed_m_s[k]);
        }
        law_report_t report;
        TEST_ASSERT_EQUAL(LAW_OK, buffer_learner_end(&learner, beats, &report));
        expect_same_as_learner();
    }
}

/* The fourth trial's window with the second one's file as |replace| leaves it. */
static void learn_without_the_second(void (*replace)(void), float *amplitude_rad) {
    setUp();
    set(PARAM_ILC_KIND, PAST_WINDOW);
    for (uint32_t number = 1; number <= 2u; number++) {
        swim_and_learn(number);
    }
    swim_and_learn(1);
    replace();
    swim_and_learn(2);
    memcpy(amplitude_rad, app.learner.memory.amplitude_rad, BEATS * sizeof(float));
}

static void remove_the_second(void) { (void)store_remove(&app.vault.store, "/past2.bin"); }

static void put_the_first_there(void) {
    const size_t length = vault_read(&app.vault, "/past1.bin");
    TEST_ASSERT_EQUAL(STORE_OK,
                      store_replace(&app.vault.store, "/past2.bin", app.vault.record, length));
}

static void leave_it(void) {}

static void test_a_whole_record_of_another_trial_is_a_hole_too(void) {
    float removed[BEATS], replaced[BEATS], left[BEATS];
    learn_without_the_second(remove_the_second, removed);
    learn_without_the_second(put_the_first_there, replaced);
    learn_without_the_second(leave_it, left);
    TEST_ASSERT_EQUAL_MEMORY(removed, replaced, sizeof removed);
    TEST_ASSERT_TRUE(memcmp(removed, left, sizeof removed) != 0);
}

static void test_a_roll_back_ends_the_average(void) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    set(PARAM_ROLLBACK_RATIO, 1.3f);
    float good[BEATS], bad[BEATS];
    for (uint32_t k = 0; k < BEATS; k++) {
        good[k] = 0.045f;
        bad[k] = 0.01f;
    }
    swim(BEATS, good);
    learn();
    swim(BEATS, bad);
    learn();
    swim(BEATS, bad);
    learn();
    TEST_ASSERT_EQUAL(MEMORY_INPUT_RESTORED, app.learner.memory.input);
    swim(BEATS, good);
    learn();
    TEST_ASSERT_EQUAL(1, trials_in_average());
}

static void test_a_write_that_fails_changes_nothing(void) {
    set(PARAM_ILC_KIND, PAST_MEAN);
    swim_and_learn(1);
    float speed_m_s[BEATS];
    uint16_t beats = 0;
    swim_any(2, speed_m_s, &beats);
    const memory_t before = app.learner.memory;
    uint32_t refusals = 0;
    for (fault_t fault = FAULT_STORAGE; fault != FAULT_NONE; refusals++) {
        TEST_ASSERT_EQUAL_MEMORY(&before, &app.learner.memory, sizeof before);
        hal.flash_fail_after = hal.flash_writes + 1u + refusals;
        fault = command(LINK_COMMAND_LEARN, app.trial.run.trial.number);
        hal.flash_fail_after = 0;
        if (fault != FAULT_NONE) {
            TEST_ASSERT_EQUAL(FAULT_STORAGE, fault);
            TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
        }
    }
    TEST_ASSERT_GREATER_THAN(4, refusals);
    TEST_ASSERT_EQUAL(2, trials_in_average());
}

/* Each a block long. */
static void leave_past_files(void) {
    static uint8_t filler[BLOCK_BYTES];
    for (char number = '0'; number < '0' + (char)VAULT_PAST_PLACES; number++) {
        char path[] = PAST_PATH;
        path[5] = number;
        TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, path, filler, sizeof filler));
    }
}

static void fill_store(uint32_t free_blocks) {
    static uint8_t filler[BLOCK_BYTES];
    static store_file_t file;
    TEST_ASSERT_EQUAL(STORE_OK, store_open(&app.vault.store, &file, "/in/filler", STORE_WRITE_NEW));
    while (store_free_bytes(&app.vault.store) > free_blocks * BLOCK_BYTES) {
        TEST_ASSERT_EQUAL(STORE_OK, store_append(&app.vault.store, &file, filler, sizeof filler));
        TEST_ASSERT_EQUAL(STORE_OK, store_sync(&app.vault.store, &file));
    }
    TEST_ASSERT_EQUAL(STORE_OK, store_close(&app.vault.store, &file));
}

/* The files the law reads, and the trial learned last. */
static void test_only_what_the_law_reads_is_kept(void) {
    set(PARAM_ILC_KIND, PAST_MEAN);
    leave_past_files();
    swim_and_learn(1);
    TEST_ASSERT_EQUAL(2, past_files());
    for (float window = 2.0f; window <= (float)PAST_WINDOW_MAX; window++) {
        set(PARAM_ILC_KIND, PAST_WINDOW);
        set(PARAM_ILC_WINDOW, window);
        leave_past_files();
        swim_and_learn(1);
        TEST_ASSERT_EQUAL((uint32_t)window, past_files());
    }
    set(PARAM_ILC_KIND, PAST_LAST);
    swim_and_learn(1);
    TEST_ASSERT_EQUAL(0, past_files());
}

static uint32_t logs;

static bool count_log(void *context, const store_entry_t *entry) {
    (void)context;
    (void)entry;
    logs++;
    return true;
}

static uint32_t count_logs(void) {
    logs = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_walk(&app.vault.store, "/trials", 0, count_log, NULL));
    return logs;
}

static void test_no_log_goes_for_a_file_that_no_law_reads(void) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    swim_and_learn(1);
    leave_past_files();
    set(PARAM_ILC_KIND, PAST_LAST);
    fill_store(11); /* with the eight files' blocks enough */
    swim_and_learn(2);
    TEST_ASSERT_EQUAL(0, past_files());
    TEST_ASSERT_EQUAL(2, count_logs());
}

static void test_the_trials_in_a_record_are_the_windows_at_most(void) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    set(PARAM_ILC_WINDOW, 3.0f);
    for (uint32_t number = 1; number <= 5u; number++) {
        swim_and_learn(number);
        TEST_ASSERT_EQUAL(number < 3u ? number : 3u, trials_in_average());
        TEST_ASSERT_EQUAL(0, told_missing());
    }
    set(PARAM_ILC_WINDOW, 8.0f);
    swim_and_learn(1);
    TEST_ASSERT_EQUAL(4, trials_in_average());
    TEST_ASSERT_EQUAL(0, told_missing());
}

/* Iterations have 16 bits. */
static void test_an_average_goes_on_when_the_iteration_goes_round(void) {
    for (float kind = PAST_MEAN; kind <= (float)PAST_WINDOW; kind++) {
        setUp();
        set(PARAM_ILC_KIND, kind);
        set(PARAM_ILC_WINDOW, (float)PAST_WINDOW_MAX);
        swim_and_learn(1);
        app.learner.memory.iteration = UINT16_MAX - 4u;
        app.learner.memory.input = MEMORY_INPUT_UPLOADED;
        TEST_ASSERT_EQUAL(FAULT_NONE, learner_save(&app.learner));
        for (uint32_t number = 1; number <= 12u; number++) {
            swim_and_learn(number);
            const uint32_t most = kind == (float)PAST_MEAN ? 12u : PAST_WINDOW_MAX;
            TEST_ASSERT_EQUAL(number < most ? number : most, trials_in_average());
        }
    }
}

/* What nobody asked for. */
static void check_told(void (*event)(void), uint32_t times) {
    for (float kind = PAST_MEAN; kind <= (float)PAST_WINDOW; kind++) {
        setUp();
        set(PARAM_ILC_KIND, kind);
        set(PARAM_ILC_WINDOW, (float)PAST_WINDOW_MAX);
        save_params();
        for (uint32_t number = 1; number <= 3u; number++) {
            swim_and_learn(number);
            TEST_ASSERT_EQUAL(0, told_missing());
        }
        event();
        swim_and_learn(1);
        TEST_ASSERT_EQUAL(times, told_missing());
        swim_and_learn(2);
        TEST_ASSERT_EQUAL(0, told_missing());
    }
}

static void lose_all(void) {
    while (learner_drop_past(&app.learner, 0)) {
    }
}

static void test_it_is_told_when_an_average_begins_anew_unasked(void) {
    check_told(damage_the_newest, 1);
    check_told(lose_all, 1);
    check_told(upload_amplitudes, 0);
    check_told(another_reference_and_back, 0);
    check_told(just_reboot, 0);
}

static void test_it_is_told_when_a_window_lacks_a_trial(void) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    set(PARAM_ILC_WINDOW, (float)PAST_WINDOW_MAX);
    for (uint32_t number = 1; number <= 3u; number++) {
        swim_and_learn(number);
    }
    TEST_ASSERT_TRUE(learner_drop_past(&app.learner, 0)); /* the oldest of three */
    swim_and_learn(1);
    TEST_ASSERT_EQUAL(1, told_missing());
    TEST_ASSERT_EQUAL(3, trials_in_average());
    swim_and_learn(2);
    TEST_ASSERT_EQUAL(0, told_missing());
    TEST_ASSERT_EQUAL(4, trials_in_average());
}

static void test_the_mean_goes_without_kd(void) {
    set(PARAM_ILC_KIND, PAST_MEAN);
    swim_and_learn(1);
    float speed_m_s[BEATS];
    uint16_t beats = 0;
    swim_any(2, speed_m_s, &beats);
    const memory_t before = app.learner.memory;
    set(PARAM_ILC_KD, 0.1f);
    TEST_ASSERT_EQUAL(FAULT_BAD_LAW, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
    TEST_ASSERT_EQUAL_MEMORY(&before, &app.learner.memory, sizeof before);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, app.trial.run.trial.number));
    TEST_ASSERT_EQUAL(FAULT_BAD_LAW, command(LINK_COMMAND_ARM, 0));
    set(PARAM_ILC_KIND, PAST_WINDOW);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
}

static void test_laws_that_are_none_for_a_fish_are_refused(void) {
    set(PARAM_ILC_KIND, PAST_WINDOW);
    expect_refused(PARAM_ILC_KIND, 3.0f, FAULT_LAW_FEEDBACK);
    expect_refused(PARAM_ILC_KIND, 4.0f, FAULT_LAW_FEEDBACK);
    expect_refused(PARAM_ILC_KIND, 5.0f, FAULT_LAW_SIGN);
    expect_refused(PARAM_ILC_KIND, 6.0f, FAULT_BAD_PARAM);
    expect_refused(PARAM_ILC_KIND, 1.5f, FAULT_BAD_PARAM);
    expect_refused(PARAM_ILC_WINDOW, 1.0f, FAULT_BAD_PARAM);
    expect_refused(PARAM_ILC_WINDOW, 9.0f, FAULT_BAD_PARAM);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    expect_refused(PARAM_ILC_KIND, 4.0f, FAULT_WRONG_STATE);
}

static void test_a_stored_law_that_is_none_falls_back(void) {
    for (float kind = 3.0f; kind <= 5.0f; kind++) {
        params_t params = app.params;
        params.value[PARAM_ILC_KIND] = kind;
        params.value[PARAM_ILC_GAIN] = 3.5f;
        const size_t length = record_encode_params(&params, app.vault.record);
        TEST_ASSERT_EQUAL(STORE_OK,
                          store_replace(&app.vault.store, PARAMS_PATH, app.vault.record, length));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_LOAD, 0));
        TEST_ASSERT_EQUAL_FLOAT(PAST_LAST, app.params.value[PARAM_ILC_KIND]);
        TEST_ASSERT_EQUAL_FLOAT(3.5f, app.params.value[PARAM_ILC_GAIN]);
        reboot();
        TEST_ASSERT_EQUAL_FLOAT(PAST_LAST, app.params.value[PARAM_ILC_KIND]);
        TEST_ASSERT_EQUAL_FLOAT(3.5f, app.params.value[PARAM_ILC_GAIN]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_last_trial_gives_the_bits_of_the_learner);
    RUN_TEST(test_the_mean_gives_the_bits_of_the_learner);
    RUN_TEST(test_windows_give_the_bits_of_the_learner);
    RUN_TEST(test_the_longest_window_gives_the_bits_of_the_learner);
    RUN_TEST(test_the_last_trial_alone_keeps_no_past);
    RUN_TEST(test_what_ends_an_average);
    RUN_TEST(test_what_does_not_end_an_average);
    RUN_TEST(test_the_kinds_do_not_mix);
    RUN_TEST(test_a_hole_ends_the_window);
    RUN_TEST(test_a_whole_record_of_another_trial_is_a_hole_too);
    RUN_TEST(test_a_roll_back_ends_the_average);
    RUN_TEST(test_a_write_that_fails_changes_nothing);
    RUN_TEST(test_only_what_the_law_reads_is_kept);
    RUN_TEST(test_no_log_goes_for_a_file_that_no_law_reads);
    RUN_TEST(test_the_trials_in_a_record_are_the_windows_at_most);
    RUN_TEST(test_an_average_goes_on_when_the_iteration_goes_round);
    RUN_TEST(test_it_is_told_when_an_average_begins_anew_unasked);
    RUN_TEST(test_it_is_told_when_a_window_lacks_a_trial);
    RUN_TEST(test_the_mean_goes_without_kd);
    RUN_TEST(test_laws_that_are_none_for_a_fish_are_refused);
    RUN_TEST(test_a_stored_law_that_is_none_falls_back);
    return UNITY_END();
}
