/*
 * The whole firmware through two learning trials, with the power cut at every single page write of
 * it. The session is played once to see what a board knows at the end of each step, and once more
 * with a second board booting from what each cut leaves: it must know what the first one knew
 * before the step or after it. The same for the learning of a law that averages: what the cut left
 * must learn the same of the trial. APP_CUT_PAIRS (40) pairs of cuts follow, the second one while
 * that board boots or goes on.
 */
#include "app_fixture.h"
#include "flash_model.h"
#include "store_ledger.h"
#include "target.h"

#include <stdio.h>
#include <stdlib.h>

#define BEATS 4u
#define SPEED 0.05f
#define STEPS_MAX 32u
#define GOES_ON_EVERY 9u /* cuts, after one of which the board swims and learns again */

/* What lasts, as a boot finds it. */
typedef struct {
    uint32_t reference_crc, next_trial, pending, log_bytes;
    bool uploaded; /* speeds of the pending trial */
    memory_t memory;
    params_t params;
} knowledge_t;

static hal_t dark_hal;
static app_t dark;
static flash_model_t model, dark_model;
static knowledge_t after[STEPS_MAX]; /* [0] = before the first step */
static uint32_t step_count, step, writes, cuts, pairs_wanted, pairs_done, all_writes, started;
static bool learning_began;
static bool only_learning; /* no other step is cut */
static enum { LOOK, CUT, CUT_TWICE } mode;

static knowledge_t known_to(const app_t *board) {
    knowledge_t knowledge = {.reference_crc = board->learner.reference.crc,
                             .next_trial = board->trial.next,
                             .pending =
                                 board->trial.run.pending ? board->trial.run.trial.number : 0,
                             .memory = board->learner.memory,
                             .params = board->params};
    knowledge.uploaded = knowledge.pending != 0 && board->trial.run.trial.speed_m_s[0] > 0.03f;
    return knowledge;
}

static void boot_dark(void) {
    memset(&dark, 0xCD, sizeof dark);
    dark_hal.now_us = 0;
    dark_hal.tx[0].tail = dark_hal.tx[1].tail = 0;
    dark_hal.rx[0].tail = dark_hal.rx[1].tail = 0;
    dark_hal.irq_locked = 0;
    mock_reset_guarded(&dark_hal);
    app_init(&dark, &dark_hal);
}

static bool same_memory(const memory_t *a, const memory_t *b) {
    return memcmp(a, b, sizeof *a) == 0;
}

/* The first guess is stored before the tail moves, in the midst of a step. */
static bool is_first_guess(const memory_t *memory) {
    return memory->input == MEMORY_INPUT_FIRST && memory->iteration == 1u;
}

static void expect_old_or_new(void) {
    const knowledge_t *old = &after[step], *new = &after[step + 1u];
    const knowledge_t found = known_to(&dark);
    TEST_ASSERT_EQUAL(STATE_IDLE, dark.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, dark.supervisor.reason);
    TEST_ASSERT_TRUE(found.reference_crc == old->reference_crc ||
                     found.reference_crc == new->reference_crc);
    TEST_ASSERT_TRUE(found.reference_crc == 0 || found.memory.reference_crc == found.reference_crc);
    TEST_ASSERT_TRUE(same_memory(&found.memory, &old->memory) ||
                     same_memory(&found.memory, &new->memory) || is_first_guess(&found.memory));
    TEST_ASSERT_TRUE(memcmp(&found.params, &old->params, sizeof found.params) == 0 ||
                     memcmp(&found.params, &new->params, sizeof found.params) == 0);
    TEST_ASSERT_TRUE(found.pending == old->pending || found.pending == new->pending);
    TEST_ASSERT_TRUE(found.uploaded == old->uploaded || found.uploaded == new->uploaded);
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(old->next_trial, found.next_trial);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(new->next_trial, found.next_trial);
    /* No number comes twice, nothing is learned twice, and what waits was not learned. */
    TEST_ASSERT_GREATER_THAN_UINT32(started, found.next_trial);
    TEST_ASSERT_TRUE(found.pending == 0 || found.pending > found.memory.last_trial);
    const bool forgotten = old->pending != 0 && found.pending == 0;
    TEST_ASSERT_TRUE(!forgotten || new->pending == 0);
    TEST_ASSERT_TRUE(!forgotten || !learning_began || found.memory.last_trial == old->pending);
    TEST_ASSERT_EQUAL_INT32(0, ledger_lost_blocks(&dark.vault.store));
    TEST_ASSERT_EQUAL_UINT32(0, dark.vault.store.failures);
}

static fault_t order(link_command_id_t id, uint32_t trial) {
    const link_command_t request = {
        .id = id, .trial = trial, .issued_s = (float)dark_hal.now_us * 1e-6f};
    if (id == LINK_COMMAND_START) {
        wait_for_blank_blocks(&dark);
    }
    return commands_run(&dark, &request);
}

