/*
 * The power cut at every single page write. A cut leaves the flash as it was after k whole pages,
 * and page k + 1 untouched, erased, half written over the old content, or half written and half
 * erased. After each cut a fresh store is mounted on those bytes.
 */
#include "mock_hal.h"
#include "store/trial_log.h"
#include "target.h"
#include "unity.h"

#include <stdio.h>
#include <string.h>

#define CUTS_MAX 400u
#define OLD_BYTES 700u
#define NEW_BYTES 4128u
#define LOG_BYTES_MAX 8192u
#define PAGE HAL_FLASH_PAGE_BYTES
#define TORN_KINDS 5u
#define TORN_EARLY_BYTES 20u /* holds a superblock's magic, but not its CRC */
#define AGES 8u

typedef void scenario_t(store_t *store);
typedef void check_t(store_t *store, bool finished);

static hal_t hal;
static store_t store;
static trial_log_t log_;
static params_t params;
static uint8_t old_content[OLD_BYTES], new_content[NEW_BYTES], back[LOG_BYTES_MAX];
static uint8_t whole_log[LOG_BYTES_MAX];
static uint32_t whole_log_bytes, free_at_end;
static uint8_t start[HAL_FLASH_SIZE_BYTES], after_cut[HAL_FLASH_SIZE_BYTES];
static uint8_t one_page_more[HAL_FLASH_SIZE_BYTES];
static bool may_format;

void setUp(void) {
    mock_hal_init(&hal);
    params_reset(&params);
    may_format = false;
    for (size_t i = 0; i < NEW_BYTES; i++) {
        new_content[i] = (uint8_t)(i * 7u + i / 256u);
        old_content[i % OLD_BYTES] = (uint8_t)~new_content[i % OLD_BYTES];
    }
}

void tearDown(void) {}

/* Runs |scenario| from |start| with the power cut after |pages| writes (0 < pages); the flash stays
 * in hal.flash. True when it came to its end before the cut. */
static bool run(scenario_t *scenario, uint32_t pages) {
    memcpy(hal.flash, start, sizeof start);
    hal.flash_writes = 1; /* a limit of 0 would mean none */
    hal.flash_fail_after = 1u + pages;
    scenario(&store);
    const bool finished = hal.flash_writes < hal.flash_fail_after;
    hal.flash_fail_after = 0;
    return finished;
}

/* Puts what the cut page may hold into the flash; false when the cut page did not change. */
static bool tear_page(unsigned kind) {
    for (uint32_t at = 0; at < HAL_FLASH_SIZE_BYTES; at += PAGE) {
        if (memcmp(after_cut + at, one_page_more + at, PAGE) != 0) {
            memcpy(hal.flash + at, after_cut + at, PAGE);
            if (kind == 1u || kind >= 3u) {
                memset(hal.flash + at, 0xFF, PAGE);
            }
            if (kind >= 2u) {
                memcpy(hal.flash + at, one_page_more + at,
                       kind == 4u ? TORN_EARLY_BYTES : PAGE / 2u);
            }
            return true;
        }
    }
    return false;
}

static void check_after_cut(check_t *check, bool finished) {
    memset(&store, 0xCD, sizeof store);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    TEST_ASSERT_TRUE(may_format || !store.formatted);
    check(&store, finished);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/after", "x", 1));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_remove(&store, "/after"));
    store_unmount(&store);
}

static uint32_t cut_everywhere(scenario_t *scenario, check_t *check) {
    memcpy(start, hal.flash, sizeof start);
    bool finished = false;
    uint32_t cut = 0;
    for (; !finished; cut++) {
        TEST_ASSERT_LESS_THAN_UINT32(CUTS_MAX, cut);
        (void)run(scenario, cut + 1u);
        memcpy(one_page_more, hal.flash, sizeof one_page_more);
        finished = run(scenario, cut);
        memcpy(after_cut, hal.flash, sizeof after_cut);
        for (unsigned kind = 0; kind < TORN_KINDS; kind++) {
            memcpy(hal.flash, after_cut, sizeof after_cut);
            if (kind == 0u || tear_page(kind)) {
                check_after_cut(check, finished);
            }
        }
    }
    return cut - 1u;
}

