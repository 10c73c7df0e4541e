/*
 * The longest trial of the fastest beats: 512 of 0.2 s. Each array is full to its last element, and
 * no time of a beat may be taken for its number.
 */
#include "app_fixture.h"

#include "store/bytes.h"
#include "store/unpacker.h"

#define BEAT_S 0.2
#define SPEED_0_M_S 0.02
#define SPEED_RISE_M_S2 3e-4

void setUp(void) {
    fixture_reset();
    app.params.value[PARAM_SPD_WINDOW_S] = 0.0f;
    app.params.value[PARAM_TANK_LEN_M] = 0.0f;
    app.params.value[PARAM_ILC_KIND] = (float)PAST_WINDOW;
}

void tearDown(void) {}

static double swum_m_s(double time_s) { return SPEED_0_M_S + SPEED_RISE_M_S2 * time_s; }

static void start_long_trial(void) {
    static reference_t reference = {.beats = BEATS_MAX, .beat_s = (float)BEAT_S};
    for (uint16_t k = 0; k < BEATS_MAX; k++) {
        reference.speed_m_s[k] = 0.03f + 0.00002f * (float)(k % 7u);
    }
    const size_t length = record_encode_reference(&reference, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_REFERENCE, "/in/reference.bin", upload_bytes, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
}

/* The camera sees a fish that becomes faster all the time. */
static void swim_long_trial(void) {
    start_long_trial();
    run_ms(20);
    const double begin_s = 1e-6 * (double)app.trial.run.start_us;
    for (uint32_t ms = 0; ms < 512u * 200u + 6000u; ms += 20u) {
        const double seen_s = 1e-6 * (double)hal.now_us + 0.02 - 0.5;
        swim_speed_m_s = (float)swum_m_s(seen_s - begin_s);
        run_ms(20);
    }
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

static void expect_speeds(void) {
    for (uint32_t k = 0; k < BEATS_MAX; k++) {
        const double middle_m_s = swum_m_s((k + 0.5) * BEAT_S);
        TEST_ASSERT_FLOAT_WITHIN(5e-5f, (float)middle_m_s, app.trial.run.trial.speed_m_s[k]);
    }
}

/* How many records of beat |k| its trial file has, with the speed it became. */
static void count_beat_records(uint16_t count[BEATS_MAX]) {
    char path[STORE_PATH_BYTES];
    static uint8_t stored[32u * 1024u], bytes[64u * 1024u];
    bool damaged = true;
    trial_log_path(app.trial.run.trial.number, path);
    uint32_t size_bytes = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, path, &size_bytes));
    TEST_ASSERT_TRUE(size_bytes <= sizeof stored);
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&app.vault.store, path, stored, size_bytes));
    const size_t length = unpacker_all(stored, size_bytes, bytes, sizeof bytes, &damaged);
    TEST_ASSERT_FALSE(damaged);
    uint16_t topic = UINT16_MAX;
    for (size_t at = 16; at + 3u <= length; at += 3u + bytes_get_u16(bytes + at)) {
        const uint8_t *body = bytes + at + 3;
        const uint16_t body_bytes = bytes_get_u16(bytes + at);
        if (bytes[at + 2] == 'A' && body_bytes == 7u && memcmp(body + 3, "beat", 4) == 0) {
            topic = bytes_get_u16(body + 1);
        } else if (bytes[at + 2] == 'D' && bytes_get_u16(body) == topic) {
            const uint16_t k = bytes_get_u16(body + 10 + 20);
            TEST_ASSERT_TRUE(k < BEATS_MAX);
            TEST_ASSERT_EQUAL_FLOAT(app.trial.run.trial.speed_m_s[k],
                                    bytes_get_f32(body + 10 + 12));
            count[k]++;
        }
    }
}

static void test_every_beat_is_measured_and_logged_once(void) {
    static uint16_t count[BEATS_MAX];
    swim_long_trial();
    TEST_ASSERT_EQUAL(BEATS_MAX, app.trial.run.trial.executed);
    expect_speeds();
    count_beat_records(count);
    for (uint32_t k = 0; k < BEATS_MAX; k++) {
        TEST_ASSERT_EQUAL_UINT16(1, count[k]);
    }
}

static void test_an_average_keeps_all_beats(void) {
    static past_t past;
    char path[] = PAST_PATH;
    swim_long_trial();
    const trial_record_t trial = app.trial.run.trial;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial.number));
    path[5] = (char)('0' + (app.learner.memory.iteration - 1u) % VAULT_PAST_PLACES);
    const size_t length = vault_read(&app.vault, path);
    TEST_ASSERT_EQUAL(FAULT_NONE, record_decode_past(app.vault.record, length, &past));
    TEST_ASSERT_EQUAL(BEATS_MAX, past.beats);
    for (uint32_t k = 0; k < BEATS_MAX; k++) {
        TEST_ASSERT_EQUAL_FLOAT(trial.amplitude_rad[k], past.amplitude_rad[k]);
        TEST_ASSERT_EQUAL_FLOAT(app.learner.reference.speed_m_s[k] - trial.speed_m_s[k],
                                past.error_m_s[k]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_every_beat_is_measured_and_logged_once);
    RUN_TEST(test_an_average_keeps_all_beats);
    return UNITY_END();
}
