#include "store/trial_log.h"

#include "mock_hal.h"
#include "store/bytes.h"
#include "store/log_reader.h"
#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define TRIAL 42u
#define START_US 10000000u
#define LOOP_US 20000u
#define BEAT_US 1000000u
#define SLOT_US 100000u
#define FILE_MAX_BYTES 32768u

static hal_t hal;
static store_t store;
static params_t params;
static trial_log_t log_;
static uint8_t stored[FILE_MAX_BYTES], content[FILE_MAX_BYTES];
static uint32_t stored_bytes, content_bytes;

static const trial_log_header_t header = {.trial = TRIAL,
                                          .iteration = 3,
                                          .beats = 40,
                                          .reference_crc = 0xCAFEF00Du,
                                          .input = "uploaded",
                                          .beat_s = 1.0f,
                                          .start_us = START_US,
                                          .build_id = "1.0.0-12-gabcdef0",
                                          .board = "simulated",
                                          .unique_id = "mocked-board-00"};

void setUp(void) {
    mock_hal_init(&hal);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    params_reset(&params);
}

void tearDown(void) { store_unmount(&store); }

static uint32_t worst_pages;
static void log_slot_and_beat(uint64_t now_us, uint32_t step_in_swim) {
    const uint64_t in_swim_us = (uint64_t)step_in_swim * LOOP_US;
    if (in_swim_us % SLOT_US == 0) {
        const speed_slot_t slot = {.index = (uint16_t)(in_swim_us / SLOT_US),
                                   .samples = 2,
                                   .at_ms = 50,
                                   .speed_m_s = 0.0791f,
                                   .sigma_10um_s = 70,
                                   .gain_10um_s = -3,
                                   .way_um = 40};
        trial_log_slot(&log_, now_us, &slot, -1234);
    }
    if (in_swim_us % BEAT_US == 0) {
        const uint16_t beat = (uint16_t)(in_swim_us / BEAT_US);
        const trial_log_beat_t row = {.beat = beat,
                                      .amplitude_rad = 0.01f * (float)beat,
                                      .applied_rad = 0.005f * (float)beat,
                                      .reference_m_s = 0.0791f,
                                      .speed = {.speed_m_s = NAN, .sigma_m_s = NAN, .samples = 0}};
        trial_log_beat(&log_, now_us, &row);
        trial_log_battery(&log_, now_us, 7412);
    }
}

static void swim(uint16_t beats) {
    trial_log_header_t mine = header;
    mine.beats = beats;
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &mine, &params));
    const estimate_rest_t before = {.begin_s = -10.0f, .still_s = 10.0f};
    const estimate_rest_t after = {.begin_s = (float)beats, .still_s = 10.0f};
    const estimate_rest_t none = {0};
    trial_log_rest(&log_, START_US, &before);
    trial_log_rest(&log_, START_US, &none);
    worst_pages = 0;
    const uint32_t steps = (uint32_t)beats * BEAT_US / LOOP_US;
    for (uint32_t step = 0; step < steps; step++) {
        const uint64_t now_us = START_US + (uint64_t)step * LOOP_US;
        const uint32_t before = hal.flash_writes;
        log_slot_and_beat(now_us, step);
        trial_log_poll(&log_, now_us);
        const uint32_t pages = hal.flash_writes - before;
        worst_pages = pages > worst_pages ? pages : worst_pages;
    }
    trial_log_rest(&log_, START_US + (uint64_t)beats * BEAT_US, &after);
    trial_log_text(&log_, START_US + (uint64_t)beats * BEAT_US, "settled");
    trial_log_end(&log_, START_US + (uint64_t)beats * BEAT_US, FAULT_NONE, beats);
}

/* The file, and the ULog it holds. */
static void load(void) {
    char path[STORE_PATH_BYTES];
    bool damaged = true;
    trial_log_path(TRIAL, path);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_size(&store, path, &stored_bytes));
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(FILE_MAX_BYTES, stored_bytes);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_load(&store, path, stored, stored_bytes));
    content_bytes = (uint32_t)unpacker_all(stored, stored_bytes, content, sizeof content, &damaged);
    TEST_ASSERT_TRUE(unpacker_knows(stored) && !damaged);
    TEST_ASSERT_EQUAL_UINT32(TRIAL, bytes_get_u32(stored + PACKED_MAGIC_BYTES));
    log_info_t info;
    TEST_ASSERT_EQUAL_INT(STORE_OK, log_info(&store, path, &info));
    TEST_ASSERT_TRUE(info.packed);
    TEST_ASSERT_EQUAL_UINT32(content_bytes, info.ulog_bytes);
}

