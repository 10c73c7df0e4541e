#include "store/store.h"

#include "base/crc.h"
#include "mock_hal.h"
#include "store_ledger.h"
#include "store_size.h"
#include "target.h"
#include "unity.h"

#include <stdlib.h>
#include <string.h>

#define MODEL_FILES 8u
#define MODEL_FILE_BYTES 3000u
#define OPERATIONS TIMES(1500u, 500u)
#define TRIAL_FILE_BYTES 15000u
#define TRIAL_FILE_BLOCKS (TRIAL_FILE_BYTES / BLOCK_BYTES + 1u)
#define TRIAL_FILES TIMES(300u, 60u)
#define FULL_ROUNDS (ON_TARGET || MOCK_FLASH_ERASES_FIRST ? 1u : 6u)

static hal_t hal;
static store_t store;
static store_file_t file;
static uint8_t bytes[TRIAL_FILE_BYTES];
static uint8_t back[TRIAL_FILE_BYTES];

static uint32_t random_state;
static uint32_t random_below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % limit;
}

static void fill_random(uint8_t *out, size_t length) {
    for (size_t i = 0; i < length; i++) {
        out[i] = (uint8_t)random_below(256);
    }
}

void setUp(void) {
    random_state = 12345u;
    mock_hal_init(&hal);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
}

void tearDown(void) { store_unmount(&store); }

static void remount(void) {
    store_unmount(&store);
    memset(&store, 0xCD, sizeof store);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
}

static void expect_content(const char *path, const void *wanted, size_t length) {
    TEST_ASSERT_EQUAL_INT_MESSAGE(STORE_OK, store_load(&store, path, back, length), path);
    if (length > 0) {
        TEST_ASSERT_EQUAL_MEMORY_MESSAGE(wanted, back, length, path);
    }
}

static void test_blank_flash_is_formatted_once(void) {
    TEST_ASSERT_TRUE(store.formatted);
    store_entry_t entry;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_entry(&store, "/", 0, &entry));
    TEST_ASSERT_EQUAL_STRING("in", entry.name);
    TEST_ASSERT_TRUE(entry.directory);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_entry(&store, "/", 1, &entry));
    TEST_ASSERT_EQUAL_STRING("trials", entry.name);
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_entry(&store, "/", 2, &entry));
    const uint32_t writes = hal.flash_writes;
    remount();
    TEST_ASSERT_FALSE(store.formatted);
    TEST_ASSERT_EQUAL_UINT32(writes, hal.flash_writes);
}

static void test_replace_load_size_crc_remove(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a.bin", "123456789", 9));
    remount();
    expect_content("/a.bin", "123456789", 9);
    uint32_t value = 0;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_size(&store, "/a.bin", &value));
    TEST_ASSERT_EQUAL_UINT32(9, value);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_crc32(&store, "/a.bin", &value));
    TEST_ASSERT_EQUAL_HEX32(0x2DFD2D88u, value);
    TEST_ASSERT_EQUAL_INT(STORE_CORRUPT, store_load(&store, "/a.bin", back, 8));
    TEST_ASSERT_EQUAL_INT(STORE_CORRUPT, store_load(&store, "/a.bin", back, 10));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_remove(&store, "/a.bin"));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_load(&store, "/a.bin", back, 9));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_size(&store, "/a.bin", &value));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_crc32(&store, "/a.bin", &value));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_remove(&store, "/a.bin"));
    TEST_ASSERT_EQUAL_UINT32(0, store.failures);
}

static void test_crc_of_a_long_file(void) {
    fill_random(bytes, sizeof bytes);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a.bin", bytes, sizeof bytes));
    uint32_t crc = 0;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_crc32(&store, "/a.bin", &crc));
    TEST_ASSERT_EQUAL_HEX32(crc32_update(0, bytes, sizeof bytes), crc);
}

