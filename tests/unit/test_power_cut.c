/*
 * What is stored, with the power cut at every single page write, and with pairs of cuts.
 *
 * From the environment: STORE_CUT_PAIRS (200 in all), STORE_CUT_SEED (1), and STORE_CUT_AGES (1):
 * how many lengths of life before the body, for a metadata block is compacted after seven commits.
 */
#include "power_cuts.h"
#include "store/bytes.h"
#include "store/log_reader.h"
#include "store/trial_log.h"
#include "target.h"
#include "unity.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define OLD_BYTES 700u
#define NEW_BYTES 4640u
#define LOG_PATH "/trials/0003.ulg"
#define LOG_START_US 1000000u
#define SYNCED_STEP 55u /* 5 s and some passes: what was logged before has been synced */
#define LOG_BYTES_PER_S 280u
#define RANDOM_OPERATIONS 8u /* per age */
#define RANDOM_FILES 5u
#define RANDOM_BYTES 2600u
#define OK(call) TEST_ASSERT_EQUAL_INT(STORE_OK, (call))

static uint8_t old_content[OLD_BYTES], new_content[NEW_BYTES];
static uint8_t whole_log[LEDGER_BYTES];
static uint32_t whole_log_bytes, whole_ulog_bytes, age, ages;
static trial_log_t log_;
static params_t params;
static store_file_t file;

static uint32_t from_environment(const char *name, uint32_t fallback) {
    const char *text = getenv(name);
    return text != NULL ? (uint32_t)strtoul(text, NULL, 10) : fallback;
}

void setUp(void) {
    params_reset(&params);
    ages = from_environment("STORE_CUT_AGES", 1);
    for (size_t i = 0; i < NEW_BYTES; i++) {
        new_content[i] = (uint8_t)(i * 7u + i / 256u);
        old_content[i % OLD_BYTES] = (uint8_t)~new_content[i % OLD_BYTES];
    }
}

void tearDown(void) { power_cuts_explain(); }

static void prepare(ledger_t *ledger) {
    for (uint32_t n = 0; n < age; n++) {
        OK(ledger_replace(ledger, "/small", &n, sizeof n));
        OK(ledger_replace(ledger, "/trials/0001.ulg", &n, sizeof n));
    }
    OK(ledger_replace(ledger, "/learned.bin", old_content, OLD_BYTES));
    OK(ledger_replace(ledger, "/small", old_content, 100));
}

static void replace(ledger_t *ledger) {
    OK(ledger_replace(ledger, "/learned.bin", new_content, NEW_BYTES));
    OK(ledger_replace(ledger, "/small", new_content, 120));
    OK(ledger_replace(ledger, "/fresh", new_content, 600));
    OK(ledger_remove(ledger, "/small"));
}

/* As the FTP server takes a file: emptied, filled in pieces, closed; then taken over and removed.
 */
static void upload(ledger_t *ledger) {
    ledger_open(ledger, &file, "/in/reference.bin", STORE_WRITE_NEW);
    for (uint32_t at = 0; at < 2400; at += 240u) {
        ledger_append(ledger, &file, "/in/reference.bin", new_content + at, 240);
    }
    ledger_close(ledger, &file, "/in/reference.bin");
    OK(ledger_replace(ledger, "/reference.bin", new_content, 2400));
    OK(ledger_remove(ledger, "/in/reference.bin"));
}

/* A file that grows over several syncs, and again after it was closed. */
static void append(ledger_t *ledger) {
    ledger_open(ledger, &file, LOG_PATH, STORE_WRITE_NEW);
    for (uint32_t at = 0; at < 4000; at += 500u) {
        ledger_append(ledger, &file, LOG_PATH, new_content + at, 500);
        if (at % 1500u == 0) {
            ledger_sync(ledger, &file, LOG_PATH);
        }
    }
    ledger_close(ledger, &file, LOG_PATH);
    ledger_open(ledger, &file, LOG_PATH, STORE_APPEND);
    ledger_append(ledger, &file, LOG_PATH, old_content, 300);
    ledger_close(ledger, &file, LOG_PATH);
}