/* Number of messages of |type| (data: with |id|); fails unless the file ends with a whole message.
 * |last| receives the position of the last one. */
static uint32_t count_messages(char type, int id, uint32_t *last) {
    uint32_t count = 0;
    uint32_t at = 16;
    while (at < content_bytes) {
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(content_bytes, at + 3u);
        if (content[at + 2] == (uint8_t)type && (id < 0 || bytes_get_u16(content + at + 3) == id)) {
            count++;
            *last = at + 3u;
        }
        at += 3u + bytes_get_u16(content + at);
    }
    TEST_ASSERT_EQUAL_UINT32(content_bytes, at);
    return count;
}

static void test_paths(void) {
    char path[STORE_PATH_BYTES];
    trial_log_path(7, path);
    TEST_ASSERT_EQUAL_STRING("/trials/0007.ulg", path);
    trial_log_path(12345, path);
    TEST_ASSERT_EQUAL_STRING("/trials/12345.ulg", path);
    trial_log_path(UINT32_MAX, path);
    TEST_ASSERT_EQUAL_STRING("/trials/4294967295.ulg", path);
}

static void test_header_and_definitions(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &header, &params));
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    const uint8_t wanted[] = {0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35, 1,
                              0x80, 0x96, 0x98, 0,    0,    0,    0,    0};
    TEST_ASSERT_EQUAL_MEMORY(wanted, content, sizeof wanted);
    const uint8_t flags[43] = {40, 0, 'B'};
    TEST_ASSERT_EQUAL_MEMORY(flags, content + 16, sizeof flags);
    uint32_t at = 0;
    TEST_ASSERT_EQUAL_UINT32(5, count_messages('F', -1, &at));
    TEST_ASSERT_EQUAL_UINT32(11, count_messages('I', -1, &at));
    TEST_ASSERT_EQUAL_UINT32(PARAM_COUNT, count_messages('P', -1, &at));
    TEST_ASSERT_EQUAL_UINT32(5, count_messages('A', -1, &at));
    TEST_ASSERT_EQUAL_UINT32(0, count_messages('D', -1, &at));
}

static void test_data_bytes(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &header, &params));
    const speed_slot_t slot = {.index = 0x0102,
                               .samples = 3,
                               .at_ms = 99,
                               .speed_m_s = 0.5f,
                               .sigma_10um_s = 0x0405,
                               .gain_10um_s = -2,
                               .way_um = 0x0607};
    const speed_slot_t empty = {.index = 0x0103, .gain_10um_s = SPEED_NO_MOTION};
    trial_log_slot(&log_, 0x0807060504030201u, &slot, -3);
    trial_log_slot(&log_, 0x0807060504030201u, &empty, SPEED_NO_MOTION);
    trial_log_slot(&log_, 0x0807060504030201u, &empty, 7);
    trial_log_end(&log_, 9, FAULT_TILT, 17);
    char text[100];
    memset(text, 'x', sizeof text - 1u);
    text[sizeof text - 1u] = '\0';
    trial_log_text(&log_, 9, text);
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    uint32_t at = 0;
    TEST_ASSERT_EQUAL_UINT32(1, count_messages('D', 0, &at));
    const uint8_t wanted[] = {0,    0, 1, 2, 3, 4,    5,    6, 7, 8,    0,    0, 0,
                              0x3F, 2, 1, 5, 4, 0xFE, 0xFF, 7, 6, 0xFD, 0xFF, 3, 99};
    TEST_ASSERT_EQUAL_MEMORY(wanted, content + at, sizeof wanted);
    TEST_ASSERT_EQUAL_UINT32(1, count_messages('D', 3, &at));
    const uint8_t end[] = {3, 0, 9, 0, 0, 0, 0, 0, 0, 0, 4, 0, 17, 0};
    TEST_ASSERT_EQUAL_MEMORY(end, content + at, sizeof end);
    TEST_ASSERT_EQUAL_UINT32(1, count_messages('L', -1, &at));
    TEST_ASSERT_EQUAL_UINT8('6', content[at]);
    TEST_ASSERT_EQUAL_UINT32(at + 9u + TRIAL_LOG_TEXT_BYTES, content_bytes);
}

static void export_log(void) {
    const char *path = getenv("TRIAL_LOG_OUT");
    if (path != NULL) {
        FILE *out = fopen(path, "wb");
        TEST_ASSERT_NOT_NULL(out);
        TEST_ASSERT_EQUAL_UINT(content_bytes, fwrite(content, 1, content_bytes, out));
        fclose(out);
    }
}