static void test_bad_arguments(void) {
    char longest[STORE_PATH_BYTES + 1];
    memset(longest, 'x', sizeof longest);
    longest[0] = '/';
    longest[STORE_PATH_BYTES] = '\0';
    TEST_ASSERT_EQUAL_INT(STORE_BAD_ARGUMENT, store_replace(&store, longest, "", 0));
    TEST_ASSERT_EQUAL_INT(STORE_BAD_ARGUMENT, store_open(&store, &file, longest, STORE_WRITE_NEW));
    longest[STORE_PATH_BYTES - 4u] = '\0';
    TEST_ASSERT_EQUAL_INT(STORE_BAD_ARGUMENT, store_replace(&store, longest, "", 0));
    longest[STORE_PATH_BYTES - 5u] = '\0';
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, longest, "", 0));
    uint32_t size = 0;
    TEST_ASSERT_EQUAL_INT(STORE_BAD_ARGUMENT, store_size(&store, "/in", &size));
    TEST_ASSERT_EQUAL_INT(STORE_BAD_ARGUMENT, store_replace(&store, "/in", "x", 1));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_open(&store, &file, "/none", STORE_READ));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_open(&store, &file, "/none", STORE_APPEND));
    TEST_ASSERT_FALSE(file.open);
    store_entry_t entry;
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_entry(&store, "/none", 0, &entry));
}

static void test_nothing_works_unmounted(void) {
    store_unmount(&store);
    uint32_t value = 0;
    store_entry_t entry;
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_replace(&store, "/a", "x", 1));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_load(&store, "/a", back, 1));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_size(&store, "/a", &value));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_crc32(&store, "/a", &value));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_remove(&store, "/a"));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_entry(&store, "/", 0, &entry));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_open(&store, &file, "/a", STORE_WRITE_NEW));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_make_space(&store, 1, 0));
    TEST_ASSERT_EQUAL_UINT32(0, store_free_bytes(&store));
}

static void test_a_file_in_pieces(void) {
    fill_random(bytes, 5000);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, "/in/f", STORE_WRITE_NEW));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_append(&store, &file, bytes, 1000));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_write_at(&store, &file, 3000, bytes + 3000, 1000));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_sync(&store, &file));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_write_at(&store, &file, 900, bytes + 900, 2100));
    TEST_ASSERT_EQUAL_UINT32(4000, store_file_size(&store, &file));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, "/in/f", STORE_APPEND));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_append(&store, &file, bytes + 4000, 1000));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    expect_content("/in/f", bytes, 5000);
    size_t got = 0;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, "/in/f", STORE_READ));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_read_at(&store, &file, 4900, back, 239, &got));
    TEST_ASSERT_EQUAL_UINT(100, got);
    TEST_ASSERT_EQUAL_MEMORY(bytes + 4900, back, 100);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_read_at(&store, &file, 5000, back, 239, &got));
    TEST_ASSERT_EQUAL_UINT(0, got);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_read_at(&store, &file, UINT32_MAX, back, 239, &got));
    TEST_ASSERT_EQUAL_UINT(0, got);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_read_at(&store, &file, 17, back, 239, &got));
    TEST_ASSERT_EQUAL_MEMORY(bytes + 17, back, 239);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    static bool panicked;
    MOCK_EXPECT_PANIC(panicked, (void)store_close(&store, &file));
    TEST_ASSERT_TRUE(panicked);
}

static void test_leftovers_go_at_mount(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/keep", "1", 1));
    const char *const left[] = {"/keep.new", "/in/a.new", "/in/b.new", "/trials/0001.ulg.new"};
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, left[i], STORE_WRITE_NEW));
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    }
    remount();
    uint32_t size = 0;
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_size(&store, left[i], &size));
    }
    expect_content("/keep", "1", 1);
}

/* Random operations against a plain model, remounting in between. */
typedef struct {
    bool there;
    size_t length;
    uint8_t bytes[MODEL_FILE_BYTES];
} model_file_t;
static model_file_t model[MODEL_FILES];

static void model_name(uint32_t f, char *out) {
    strcpy(out, f % 2u == 0 ? "/in/f0" : "/f0");
    out[strlen(out) - 1] = (char)('0' + f);
}

static void append_once(uint32_t f, const char *path) {
    const size_t more = random_below(400);
    if (model[f].length + more > MODEL_FILE_BYTES) {
        return;
    }
    fill_random(model[f].bytes + model[f].length, more);
    const store_mode_t mode = model[f].there ? STORE_APPEND : STORE_WRITE_NEW;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, path, mode));
    TEST_ASSERT_EQUAL_INT(STORE_OK,
                          store_append(&store, &file, model[f].bytes + model[f].length, more));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    model[f].there = true;
    model[f].length += more;
}