static void make_space(ledger_t *ledger) {
    const uint32_t all = MOCK_FLASH_BYTES - RESERVE_BYTES;
    /* The oldest goes first; the ledger is told beforehand what may go. */
    const char *const going[] = {"/trials/0001.ulg", "/trials/0004.ulg"};
    for (uint32_t i = 0; i < 2; i++) {
        const uint32_t wanted = store_free_bytes(ledger->store) + 3u * BLOCK_BYTES;
        TEST_ASSERT_LESS_THAN_UINT32(all, wanted);
        bool done = false;
        for (uint32_t step = 0; step < ledger->count; step++) {
            ledger_object_t *object = &ledger->object[step];
            if (strcmp(object->path, going[i]) == 0) {
                object->changing = true;
                object->next.there = false;
            }
        }
        OK(store_make_space_step(ledger->store, wanted - RESERVE_BYTES, 2, &done));
        ledger_check(ledger);
        OK(store_make_space_step(ledger->store, 0, 2, &done));
        TEST_ASSERT_TRUE(done);
    }
}

static void prepare_trials(ledger_t *ledger) {
    const char *const paths[] = {"/trials/0005.ulg", "/trials/0001.ulg", "/trials/0002.ulg",
                                 "/trials/0004.ulg"};
    OK(ledger_replace(ledger, "/learned.bin", old_content, OLD_BYTES));
    for (size_t i = 0; i < 4; i++) {
        OK(ledger_replace(ledger, paths[i], new_content, NEW_BYTES));
    }
}

/* What a cut now would leave of the log: whole messages. Returns the ULog's length. */
static uint32_t unpacked_bytes(store_t *store) {
    static uint8_t stored[LEDGER_BYTES], ulog[4u * LEDGER_BYTES];
    uint32_t size = 0;
    bool damaged = true;
    OK(store_size(store, LOG_PATH, &size));
    OK(store_load(store, LOG_PATH, stored, size));
    const size_t length = unpacker_all(stored, size, ulog, sizeof ulog, &damaged);
    TEST_ASSERT_FALSE(damaged);
    size_t at = size == 0 ? 0 : 16u;
    while (at < length) {
        at += 3u + bytes_get_u16(ulog + at);
    }
    TEST_ASSERT_EQUAL_UINT(length, at);
    return (uint32_t)length;
}

static void swim(store_t *store, ledger_t *ledger) {
    static const trial_log_header_t header = {.trial = 3,
                                              .input = "law",
                                              .beats = 5,
                                              .start_us = LOG_START_US,
                                              .build_id = "1.0.0",
                                              .board = "simulated"};
    OK(trial_log_begin(&log_, store, &header, &params));
    for (uint32_t step = 0; step <= 60; step++) {
        const uint64_t now_us = LOG_START_US + step * 100000u;
        const speed_slot_t slot = {.index = (uint16_t)step, .samples = 2, .at_ms = 50};
        const trial_log_beat_t beat = {.beat = (uint16_t)(step / 10u)};
        trial_log_slot(&log_, now_us, &slot, SPEED_NO_MOTION);
        if (step % 10u == 0u && step < 50u) {
            trial_log_beat(&log_, now_us, &beat);
        }
        trial_log_poll(&log_, now_us);
        if (ledger != NULL) {
            ledger_synced(ledger, LOG_PATH);
        } else {
            const uint32_t synced = unpacked_bytes(store);
            const uint32_t wanted = LOG_BYTES_PER_S * SYNCED_STEP / 10u;
            TEST_ASSERT_GREATER_THAN_UINT32(step == SYNCED_STEP ? wanted : 0u, synced + 1u);
        }
    }
    trial_log_end(&log_, 7000000u, FAULT_NONE, 5);
    OK(trial_log_close(&log_));
}

/* What the log will be in the end; every message of it whole. */
static void know_the_log(void) {
    static hal_t hal;
    static store_t store;
    mock_hal_init(&hal);
    OK(store_mount(&store, &hal));
    swim(&store, NULL);
    whole_ulog_bytes = unpacked_bytes(&store);
    OK(store_size(&store, LOG_PATH, &whole_log_bytes));
    OK(store_load(&store, LOG_PATH, whole_log, whole_log_bytes));
    store_unmount(&store);
}

static void trial_log(ledger_t *ledger) {
    ledger_log_begins(ledger, LOG_PATH, whole_log, whole_log_bytes);
    swim(ledger->store, ledger);
    ledger_synced(ledger, LOG_PATH);
    OK(ledger_replace(ledger, "/pending.bin", new_content, 500));
    TEST_ASSERT_EQUAL_UINT32(whole_ulog_bytes, unpacked_bytes(ledger->store));
}