static bool holds(store_t *s, const char *path, const uint8_t *wanted, size_t length) {
    return store_load(s, path, back, length) == STORE_OK && memcmp(back, wanted, length) == 0;
}

/* A filesystem with two files. |age| replaces before it put the cuts at every point of the life of
 * a metadata block, which is compacted after seven or fewer commits. */
static void prepare(uint32_t age) {
    mock_hal_init(&hal);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    for (uint32_t n = 0; n < age; n++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/small", &n, sizeof n));
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/trials/0001.ulg", &n, sizeof n));
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/learned.bin", old_content, OLD_BYTES));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/small", old_content, 100));
    store_unmount(&store);
}

static void replace_once(store_t *s) {
    (void)store_mount(s, &hal);
    (void)store_replace(s, "/learned.bin", new_content, NEW_BYTES);
    (void)store_replace(s, "/small", new_content, 120);
    (void)store_replace(s, "/fresh", new_content, 600);
}

static void old_or_new(store_t *s, bool finished) {
    const bool is_old = holds(s, "/learned.bin", old_content, OLD_BYTES);
    const bool is_new = holds(s, "/learned.bin", new_content, NEW_BYTES);
    const bool small_old = holds(s, "/small", old_content, 100);
    const bool small_new = holds(s, "/small", new_content, 120);
    TEST_ASSERT_TRUE(is_old || is_new);
    TEST_ASSERT_TRUE(small_old || small_new);
    TEST_ASSERT_TRUE(is_new || small_old); /* in the order of writing */
    uint32_t size = 0;
    const bool fresh = store_size(s, "/fresh", &size) == STORE_OK;
    TEST_ASSERT_TRUE(!fresh || holds(s, "/fresh", new_content, 600));
    TEST_ASSERT_TRUE(small_new || !fresh);
    TEST_ASSERT_TRUE(!finished || (is_new && small_new && fresh));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_size(s, "/learned.bin.new", &size));
    /* What the cut left half written takes no room. */
    const uint32_t blocks_less = (is_new ? 0u : 2u) + (fresh ? 0u : 1u);
    TEST_ASSERT_EQUAL_UINT32(free_at_end + blocks_less * STORE_BLOCK_BYTES, store_free_bytes(s));
}

static void test_replace(void) {
    uint32_t cuts = 0;
    for (uint32_t age = 0; age < AGES; age++) {
        prepare(age);
        memcpy(start, hal.flash, sizeof start);
        replace_once(&store);
        free_at_end = store_free_bytes(&store);
        memcpy(hal.flash, start, sizeof start);
        cuts += cut_everywhere(replace_once, old_or_new);
    }
    printf("replace: %u cuts\n", (unsigned)cuts);
}

static void swim_once(store_t *s) {
    static const trial_log_header_t header = {
        .trial = 3, .beats = 5, .start_us = 1000000u, .build_id = "1.0.0", .board = "simulated"};
    (void)store_mount(s, &hal);
    (void)trial_log_begin(&log_, s, &header, &params);
    for (uint32_t step = 0; step <= 60; step++) {
        const uint64_t now_us = 1000000u + step * 100000u;
        const speed_slot_t slot = {.index = (uint16_t)step, .samples = 2, .at_ms = 50};
        const trial_log_beat_t beat = {.beat = (uint16_t)(step / 10u)};
        trial_log_slot(&log_, now_us, &slot);
        if (step % 10u == 0u && step < 50u) {
            trial_log_beat(&log_, now_us, &beat);
        }
        trial_log_poll(&log_, now_us);
    }
    trial_log_end(&log_, 7000000u, FAULT_NONE, 5);
    (void)trial_log_close(&log_);
}