static void operate_once(void) {
    const uint32_t f = random_below(MODEL_FILES);
    char path[STORE_PATH_BYTES];
    model_name(f, path);
    switch (random_below(5)) {
    case 0:
        TEST_ASSERT_EQUAL_INT(model[f].there ? STORE_OK : STORE_NOT_FOUND,
                              store_remove(&store, path));
        model[f].there = false;
        model[f].length = 0;
        break;
    case 1:
    case 2:
        model[f].there = true;
        model[f].length = random_below(MODEL_FILE_BYTES);
        fill_random(model[f].bytes, model[f].length);
        TEST_ASSERT_EQUAL_INT(STORE_OK,
                              store_replace(&store, path, model[f].bytes, model[f].length));
        break;
    case 3:
        append_once(f, path);
        break;
    default:
        if (random_below(10) == 0) {
            remount();
        }
    }
}

static void test_random_operations_against_a_model(void) {
    memset(model, 0, sizeof model);
    for (uint32_t n = 0; n < OPERATIONS; n++) {
        operate_once();
        const uint32_t f = random_below(MODEL_FILES);
        char path[STORE_PATH_BYTES];
        model_name(f, path);
        if (model[f].there) {
            expect_content(path, model[f].bytes, model[f].length);
        } else {
            uint32_t size = 0;
            TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_size(&store, path, &size));
        }
    }
    TEST_ASSERT_EQUAL_UINT32(0, store.failures);
}

static void trial_path(uint32_t number, char *out) {
    strcpy(out, "/trials/0000.ulg");
    for (size_t at = 11; at >= 8; at--, number /= 10u) {
        out[at] = (char)('0' + number % 10u);
    }
}

static uint32_t count_entries(const char *folder) {
    store_entry_t entry;
    uint32_t count = 0;
    while (store_entry(&store, folder, count, &entry) == STORE_OK) {
        count++;
    }
    return count;
}

static void swim_once(uint32_t number) {
    char path[STORE_PATH_BYTES];
    trial_path(number, path);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_make_space(&store, 20480, 0));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, path, STORE_WRITE_NEW));
    for (size_t done = 0; done < TRIAL_FILE_BYTES; done += 300) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_append(&store, &file, bytes + done, 300));
        if (done % 1500 == 0) {
            TEST_ASSERT_EQUAL_INT(STORE_OK, store_sync(&store, &file));
        }
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
}

static void test_space_does_not_leak_over_many_trials(void) {
    fill_random(bytes, sizeof bytes);
    const uint32_t free_at_first = store_free_bytes(&store);
    for (uint32_t n = 1; n <= TRIAL_FILES; n++) {
        swim_once(n);
        if (n % 37u == 0) {
            remount();
        }
    }
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(8, count_entries("/trials"));
    char path[STORE_PATH_BYTES];
    for (uint32_t n = TRIAL_FILES; n > TRIAL_FILES - 8u; n--) {
        trial_path(n, path);
        expect_content(path, bytes, TRIAL_FILE_BYTES);
    }
    for (uint32_t n = TRIAL_FILES; n > 0; n--) {
        trial_path(n, path);
        (void)store_remove(&store, path);
    }
    /* Emptied folders may keep a metadata pair. */
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(free_at_first - 2u * BLOCK_BYTES, store_free_bytes(&store));
    TEST_ASSERT_EQUAL_UINT32(0, store.failures);
}

static void test_oldest_trials_go_first_and_the_kept_one_stays(void) {
    fill_random(bytes, sizeof bytes);
    const char *const other[] = {"/learned.bin", "/params.bin", "/in/x.ulg", "/trials/notes"};
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, other[i], bytes, 600));
    }
    /* Not in their order, and one beyond four digits: the number counts, not the name. */
    const char *const trials[] = {"/trials/10000.ulg", "/trials/0007.ulg", "/trials/9999.ulg",
                                  "/trials/0003.ulg"};
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, trials[i], bytes, 15000));
    }
    uint32_t size = 0;
    uint32_t wanted = store_free_bytes(&store) - RESERVE_BYTES;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_make_space(&store, wanted, 3));
    TEST_ASSERT_EQUAL_UINT32(5, count_entries("/trials"));
    TEST_ASSERT_EQUAL_INT(
        STORE_OK, store_make_space(&store, wanted + TRIAL_FILE_BLOCKS * BLOCK_BYTES + 1u, 3));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_size(&store, "/trials/0007.ulg", &size));
    TEST_ASSERT_EQUAL_INT(STORE_NOT_FOUND, store_size(&store, "/trials/9999.ulg", &size));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_size(&store, "/trials/10000.ulg", &size));
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE, store_make_space(&store, MOCK_FLASH_BYTES, 3));
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE, store_make_space(&store, UINT32_MAX, 3));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_size(&store, "/trials/0003.ulg", &size));
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_size(&store, other[i], &size));
    }
}