static void run_dark_ms(uint32_t duration_ms) {
    for (uint32_t ms = 0; ms < duration_ms; ms += 20u) {
        dark_hal.now_us += 20000u;
        app_tick_isr(&dark);
        const link_vision_t sample = {
            .time_us = dark_hal.now_us - 500000u, .speed_m_s = 0.02f, .sigma_m_s = 0.001f};
        if (dark_hal.now_us % 40000u == 0 && dark_hal.now_us > 500000u) {
            dark.link.handlers.vision(&dark, &sample);
        }
        dark.trial.host.last_heartbeat_us = dark_hal.now_us;
        app_poll(&dark);
        dark_hal.tx[0].head = dark_hal.tx[0].tail = dark_hal.tx[1].head = dark_hal.tx[1].tail = 0;
    }
}

/* Whatever the cut left: the next trial is swum and learned from. */
static void goes_on(void) {
    if (dark.trial.run.pending) {
        TEST_ASSERT_EQUAL(FAULT_NONE, order(LINK_COMMAND_DISCARD, dark.trial.run.trial.number));
    }
    if (dark.learner.reference.beats == 0) {
        return;
    }
    const uint32_t trial = dark.trial.next;
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&dark, PARAM_SPD_SOURCE, 0.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, order(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, order(LINK_COMMAND_START, trial));
    run_dark_ms(dark.learner.reference.beats * 1000u + 5000u);
    TEST_ASSERT_EQUAL_UINT32(trial, dark.trial.run.trial.number);
    TEST_ASSERT_EQUAL(FAULT_NONE, order(LINK_COMMAND_LEARN, trial));
    boot_dark();
    TEST_ASSERT_EQUAL_UINT32(trial, dark.learner.memory.last_trial);
    TEST_ASSERT_EQUAL_UINT32(trial + 1u, dark.trial.next);
}

static void darken(cut_kind_t kind, uint32_t offset, const uint8_t *page) {
    mock_flash_copy(&dark_hal, &hal, false);
    flash_model_attach(&dark_model, &dark_hal, writes * CUT_KINDS + kind);
    flash_model_cut(&dark_model, &dark_hal, kind, offset, page);
}

/* The old learned input has its whole past, whatever lies beside it. */
static void learns_the_same(void) {
    const knowledge_t *old = &after[step], *new = &after[step + 1u];
    if (!dark.trial.run.pending || !same_memory(&dark.learner.memory, &old->memory)) {
        return;
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, order(LINK_COMMAND_LEARN, dark.trial.run.trial.number));
    boot_dark();
    TEST_ASSERT_TRUE(same_memory(&dark.learner.memory, &new->memory));
}

static void cut_in_every_way(uint32_t offset, const uint8_t *page) {
    for (unsigned kind = 0; kind < CUT_KINDS; kind++) {
        darken((cut_kind_t)kind, offset, page);
        boot_dark();
        expect_old_or_new();
        if (learning_began) {
            learns_the_same();
        }
        if (cuts++ % GOES_ON_EVERY == writes % GOES_ON_EVERY) {
            goes_on();
        }
    }
}

static void cut_twice(uint32_t offset, const uint8_t *page) {
    darken((cut_kind_t)flash_model_random(&model, CUT_KINDS), offset, page);
    dark_model.cut_in = 1u + flash_model_random(&model, 40);
    dark_model.cut_kind = (cut_kind_t)flash_model_random(&model, CUT_KINDS);
    const uint32_t next = after[step].next_trial;
    if (setjmp(flash_model_off) == 0) {
        boot_dark();
        expect_old_or_new();
        goes_on();
        dark_model.cut_in = 0;
    }
    boot_dark();
    TEST_ASSERT_EQUAL(STATE_IDLE, dark.supervisor.state);
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(next, dark.trial.next);
    TEST_ASSERT_TRUE(!dark.trial.run.pending ||
                     dark.trial.run.trial.number > dark.learner.memory.last_trial);
    TEST_ASSERT_EQUAL_INT32(0, ledger_lost_blocks(&dark.vault.store));
    goes_on();
    pairs_done++;
}

static void at_write(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    writes++;
    if (mode == CUT && (learning_began || !only_learning)) {
        cut_in_every_way(offset, page);
    }
    while (mode == CUT_TWICE &&
           pairs_done < (uint64_t)pairs_wanted * writes / (all_writes != 0 ? all_writes : 1u)) {
        cut_twice(offset, page);
    }
}

/* Ends a step: what a board knows now is old for the next one. */
static void done(void) {
    step++;
    TEST_ASSERT_LESS_THAN_UINT32(STEPS_MAX, step);
    learning_began = false;
    if (mode == LOOK) {
        mock_flash_copy(&dark_hal, &hal, false);
        flash_model_attach(&dark_model, &dark_hal, 1);
        boot_dark();
        after[step] = known_to(&dark);
        step_count = step;
    }
}

static void do_command(link_command_id_t id, uint32_t trial) {
    learning_began = id == LINK_COMMAND_LEARN;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(id, trial));
    done();
}

static void swim(uint32_t trial, uint32_t ms) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    run_ms(100);
    done();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, trial));
    started = trial;
    done();
    run_ms(ms);
    done();
}