static uint32_t random_state;
static uint32_t random_below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % limit;
}

static void random_operations(ledger_t *ledger) {
    random_state = 4711u;
    for (uint32_t n = 0; n < RANDOM_OPERATIONS * ages; n++) {
        char path[] = "/in/f0";
        const uint32_t f = random_below(RANDOM_FILES);
        path[5] = (char)('0' + f);
        const char *const name = f % 2u == 0 ? path : path + 3;
        uint32_t size = 0;
        const bool there = store_size(ledger->store, name, &size) == STORE_OK;
        const uint32_t bytes = random_below(RANDOM_BYTES);
        const uint8_t *content = new_content + random_below(NEW_BYTES - RANDOM_BYTES);
        if (there && random_below(4) == 0) {
            OK(ledger_remove(ledger, name));
        } else if (there && size + bytes <= LEDGER_BYTES && random_below(3) == 0) {
            ledger_open(ledger, &file, name, STORE_APPEND);
            ledger_append(ledger, &file, name, content, bytes);
            ledger_close(ledger, &file, name);
        } else {
            OK(ledger_replace(ledger, name, content, bytes));
        }
    }
}

static void nothing(ledger_t *ledger) { (void)ledger; }

/* Filled to the last block by somebody's uploads; what has to be written is refused or goes in. */
static void prepare_full(ledger_t *ledger) {
    OK(ledger_replace(ledger, "/learned.bin", old_content, OLD_BYTES));
    OK(ledger_replace(ledger, "/counter.bin", old_content, 16));
    char path[] = "/trials/0010.ulg";
    OK(store_open(ledger->store, &file, path, STORE_WRITE_NEW));
    store_result_t result = STORE_OK;
    uint32_t bytes = 0;
    while (result == STORE_OK && bytes < MOCK_FLASH_BYTES) {
        result = store_append(ledger->store, &file, new_content, 2000);
        bytes += 2000u;
    }
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE, result);
    (void)store_close(ledger->store, &file);
}

static void work_when_full(ledger_t *ledger) {
    (void)ledger_replace(ledger, "/learned.bin", new_content, NEW_BYTES);
    OK(ledger_replace(ledger, "/counter.bin", new_content, 16));
    OK(ledger_replace(ledger, "/learned.bin", new_content, OLD_BYTES));
}

static const power_cuts_t scenarios[] = {
    {"first boot", NULL, nothing},
    {"replace", prepare, replace},
    {"upload", prepare, upload},
    {"append", prepare, append},
    {"trial log", prepare, trial_log},
    {"make space", prepare_trials, make_space},
    {"random operations", prepare, random_operations},
    {"full", prepare_full, work_when_full},
};
#define SCENARIOS (sizeof scenarios / sizeof scenarios[0])

static uint32_t writes_of[SCENARIOS];

static bool is_aged(size_t s) {
    return scenarios[s].prepare == prepare && scenarios[s].body != random_operations;
}

static uint32_t aged_last(size_t s) { return is_aged(s) ? ages - 1u : 0u; }

static void test_a_cut_at_every_write(void) {
    know_the_log();
    for (size_t s = 0; s < SCENARIOS; s++) {
        const bool aged = is_aged(s);
        for (age = 0; age < (aged ? ages : 1u); age++) {
            writes_of[s] = power_cuts_linear(&scenarios[s]);
        }
    }
}

static void test_pairs_of_cuts(void) {
    const uint32_t pairs = from_environment("STORE_CUT_PAIRS", ON_TARGET ? 20u : 200u);
    const uint32_t seed = from_environment("STORE_CUT_SEED", 1);
    uint32_t all = 0, before = 0;
    know_the_log();
    for (size_t s = 0; s < SCENARIOS; s++) {
        all += writes_of[s];
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, all);
    for (size_t s = 0; s < SCENARIOS; s++) {
        const uint32_t first = (uint32_t)((uint64_t)pairs * before / all);
        before += writes_of[s];
        const uint32_t last = (uint32_t)((uint64_t)pairs * before / all);
        age = aged_last(s);
        power_cuts_pairs(&scenarios[s], writes_of[s], last - first, seed);
    }
    printf("%u pairs of cuts, seed %u\n", (unsigned)pairs, (unsigned)seed);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_cut_at_every_write);
    RUN_TEST(test_pairs_of_cuts);
    return UNITY_END();
}