/* littlefs finds free blocks by walking through all files: where that fails it knows of none. */
static void test_a_store_that_cannot_be_walked_loses_only_what_hinders_it(void) {
    fill_random(bytes, sizeof bytes);
    char path[STORE_PATH_BYTES];
    uint32_t free_bytes = 0;
    for (uint32_t n = 1; n <= 3; n++) {
        trial_path(n, path);
        free_bytes = store_free_bytes(&store);
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, path, STORE_WRITE_NEW));
        for (uint32_t done = 0; done < 3u * BLOCK_BYTES; done += TRIAL_FILE_BYTES) {
            TEST_ASSERT_EQUAL_INT(STORE_OK, store_append(&store, &file, bytes, TRIAL_FILE_BYTES));
        }
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, path, STORE_READ));
    const uint32_t last = file.file.ctz.head;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    memset(hal.flash + last * BLOCK_BYTES, 0x7F, 8); /* pointers to the blocks before it */
    store.lfs.rcache.block = UINT32_MAX; /* littlefs's last read, which may be of there */
    TEST_ASSERT_EQUAL_UINT32(0, store_free_bytes(&store));
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_make_space(&store, 20480, 0));
    TEST_ASSERT_EQUAL_UINT32(3, count_entries("/trials"));
    remount();
    TEST_ASSERT_EQUAL_UINT32(2, count_entries("/trials"));
    TEST_ASSERT_EQUAL_UINT32(free_bytes, store_free_bytes(&store));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_make_space(&store, 20480, 0));
    TEST_ASSERT_EQUAL_UINT32(2, count_entries("/trials"));
}

static void test_what_is_sent_leaves_the_board_its_blocks(void) {
    fill_random(bytes, sizeof bytes);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, "/in/f", STORE_WRITE_NEW));
    store_result_t result = STORE_OK;
    for (uint32_t at = 0; at < MOCK_FLASH_BYTES && result == STORE_OK; at += 200) {
        result = store_write_at(&store, &file, at, bytes + at % 2000, 200);
    }
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE, result);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
    const uint32_t free_blocks = store_free_bytes(&store) / BLOCK_BYTES;
    TEST_ASSERT_UINT32_WITHIN(1, STORE_OWN_BLOCKS, free_blocks);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/key.bin", bytes, 52));
}

static void test_full_flash_refuses_and_keeps_the_old(void) {
    fill_random(bytes, sizeof bytes);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/learned.bin", bytes, 4640));
    store_result_t result = STORE_OK;
    char path[] = "/in/aa";
    for (uint32_t n = 0; result == STORE_OK; n++) {
        name_upload(path, n);
        result = store_replace(&store, path, bytes, sizeof bytes);
    }
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE, result);
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE,
                          store_replace(&store, "/learned.bin", bytes + 1, sizeof bytes - 1));
    TEST_ASSERT_EQUAL_UINT32(2, store.failures);
    expect_content("/learned.bin", bytes, 4640);
    remount();
    expect_content("/learned.bin", bytes, 4640);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_remove(&store, "/in/aa"));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/learned.bin", bytes + 1, 4640));
}

/* Filled by logs of all sizes and by uploads that nobody removes: what the next trial needs still
 * finds room, the oldest trials go first, and what cannot be made room for is refused. */
static void fill_with_uploads(uint32_t leave_blocks) {
    char path[] = "/in/aa";
    for (uint32_t n = 0; store_free_bytes(&store) > leave_blocks * BLOCK_BYTES; n++) {
        name_upload(path, n);
        const uint32_t free_bytes = store_free_bytes(&store) - leave_blocks * BLOCK_BYTES;
        uint32_t length = 1u + random_below(TRIAL_FILE_BYTES - 1u);
        length = length < free_bytes ? length : free_bytes / 2u + 1u;
        if (store_replace(&store, path, bytes, length) != STORE_OK) {
            return;
        }
    }
}

static void expect_room_for_what_must_be_kept(void) {
    static const size_t lengths[] = {16, 53, 4640, 6172, 900, 16, 4640};
    static const char *const paths[] = {"/counter.bin", "/key.bin",    "/learned.bin",
                                        "/pending.bin", "/params.bin", "/counter.bin",
                                        "/learned.bin"};
    for (size_t i = 0; i < sizeof paths / sizeof paths[0]; i++) {
        TEST_ASSERT_EQUAL_INT_MESSAGE(STORE_OK, store_replace(&store, paths[i], bytes, lengths[i]),
                                      paths[i]);
        expect_content(paths[i], bytes, lengths[i]);
    }
}