static void test_a_whole_trial_and_its_upload(void) {
    const uint32_t writes = hal.flash_writes;
    swim(40);
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    uint32_t at = 0;
    TEST_ASSERT_EQUAL_UINT32(400, count_messages('D', 0, &at));
    TEST_ASSERT_EQUAL_UINT32(40, count_messages('D', 1, &at));
    TEST_ASSERT_EQUAL_UINT32(1, count_messages('D', 3, &at));
    TEST_ASSERT_EQUAL_UINT32(2, count_messages('D', 4, &at));
    printf("40 beats: %u bytes of ULog in %u, %u page writes, at most %u in one pass, bound %u\n",
           (unsigned)content_bytes, (unsigned)stored_bytes, (unsigned)(hal.flash_writes - writes),
           (unsigned)worst_pages, (unsigned)trial_log_size_bound(40, 46));
    /* The longest pause is 100 ms, and a page may take 10. */
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(10, worst_pages);

    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_reopen(&log_, &store, TRIAL));
    for (uint16_t k = 0; k < 40; k++) {
        const trial_log_beat_t row = {.beat = k,
                                      .amplitude_rad = 0.01f * (float)k,
                                      .applied_rad = 0.005f * (float)k,
                                      .reference_m_s = 0.0791f,
                                      .speed = {.speed_m_s = 0.001f * (float)k,
                                                .sigma_m_s = 0.0007f,
                                                .samples = 25,
                                                .measured = true}};
        trial_log_beat(&log_, START_US + 60000000u, &row);
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    TEST_ASSERT_EQUAL_UINT32(80, count_messages('D', 1, &at));
    TEST_ASSERT_EQUAL_UINT16(39, bytes_get_u16(content + at + 30));
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(20530, trial_log_size_bound(40, 46));
    TEST_ASSERT_EQUAL_UINT32(0, store.failures);
    export_log();
}

static void test_what_was_synced_survives_a_cut_and_can_be_appended_to(void) {
    swim(13);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_reopen(&log_, &store, TRIAL));
    trial_log_battery(&log_, 1, 8000);
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    uint32_t at = 0;
    TEST_ASSERT_EQUAL_UINT32(101, count_messages('D', 0, &at)); /* up to 10 s */
    TEST_ASSERT_EQUAL_UINT32(12, count_messages('D', 2, &at));
}

static uint32_t random_state = 1;
static uint32_t random_u32(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return random_state ^ random_state >> 15;
}

static float any_f32(void) {
    uint8_t bytes[4];
    (void)bytes_put_u32(bytes, random_u32());
    return bytes_get_f32(bytes);
}

static void log_noise_beats(uint64_t now_us, uint16_t beats) {
    for (uint16_t k = 0; k < beats; k++) {
        const trial_log_beat_t row = {.beat = (uint16_t)random_u32(),
                                      .amplitude_rad = any_f32(),
                                      .applied_rad = any_f32(),
                                      .reference_m_s = any_f32(),
                                      .speed = {.speed_m_s = any_f32(),
                                                .sigma_m_s = any_f32(),
                                                .samples = (uint16_t)random_u32()}};
        trial_log_beat(&log_, now_us + random_u32() % 1000000u, &row);
    }
}

/* Values that no sensor gives, by a clock that is old and unsteady: packed they take the most. */
static void log_noise(uint64_t start_us, uint16_t beats, uint32_t duration_s) {
    static const char text[] = "0123456789012345678901234567890123456789012345678901234567890";
    const estimate_rest_t rest = {any_f32(), 1.0f, any_f32()};
    for (uint32_t step = 0; step < duration_s * 10u; step++) {
        const uint64_t now_us = start_us + step * SLOT_US;
        const speed_slot_t slot = {.index = (uint16_t)random_u32(),
                                   .samples = (uint8_t)(1u + random_u32() % 255u),
                                   .at_ms = (uint8_t)random_u32(),
                                   .speed_m_s = any_f32(),
                                   .sigma_10um_s = (uint16_t)random_u32(),
                                   .gain_10um_s = (int16_t)random_u32(),
                                   .way_um = (int16_t)random_u32()};
        trial_log_slot(&log_, now_us + random_u32() % 90000u, &slot, (int16_t)random_u32());
        if (step % 10u == 0) {
            trial_log_battery(&log_, now_us + random_u32() % 90000u, (uint16_t)random_u32());
        }
        for (uint32_t poll = 0; poll < 3u; poll++) {
            trial_log_poll(&log_, now_us);
        }
    }
    trial_log_rest(&log_, start_us, &rest);
    trial_log_rest(&log_, start_us, &rest);
    for (uint32_t i = 0; i < TRIAL_LOG_TEXTS; i++) {
        trial_log_text(&log_, start_us, text);
    }
    log_noise_beats(start_us, beats);
    trial_log_end(&log_, start_us + random_u32(), FAULT_TILT, beats);
}