/* Nothing but a beginning of the log that ends with a sync may be seen, and all else is untouched.
 */
static void whole_beginning(store_t *s, bool finished) {
    TEST_ASSERT_TRUE(holds(s, "/learned.bin", old_content, OLD_BYTES));
    TEST_ASSERT_TRUE(holds(s, "/small", old_content, 100));
    uint32_t size = 0;
    const store_result_t found = store_size(s, "/trials/0003.ulg", &size);
    if (found == STORE_NOT_FOUND && !finished) {
        return;
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, found);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(whole_log_bytes, size);
    TEST_ASSERT_TRUE(!finished || size == whole_log_bytes);
    TEST_ASSERT_TRUE(holds(s, "/trials/0003.ulg", whole_log, size));
    uint32_t at = 16;
    while (at < size) {
        at += 3u + (uint32_t)(whole_log[at] | whole_log[at + 1u] << 8);
    }
    TEST_ASSERT_EQUAL_UINT32(size, at);
}

static void test_trial_log(void) {
    uint32_t cuts = 0;
    for (uint32_t age = 0; age < AGES; age++) {
        prepare(age);
        memcpy(start, hal.flash, sizeof start);
        swim_once(&store);
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_size(&store, "/trials/0003.ulg", &whole_log_bytes));
        TEST_ASSERT_EQUAL_INT(STORE_OK,
                              store_load(&store, "/trials/0003.ulg", whole_log, whole_log_bytes));
        memcpy(hal.flash, start, sizeof start);
        cuts += cut_everywhere(swim_once, whole_beginning);
    }
    printf("trial log: %u cuts\n", (unsigned)cuts);
}

static void mount_once(store_t *s) { (void)store_mount(s, &hal); }

static void both_folders(store_t *s, bool finished) {
    store_entry_t entry;
    TEST_ASSERT_TRUE(!finished || !s->formatted);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_entry(s, "/", 1, &entry));
    TEST_ASSERT_EQUAL_STRING("trials", entry.name);
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_entry(s, "/", 2, &entry));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_entry(s, "/in", 0, &entry));
    TEST_ASSERT_EQUAL_UINT32(HAL_FLASH_SIZE_BYTES - 6u * STORE_BLOCK_BYTES, store_free_bytes(s));
}

static void test_mount_and_format(void) {
    may_format = true;
    printf("format: %u cuts\n", (unsigned)cut_everywhere(mount_once, both_folders));
}

/* Removing trials to make room, and the compaction after it. */
static void make_space_once(store_t *s) {
    (void)store_mount(s, &hal);
    (void)store_make_space(s, HAL_FLASH_SIZE_BYTES - 14u * STORE_BLOCK_BYTES - STORE_RESERVE_BYTES,
                           2);
}

static void kept_files(store_t *s, bool finished) {
    uint32_t size = 0;
    TEST_ASSERT_TRUE(holds(s, "/learned.bin", old_content, OLD_BYTES));
    TEST_ASSERT_TRUE(holds(s, "/trials/0002.ulg", new_content, NEW_BYTES));
    const store_result_t first = store_size(s, "/trials/0001.ulg", &size);
    const store_result_t third = store_size(s, "/trials/0003.ulg", &size);
    TEST_ASSERT_TRUE(third == STORE_OK || first == STORE_NOT_FOUND);
    TEST_ASSERT_TRUE(!finished || first == STORE_NOT_FOUND);
}

static void test_make_space(void) {
    prepare(0);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    const char *const paths[] = {"/trials/0003.ulg", "/trials/0001.ulg", "/trials/0002.ulg"};
    for (size_t i = 0; i < 3; i++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, paths[i], new_content, NEW_BYTES));
    }
    printf("make space: %u cuts\n", (unsigned)cut_everywhere(make_space_once, kept_files));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_replace);
    RUN_ON_HOST(test_trial_log);
    RUN_TEST(test_mount_and_format);
    RUN_TEST(test_make_space);
    return UNITY_END();
}