static bool is_there(uint32_t trial) {
    char path[STORE_PATH_BYTES];
    uint32_t size = 0;
    trial_path(trial, path);
    return store_size(&store, path, &size) == STORE_OK;
}

static void write_trial(uint32_t trial, uint32_t length) {
    char path[STORE_PATH_BYTES];
    trial_path(trial, path);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_open(&store, &file, path, STORE_WRITE_NEW));
    for (uint32_t done = 0; done < length; done += 500u) {
        const uint32_t piece = length - done < 500u ? length - done : 500u;
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_append(&store, &file, bytes + done, piece));
        if (random_below(4) == 0) {
            TEST_ASSERT_EQUAL_INT(STORE_OK, store_sync(&store, &file));
        }
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_close(&store, &file));
}

static void test_a_store_filled_to_the_last_block(void) {
    for (uint32_t round = 0; round < FULL_ROUNDS; round++) {
        random_state = 77u + round;
        mock_hal_init(&hal);
        remount();
        fill_random(bytes, sizeof bytes);
        expect_room_for_what_must_be_kept();
        fill_with_uploads(TRIAL_FILE_BLOCKS > 1u ? 30u + random_below(60) : 12u + random_below(20));
        uint32_t oldest = 1;
        for (uint32_t trial = 1; trial <= 40; trial++) {
            const uint32_t length = 1u + random_below(TRIAL_FILE_BYTES - 1u);
            TEST_ASSERT_EQUAL_INT(STORE_OK, store_make_space(&store, length, 0));
            write_trial(trial, length);
            expect_room_for_what_must_be_kept();
            while (!is_there(oldest)) {
                oldest++;
            }
            for (uint32_t kept = oldest; kept <= trial; kept++) {
                TEST_ASSERT_TRUE_MESSAGE(is_there(kept), "not the oldest went");
            }
        }
        TEST_ASSERT_GREATER_THAN_UINT32(1, oldest);
        TEST_ASSERT_EQUAL_UINT32(0, store.failures);
        TEST_ASSERT_EQUAL_INT32(0, ledger_lost_blocks(&store));
        /* Uploads alone: no trial is left to go, so it is said. */
        fill_with_uploads(0);
        TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE,
                              store_make_space(&store, MOCK_FLASH_BYTES / 4u * 3u, 0));
        TEST_ASSERT_FALSE(is_there(40));
        expect_content("/learned.bin", bytes, 4640);
    }
}

static void test_dead_flash_is_reported(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a", "old", 3));
    hal.flash_fail_after = hal.flash_writes;
    TEST_ASSERT_EQUAL_INT(STORE_IO, store_replace(&store, "/a", "new", 3));
    TEST_ASSERT_EQUAL_UINT32(1, store.failures);
    TEST_ASSERT_TRUE(store_take_damage(&store));
    TEST_ASSERT_FALSE(store_take_damage(&store));
    expect_content("/a", "old", 3);
}

static bool fail_one_page(hal_t *board, uint32_t offset, const uint8_t *page) {
    if (board->flash_context != NULL) {
        board->flash_context = NULL;
        return false;
    }
    memcpy(board->flash + offset, page, STORE_PAGE_BYTES);
    return true;
}

static void test_one_bad_page_is_no_damage(void) {
    hal.flash_write = fail_one_page;
    hal.flash_context = &hal;
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a", bytes, 4640));
    TEST_ASSERT_NULL(hal.flash_context);
    TEST_ASSERT_FALSE(store_take_damage(&store));
    if (sizeof bytes <= BLOCK_BYTES) {
        return;
    }
    /* Nor when the store is full all the same. */
    char path[] = "/in/aa";
    for (uint32_t n = 0; store_free_bytes(&store) >= sizeof bytes; n++) {
        name_upload(path, n);
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, path, bytes, sizeof bytes));
    }
    hal.flash_context = &hal;
    TEST_ASSERT_EQUAL_INT(STORE_NO_SPACE, store_replace(&store, "/b", bytes, sizeof bytes));
    TEST_ASSERT_NULL(hal.flash_context);
    TEST_ASSERT_FALSE(store_take_damage(&store));
}