static void upload_speeds(uint32_t trial) {
    static speed_upload_t speeds;
    speeds.trial = trial;
    speeds.beats = BEATS;
    for (uint32_t k = 0; k < BEATS; k++) {
        speeds.speed_m_s[k] = 0.04f;
        speeds.sigma_m_s[k] = 0.001f;
    }
    const size_t length = record_encode_speeds(&speeds, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_SPEEDS, "/in/speeds.bin", upload_bytes, length));
    done();
}

static void upload_amplitudes(void) {
    static amplitudes_upload_t upload;
    upload.reference_crc = app.learner.reference.crc;
    upload.beats = BEATS;
    for (uint32_t k = 0; k < BEATS; k++) {
        upload.amplitude_rad[k] = 0.1f * (float)k;
    }
    const size_t length = record_encode_amplitudes(&upload, upload_bytes);
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commit(VAULT_UPLOAD_AMPLITUDES, "/in/amplitudes.bin", upload_bytes, length));
    done();
}

static void begin_session(void) {
    step = writes = started = 0;
    learning_began = false;
    mock_hal_init(&hal);
    host_alive = camera_on = true;
    swim_speed_m_s = 0.02f;
    flash_model_attach(&model, &hal, 1);
    model.before_write = at_write;
    if (mode == LOOK) {
        mock_hal_init(&dark_hal);
        boot_dark();
        after[0] = known_to(&dark);
    }
    app_init(&app, &hal);
    done();
}

static void session(void) {
    begin_session();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 3.0f));
    do_command(LINK_COMMAND_PARAMS_SAVE, 0);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    done();
    swim(1, BEATS * 1000u + 5000u);
    upload_speeds(1);
    do_command(LINK_COMMAND_LEARN, 1);
    upload_amplitudes();
    swim(2, BEATS * 1000u + 5000u);
    do_command(LINK_COMMAND_LEARN, 2);
    do_command(LINK_COMMAND_RESTORE_BEST, 0);
    swim(3, 2500u);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ABORT, 0));
    run_ms(5000);
    done();
    do_command(LINK_COMMAND_CLEAR, 0);
    do_command(LINK_COMMAND_DISCARD, 3);
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 2.0f));
    do_command(LINK_COMMAND_PARAMS_SAVE, 0);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS + 1u, SPEED));
    done();
}

static void session_of_averages(float kind) {
    begin_session();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_KIND, kind));
    do_command(LINK_COMMAND_PARAMS_SAVE, 0);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    done();
    for (uint32_t trial = 1; trial <= 5u; trial++) {
        swim_speed_m_s = 0.02f + 0.003f * (float)(trial % 3u);
        swim(trial, BEATS * 1000u + 5000u);
        do_command(LINK_COMMAND_LEARN, trial);
    }
}

void setUp(void) { only_learning = false; }

void tearDown(void) {
    if (Unity.CurrentTestFailed) {
        printf("step %u, write %u, cut %u, pair %u\n", (unsigned)step, (unsigned)writes,
               (unsigned)cuts, (unsigned)pairs_done);
    }
}

static void test_a_cut_at_every_write_of_a_session(void) {
    mode = LOOK;
    session();
    all_writes = writes;
    mode = CUT;
    session();
    TEST_ASSERT_EQUAL_UINT32(all_writes, writes);
    TEST_ASSERT_EQUAL_UINT32(step_count, step);
    printf("session: %u steps, %u writes, %u cuts\n", (unsigned)step, (unsigned)writes,
           (unsigned)cuts);
}

static void check_cuts_of_averages(past_kind_t kind) {
    only_learning = true;
    cuts = 0;
    mode = LOOK;
    session_of_averages((float)kind);
    mode = CUT;
    session_of_averages((float)kind);
    TEST_ASSERT_EQUAL_UINT32(step_count, step);
    printf("law %u: %u cuts while learning\n", (unsigned)kind, (unsigned)cuts);
}

static void test_a_cut_at_every_write_that_learns_a_mean(void) {
    check_cuts_of_averages(PAST_MEAN);
}

static void test_a_cut_at_every_write_that_learns_a_moving_average(void) {
    check_cuts_of_averages(PAST_WINDOW);
}

static void test_pairs_of_cuts(void) {
    const char *text = getenv("APP_CUT_PAIRS");
    pairs_wanted = text != NULL ? (uint32_t)strtoul(text, NULL, 10) : 40u;
    mode = CUT_TWICE;
    session();
    TEST_ASSERT_EQUAL_UINT32(pairs_wanted, pairs_done);
    printf("session: %u pairs of cuts\n", (unsigned)pairs_done);
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(test_a_cut_at_every_write_of_a_session);
    RUN_ON_HOST(test_pairs_of_cuts);
    RUN_ON_HOST(test_a_cut_at_every_write_that_learns_a_mean);
    RUN_ON_HOST(test_a_cut_at_every_write_that_learns_a_moving_average);
    return UNITY_END();
}