static void test_no_file_is_longer_than_its_bound(void) {
    static const uint16_t lengths[] = {1, 5, 20, 40};
    for (uint32_t i = 0; i < 12u; i++) {
        const uint16_t beats = lengths[i % 4u];
        const uint32_t duration_s = beats + 6u;
        trial_log_header_t mine = header;
        mine.beats = beats;
        mine.start_us = START_US + ((uint64_t)random_u32() << i);
        for (param_t p = (param_t)0; p < PARAM_COUNT; p++) {
            params.value[p] = any_f32();
        }
        TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &mine, &params));
        log_noise(mine.start_us, beats, duration_s);
        TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
        TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_reopen(&log_, &store, TRIAL));
        log_noise_beats(mine.start_us, beats);
        TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
        load();
        const uint32_t bound = trial_log_size_bound(beats, duration_s);
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(bound, stored_bytes);
        TEST_ASSERT_GREATER_THAN_UINT32(beats < 20u ? 0u : bound * 3u / 5u, stored_bytes);
    }
}

/* What firmware that did not pack left is appended to as it is. */
static void test_an_old_log_stays_ulog(void) {
    char path[STORE_PATH_BYTES];
    trial_log_path(TRIAL, path);
    swim(5);
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, path, content, content_bytes));
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_reopen(&log_, &store, TRIAL));
    trial_log_battery(&log_, 1, 8000);
    trial_log_battery(&log_, 2, 8000);
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    log_info_t info;
    TEST_ASSERT_EQUAL_INT(STORE_OK, log_info(&store, path, &info));
    TEST_ASSERT_FALSE(info.packed);
    const uint32_t before = content_bytes;
    content_bytes = info.ulog_bytes;
    TEST_ASSERT_EQUAL_UINT32(before + 2u * 17u, content_bytes);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_load(&store, path, content, content_bytes));
    uint32_t at = 0;
    TEST_ASSERT_EQUAL_UINT32(7, count_messages('D', 2, &at));
}

static void test_a_failing_flash_ends_the_log_only(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &header, &params));
    hal.flash_fail_after = hal.flash_writes;
    for (uint32_t step = 0; step < 1000; step++) {
        log_slot_and_beat(START_US + step * LOOP_US, step);
        trial_log_poll(&log_, START_US + step * LOOP_US);
    }
    TEST_ASSERT_TRUE(log_.failed);
    TEST_ASSERT_EQUAL_UINT32(1, store.failures);
    trial_log_end(&log_, 1, FAULT_NONE, 40);
    TEST_ASSERT_EQUAL_INT(STORE_IO, trial_log_close(&log_));
    TEST_ASSERT_EQUAL_INT(STORE_IO, trial_log_close(&log_));
}

static void test_begin_on_a_dead_or_unmounted_store(void) {
    hal.flash_fail_after = hal.flash_writes;
    TEST_ASSERT_NOT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &header, &params));
    trial_log_poll(&log_, START_US);
    TEST_ASSERT_EQUAL_INT(STORE_IO, trial_log_close(&log_));
    store_unmount(&store);
    TEST_ASSERT_EQUAL_INT(STORE_IO, trial_log_begin(&log_, &store, &header, &params));
    log_slot_and_beat(START_US, 0);
    TEST_ASSERT_EQUAL_INT(STORE_IO, trial_log_close(&log_));
}

static void test_reopen_without_a_file(void) {
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, trial_log_reopen(&log_, &store, 9));
    trial_log_battery(&log_, 1, 8000);
    TEST_ASSERT_EQUAL_INT(STORE_IO, trial_log_close(&log_));
}

static void test_many_records_between_two_polls(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_begin(&log_, &store, &header, &params));
    for (uint32_t i = 0; i < 500; i++) {
        trial_log_battery(&log_, i, 8000);
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, trial_log_close(&log_));
    load();
    uint32_t at = 0;
    TEST_ASSERT_EQUAL_UINT32(500, count_messages('D', 2, &at));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_paths);
    RUN_TEST(test_header_and_definitions);
    RUN_TEST(test_data_bytes);
    RUN_TEST(test_a_whole_trial_and_its_upload);
    RUN_TEST(test_what_was_synced_survives_a_cut_and_can_be_appended_to);
    RUN_TEST(test_no_file_is_longer_than_its_bound);
    RUN_TEST(test_an_old_log_stays_ulog);
    RUN_TEST(test_a_failing_flash_ends_the_log_only);
    RUN_TEST(test_begin_on_a_dead_or_unmounted_store);
    RUN_TEST(test_reopen_without_a_file);
    RUN_TEST(test_many_records_between_two_polls);
    return UNITY_END();
}