static void test_garbage_is_formatted(void) {
    store_unmount(&store);
    const uint8_t patterns[] = {0x00, 0xFF, 0x5A};
    for (size_t i = 0; i < sizeof patterns; i++) {
        memset(hal.flash, patterns[i], sizeof hal.flash);
        TEST_ASSERT_EQUAL_INT(STORE_CORRUPT, store_find(&store, &hal));
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
        TEST_ASSERT_TRUE(store.formatted);
        store_unmount(&store);
    }
    fill_random(hal.flash, sizeof hal.flash);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    TEST_ASSERT_TRUE(store.formatted);
}

/* Any bit of the name, version or geometry wrong in one superblock: the other one serves. In both:
 * there is no filesystem. */
static void test_one_superblock_is_enough(void) {
    for (uint32_t n = 0; n < 20; n++) { /* both blocks know the folders */
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a", "old", 3));
    }
    store_unmount(&store);
    static uint8_t whole[2u * BLOCK_BYTES];
    memcpy(whole, hal.flash, sizeof whole);
    for (uint32_t bit = 8u * 8u; bit < 8u * 44u; bit += 3u) {
        const uint8_t mask = (uint8_t)(1u << (bit % 8u));
        for (uint32_t block = 0; block < 2u; block++) {
            memcpy(hal.flash, whole, sizeof whole);
            hal.flash[block * BLOCK_BYTES + bit / 8u] ^= mask;
            TEST_ASSERT_EQUAL_INT(STORE_OK, store_find(&store, &hal));
            store_unmount(&store);
        }
        hal.flash[bit / 8u] ^= mask;
        TEST_ASSERT_EQUAL_INT(STORE_CORRUPT, store_find(&store, &hal));
        TEST_ASSERT_FALSE(store.mounted);
    }
    memcpy(hal.flash, whole, sizeof whole);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    TEST_ASSERT_FALSE(store.formatted);
}

/* What a cut leaves of making a filesystem is not taken for one. */
static void test_a_filesystem_without_its_folders_is_unfinished(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_renew(&store, &hal, NULL));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a", "x", 1));
    store_unmount(&store);
    TEST_ASSERT_EQUAL_INT(STORE_CORRUPT, store_find(&store, &hal));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_renew(&store, &hal, NULL));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_finish(&store));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_find(&store, &hal));
}

static void test_kept_blocks_are_not_written_until_the_filesystem_is_finished(void) {
    store_unmount(&store);
    static uint8_t before[MOCK_FLASH_BYTES];
    uint8_t keep[STORE_BLOCK_SET_BYTES];
    fill_random(keep, sizeof keep);
    keep[0] &= 0xFCu;
    fill_random(hal.flash, sizeof hal.flash);
    memcpy(before, hal.flash, sizeof before);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_renew(&store, &hal, keep));
    for (uint32_t n = 0; n < 30; n++) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a", bytes, 6000));
    }
    for (uint32_t block = 0; block < BLOCKS; block++) {
        const uint32_t at = block * BLOCK_BYTES;
        if ((keep[block / 8u] & 1u << block % 8u) != 0u) {
            TEST_ASSERT_EQUAL_MEMORY(before + at, hal.flash + at, BLOCK_BYTES);
        }
    }
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_finish(&store));
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_replace(&store, "/a", bytes, sizeof bytes));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_blank_flash_is_formatted_once);
    RUN_TEST(test_replace_load_size_crc_remove);
    RUN_TEST(test_crc_of_a_long_file);
    RUN_TEST(test_bad_arguments);
    RUN_TEST(test_nothing_works_unmounted);
    RUN_TEST(test_a_file_in_pieces);
    RUN_TEST(test_leftovers_go_at_mount);
    RUN_TEST(test_random_operations_against_a_model);
    RUN_TEST(test_space_does_not_leak_over_many_trials);
    RUN_TEST(test_oldest_trials_go_first_and_the_kept_one_stays);
    RUN_TEST(test_a_store_that_cannot_be_walked_loses_only_what_hinders_it);
    RUN_TEST(test_what_is_sent_leaves_the_board_its_blocks);
    RUN_TEST(test_full_flash_refuses_and_keeps_the_old);
    RUN_TEST(test_a_store_filled_to_the_last_block);
    RUN_TEST(test_dead_flash_is_reported);
    RUN_TEST(test_one_bad_page_is_no_damage);
    RUN_TEST(test_garbage_is_formatted);
    RUN_TEST(test_one_superblock_is_enough);
    RUN_TEST(test_a_filesystem_without_its_folders_is_unfinished);
    RUN_TEST(test_kept_blocks_are_not_written_until_the_filesystem_is_finished);
    return UNITY_END();
}
