/*
 * The witness of the critical records: its ring of pages, stores that an earlier firmware filled,
 * and what a board says whose records have gone back.
 */
#include "app_fixture.h"
#include "boot_cuts.h"
#include "params/limits.h"
#include "store_ledger.h"
#include "target.h"

#include <stdio.h>

#define BEATS 5u
#define SPEED 0.05f
#define RAW_BEGIN (DATA_BLOCKS * BLOCK_BYTES)
#define PLACES (MOCK_FLASH_ERASES_FIRST ? 2u * BLOCK_BYTES / STORE_PAGE_BYTES : WITNESS_PLACES)
#define UPDATE_PAGES (MOCK_FLASH_ERASES_FIRST ? BLOCK_BYTES / STORE_PAGE_BYTES : 4u)
#define LOG_BYTES 5000u
#define LOGS_MAX 64u

static uint8_t whole[MOCK_FLASH_BYTES], bytes[RECORD_TRIAL_MAX_BYTES];

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

static uint32_t page_at(uint32_t copy, uint32_t generation) {
    return RAW_BEGIN + (UPDATE_PAGES + copy * PLACES + generation % PLACES) * STORE_PAGE_BYTES;
}

static void test_the_newest_intact_version_counts(void) {
    witness_t witness = {0}, found;
    TEST_ASSERT_FALSE(witness_find(&app.vault.store, &found));
    for (uint32_t i = 1; i <= 3u * PLACES; i++) {
        witness.entry[2].crc = i;
        witness.note[5] = (uint8_t)i;
        TEST_ASSERT_EQUAL(STORE_OK, witness_write(&app.vault.store, &witness));
        TEST_ASSERT_TRUE(witness_read(&app.vault.store, &found));
        TEST_ASSERT_EQUAL_MEMORY(&witness, &found, sizeof found);
    }
    const uint32_t newest = witness.generation;
    for (uint32_t copy = 0; copy < 2u; copy++) {
        hal.flash[page_at(copy, newest) + 100u] ^= 4u;
        TEST_ASSERT_TRUE(witness_find(&app.vault.store, &found));
        TEST_ASSERT_EQUAL_UINT32(copy == 0 ? newest : newest - 1u, found.generation);
    }
    app.vault.store.generation = 0;
    TEST_ASSERT_TRUE(witness_find(&app.vault.store, &found));
    TEST_ASSERT_EQUAL_UINT32(newest - 1u, app.vault.store.generation);
    for (uint32_t at = 0; at < UPDATE_PAGES * STORE_PAGE_BYTES; at++) {
        TEST_ASSERT_EQUAL_HEX8(0xFF, hal.flash[RAW_BEGIN + at]);
    }
}

/* ---- the power cut at every write and erase of the rings ---- */

static hal_t dark_hal;
static store_t dark_store;
static flash_model_t model, dark_model;
static uint32_t told, cuts; /* the newest version that was written to its end */

static void find_and_write_dark(void) {
    witness_t found = {0};
    memset(&dark_store, 0, sizeof dark_store);
    dark_store.hal = &dark_hal;
    TEST_ASSERT_TRUE(witness_find(&dark_store, &found) || told == 0);
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(told, found.generation);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(told + 1u, found.generation);
    const uint32_t before = found.generation;
    TEST_ASSERT_EQUAL(STORE_OK, witness_write(&dark_store, &found));
    dark_store.generation = 0;
    TEST_ASSERT_TRUE(witness_find(&dark_store, &found));
    TEST_ASSERT_GREATER_THAN_UINT32(before, found.generation);
}

/* A large block's borders and what is next to them; all of a small one. */
static bool is_tried(uint32_t generation) {
    const uint32_t pages = BLOCK_BYTES / STORE_PAGE_BYTES;
    const uint32_t in_block = generation % pages;
    return pages <= 16u || in_block <= 1u || in_block == pages - 1u;
}

static void cut_witness(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    for (unsigned kind = 0; kind < CUT_KINDS && is_tried(told + 1u); kind++) {
        mock_flash_copy(&dark_hal, &hal, false);
        flash_model_attach(&dark_model, &dark_hal, cuts + 1u);
        flash_model_cut(&dark_model, &dark_hal, (cut_kind_t)kind, offset, page);
        find_and_write_dark();
        cuts++;
    }
}

static void test_the_newest_version_outlives_every_cut(void) {
    witness_t witness = {0};
    mock_hal_init(&dark_hal);
    mock_hal_init(&hal);
    flash_model_attach(&model, &hal, 1);
    model.before_write = cut_witness;
    store_t *store = &app.vault.store;
    memset(store, 0, sizeof *store);
    store->hal = &hal;
    told = cuts = 0;
    while (told < 2u * PLACES + PLACES / 2u) {
        TEST_ASSERT_EQUAL(STORE_OK, witness_write(store, &witness));
        told = witness.generation;
    }
    printf("%s: %u versions, %u erases, %u cuts\n", mock_flash_name(), (unsigned)told,
           (unsigned)model.erases, (unsigned)cuts);
    TEST_ASSERT_EQUAL_UINT32(0, hal.flash_misuses + dark_hal.flash_misuses);
}

/* Of all blocks of the rings only the first one becomes blank. */
static bool dead_but_one(hal_t *board, uint32_t offset) {
    if (offset / BLOCK_BYTES > DATA_BLOCKS + 1u) {
        return false;
    }
    memset(board->flash + offset, 0xFF, MOCK_FLASH_ERASE_BYTES);
    return true;
}

static void test_the_only_block_with_the_newest_version_is_not_erased(void) {
    witness_t witness = {0}, found;
    if (!MOCK_FLASH_ERASES_FIRST) {
        return;
    }
    store_t *store = &app.vault.store;
    TEST_ASSERT_EQUAL(STORE_OK, witness_write(store, &witness));
    memset(hal.flash + RAW_BEGIN + 2u * BLOCK_BYTES, 0, 3u * BLOCK_BYTES);
    hal.flash_erase = dead_but_one;
    uint32_t newest = witness.generation, failed = 0;
    for (uint32_t i = 0; i < 3u * PLACES; i++) {
        const bool written = witness_write(store, &witness) == STORE_OK;
        newest = written ? witness.generation : newest;
        failed += !written;
        TEST_ASSERT_TRUE(witness_find(store, &found));
        TEST_ASSERT_EQUAL_UINT32(newest, found.generation);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, failed);
}

/* littlefs never gets a raw block, not even as the half of a folder that is not written yet. */
static void test_nothing_in_littlefs_points_to_the_raw_blocks(void) {
    swim_whole_trial(BEATS, SPEED);
    static uint8_t piece[BLOCK_BYTES];
    char path[] = "/in/aa";
    store_result_t result = STORE_OK;
    for (uint32_t n = 0; result == STORE_OK; n++) {
        name_upload(path, n);
        for (uint32_t i = 0; result == STORE_OK && i < 4u; i++) {
            memset(piece, (int)i, sizeof piece);
            result = store_replace(&app.vault.store, path, piece, sizeof piece);
        }
    }
    TEST_ASSERT_EQUAL(STORE_NO_SPACE, result);
    reboot();
    TEST_ASSERT_EQUAL_HEX8(0, app.vault.store.raw_taken);
}

/* ---- a store of an earlier firmware: no generations, and files up to the last block ---- */

static int old_read(const struct lfs_config *config, lfs_block_t block, lfs_off_t offset, void *out,
                    lfs_size_t length) {
    (void)config;
    memcpy(out, hal.flash + block * BLOCK_BYTES + offset, length);
    return 0;
}

static int old_program(const struct lfs_config *config, lfs_block_t block, lfs_off_t offset,
                       const void *from, lfs_size_t length) {
    (void)config;
    memcpy(hal.flash + block * BLOCK_BYTES + offset, from, length);
    return 0;
}

static int old_nothing(const struct lfs_config *config) {
    (void)config;
    return 0;
}

static int old_erase(const struct lfs_config *config, lfs_block_t block) {
    (void)block;
    return old_nothing(config);
}

static lfs_t old;
static uint8_t old_cache[3][STORE_CACHE_BYTES], old_lookahead[STORE_LOOKAHEAD_BYTES];
static const struct lfs_config old_config = {.read = old_read,
                                             .prog = old_program,
                                             .erase = old_erase,
                                             .sync = old_nothing,
                                             .read_size = 16,
                                             .prog_size = STORE_PAGE_BYTES,
                                             .block_size = BLOCK_BYTES,
                                             .block_count = BLOCKS,
                                             .block_cycles = 20,
                                             .cache_size = STORE_CACHE_BYTES,
                                             .lookahead_size = STORE_LOOKAHEAD_BYTES,
                                             .inline_max = (lfs_size_t)-1,
                                             .read_buffer = old_cache[0],
                                             .prog_buffer = old_cache[1],
                                             .lookahead_buffer = old_lookahead};

static int old_write(const char *path, const void *from, size_t length) {
    lfs_file_t file;
    const struct lfs_file_config config = {.buffer = old_cache[2]};
    int code =
        lfs_file_opencfg(&old, &file, "/new", LFS_O_WRONLY | LFS_O_CREAT | LFS_O_TRUNC, &config);
    if (code == 0) {
        code = (int)lfs_file_write(&old, &file, from, (lfs_size_t)length);
        const int closed = lfs_file_close(&old, &file);
        code = code < 0 ? code : closed;
    }
    return code < 0 ? code : lfs_rename(&old, "/new", path);
}

static void old_log(uint32_t number, uint8_t *content) {
    for (uint32_t i = 0; i < LOG_BYTES; i++) {
        content[i] = (uint8_t)(i * 7u + number * 13u);
    }
    memcpy(content, "ULog", 4);
}

static uint32_t old_logs;

/* Trial 7 learned, trial 8 pending, a key, parameters; then logs until |logs| or the flash is full.
 */
static void make_old_store(uint32_t logs) {
    static reference_t reference = {.beats = BEATS, .beat_s = 1.0f};
    static memory_t memory = {.beats = BEATS, .iteration = 3, .last_trial = 7};
    static trial_record_t trial = {.number = 8, .iteration = 3, .beats = BEATS, .executed = BEATS};
    static uint8_t content[LOG_BYTES];
    params_t params;
    const key_record_t key = {.set = true, .key = {5, 6, 7}, .mark = 1000};
    memset(hal.flash, 0xFF, sizeof hal.flash);
    TEST_ASSERT_EQUAL_INT(0, lfs_format(&old, &old_config));
    TEST_ASSERT_EQUAL_INT(0, lfs_mount(&old, &old_config));
    TEST_ASSERT_EQUAL_INT(0, lfs_mkdir(&old, "/in"));
    TEST_ASSERT_EQUAL_INT(0, lfs_mkdir(&old, "/trials"));
    for (uint32_t k = 0; k < BEATS; k++) {
        reference.speed_m_s[k] = SPEED;
        memory.amplitude_rad[k] = 0.1f * (float)k;
    }
    size_t length = record_encode_reference(&reference, bytes);
    memory.reference_crc = trial.reference_crc = record_crc(bytes);
    TEST_ASSERT_EQUAL_INT(0, old_write(REFERENCE_PATH, bytes, length));
    TEST_ASSERT_EQUAL_INT(0, old_write(LEARNED_PATH, bytes, record_encode_memory(&memory, bytes)));
    TEST_ASSERT_EQUAL_INT(0, old_write(PENDING_PATH, bytes, record_encode_trial(&trial, bytes)));
    params_reset(&params);
    params.value[PARAM_AMP_MAX_RAD] = 0.7f;
    TEST_ASSERT_EQUAL_INT(0, old_write(PARAMS_PATH, bytes, record_encode_params(&params, bytes)));
    TEST_ASSERT_EQUAL_INT(0, old_write(KEY_PATH, bytes, record_encode_key(&key, bytes)));
    TEST_ASSERT_EQUAL_INT(0, old_write(COUNTER_PATH, bytes, record_encode_counter(70, bytes)));
    int code = 0;
    for (old_logs = 0; old_logs < logs && code == 0; old_logs += code == 0) {
        char path[STORE_PATH_BYTES];
        trial_log_path(old_logs + 1u, path);
        old_log(old_logs + 1u, content);
        code = old_write(path, content, sizeof content);
    }
    (void)lfs_remove(&old, "/new");
    TEST_ASSERT_EQUAL_INT(0, lfs_unmount(&old));
}

static void expect_old_content(void) {
    static uint8_t content[LOG_BYTES], found[LOG_BYTES];
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT16(3, app.learner.memory.iteration);
    TEST_ASSERT_EQUAL_FLOAT(0.4f, app.learner.memory.amplitude_rad[4]);
    TEST_ASSERT_EQUAL_UINT32(8, app.trial.run.pending ? app.trial.run.trial.number : 0u);
    TEST_ASSERT_EQUAL_FLOAT(0.7f, app.params.value[PARAM_AMP_MAX_RAD]);
    TEST_ASSERT_TRUE(app.link.outbox.signing.keyed);
    TEST_ASSERT_EQUAL_UINT8(6, app.link.outbox.signing.out.secret_key[1]);
    TEST_ASSERT_EQUAL_UINT32(70, app.trial.next);
    for (uint32_t number = 1; number <= old_logs; number++) {
        char path[STORE_PATH_BYTES];
        trial_log_path(number, path);
        old_log(number, content);
        TEST_ASSERT_EQUAL_MESSAGE(STORE_OK, store_load(&app.vault.store, path, found, LOG_BYTES),
                                  path);
        TEST_ASSERT_EQUAL_MEMORY(content, found, LOG_BYTES);
    }
}

/* All goes on, and once the logs are gone the witness has its pages. */
static void expect_goes_on(void) {
    for (uint32_t number = 1; store_free_bytes(&app.vault.store) == 0; number++) {
        char path[STORE_PATH_BYTES]; /* a full one learns nothing until a trial is removed */
        trial_log_path(number, path);
        TEST_ASSERT_EQUAL(STORE_OK, store_remove(&app.vault.store, path));
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 8));
    for (uint32_t trial = 70; trial < 74; trial++) {
        swim_whole_trial(BEATS, SPEED);
        TEST_ASSERT_EQUAL_UINT32(trial, app.trial.run.trial.number);
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial));
        reboot();
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_EQUAL_UINT32(trial + 1u, app.trial.next);
    }
}

static void test_a_store_of_an_earlier_firmware_is_taken_over(void) {
    static const uint32_t logs[] = {0, 3, LOGS_MAX};
    for (size_t i = 0; i < 3; i++) {
        make_old_store(logs[i]);
        reboot();
        expect_old_content();
        printf("%u logs: %u blocks free, raw blocks taken 0x%02X\n", (unsigned)old_logs,
               (unsigned)(store_free_bytes(&app.vault.store) / BLOCK_BYTES),
               (unsigned)app.vault.store.raw_taken);
        TEST_ASSERT_EQUAL(logs[i] == LOGS_MAX, app.vault.store.raw_taken != 0);
        reboot();
        expect_old_content();
        expect_goes_on();
    }
}

static void check_cuts(uint32_t logs) {
    make_old_store(logs);
    memcpy(whole, hal.flash, sizeof whole);
    const uint32_t cuts = cut_every_write_of_a_boot(whole, expect_old_content);
    printf("%u logs: %u cuts while taking over\n", (unsigned)old_logs, (unsigned)cuts);
    TEST_ASSERT_GREATER_THAN_UINT32(10, cuts);
}

static void test_a_cut_at_every_write_of_taking_over(void) {
    check_cuts(0);
    check_cuts(LOGS_MAX);
}

static bool is_read[MOCK_FLASH_BYTES];

static void note_read(hal_t *board, uint32_t offset, uint8_t *read, uint32_t length) {
    (void)board;
    (void)read;
    memset(is_read + offset, true, length);
}

static void find_what_a_boot_reads(void) {
    memset(is_read, false, sizeof is_read);
    hal.flash_read = note_read;
    reboot();
    hal.flash_read = NULL;
}

/* Right after taking over nothing is left that a flipped bit could bring back. A flip in a byte
 * that the boot of the undamaged store does not read cannot change a boot: of those only some. */
static void test_a_flipped_bit_does_not_bring_back_what_was_taken_over(void) {
    make_old_store(1);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_AMP_MAX_RAD, 0.2f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    memcpy(whole, hal.flash, sizeof whole);
    find_what_a_boot_reads();
    uint32_t told = 0, booted = 0;
    for (uint32_t at = 0; at < 8u * BLOCK_BYTES; at += 3u) {
        if (!is_read[at] && at % 64u != 0) {
            continue;
        }
        booted++;
        mock_flash_load(&hal, whole, false);
        hal.flash[at] ^= (uint8_t)(1u << at % 8u);
        hal.flash_changed[at / MOCK_PIECE_BYTES] = true;
        hal.tx[0].head = hal.tx[0].tail = hal.tx[1].head = hal.tx[1].tail = 0;
        reboot();
        TEST_ASSERT_EQUAL_FLOAT(0.2f, app.params.value[PARAM_AMP_MAX_RAD]);
        TEST_ASSERT_TRUE(app.link.outbox.signing.locked);
        told += app.supervisor.state == STATE_FAULT;
    }
    printf("%u flips booted, %u told\n", (unsigned)booted, (unsigned)told);
    TEST_ASSERT_GREATER_THAN_UINT32(0, told);
}

/* The witness is still there, but an earlier firmware changed the records: no fault. */
static void test_a_firmware_without_witness_in_between_is_no_fault(void) {
    make_old_store(0);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_AMP_MAX_RAD, 0.3f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    store_unmount(&app.vault.store);
    TEST_ASSERT_EQUAL_INT(0, lfs_mount(&old, &old_config));
    params_t params;
    params_reset(&params);
    params.value[PARAM_AMP_MAX_RAD] = 0.6f;
    TEST_ASSERT_EQUAL_INT(0, old_write(PARAMS_PATH, bytes, record_encode_params(&params, bytes)));
    TEST_ASSERT_EQUAL_INT(0, lfs_remove(&old, PENDING_PATH));
    TEST_ASSERT_EQUAL_INT(0, lfs_unmount(&old));
    for (uint32_t i = 0; i < 2u; i++) {
        reboot();
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_EQUAL_FLOAT(0.6f, app.params.value[PARAM_AMP_MAX_RAD]);
        TEST_ASSERT_FALSE(app.trial.run.pending);
    }
}

/* The power went between the witness and the removal. */
static void test_a_removal_that_was_cut_is_completed(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(STORE_OK, critical_drop(&app.vault.store, CRITICAL_PENDING));
    uint32_t length = 0;
    for (uint32_t i = 0; i < 2u; i++) {
        reboot();
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_FALSE(app.trial.run.pending);
        TEST_ASSERT_EQUAL(STORE_NOT_FOUND, store_size(&app.vault.store, PENDING_PATH, &length));
    }
}

static void test_a_store_without_a_witness_is_no_fault(void) {
    swim_whole_trial(BEATS, SPEED);
    memset(hal.flash + RAW_BEGIN, 0xFF, STORE_RAW_BLOCKS * BLOCK_BYTES);
    for (uint32_t i = 0; i < 2u; i++) {
        reboot();
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_TRUE(app.trial.run.pending);
    }
    TEST_ASSERT_GREATER_THAN_UINT32(0, app.vault.store.generation);
}

static void lose_params(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_AMP_MAX_RAD, 0.2f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    TEST_ASSERT_EQUAL(STORE_OK, store_remove(&app.vault.store, PARAMS_PATH));
}

static void test_the_fault_lasts_until_it_is_cleared(void) {
    lose_params();
    for (uint32_t i = 0; i < 3u; i++) {
        reboot();
        TEST_ASSERT_EQUAL(FAULT_STORE_OLDER, app.supervisor.reason);
        TEST_ASSERT_EQUAL_FLOAT(0.2f, app.params.value[PARAM_AMP_MAX_RAD]);
    }
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

/* No copy of the newest parameters is left: of the limits that are known the more restrictive. */
static void test_lost_limits_fall_back_to_the_more_restrictive(void) {
    lose_params();
    for (uint32_t at = 0; at < RAW_BEGIN; at += BLOCK_BYTES) {
        if (memcmp(hal.flash + at, "TBPA", 4) == 0) {
            memset(hal.flash + at, 0, BLOCK_BYTES);
        }
    }
    reboot();
    TEST_ASSERT_EQUAL(FAULT_STORE_OLDER, app.supervisor.reason);
    TEST_ASSERT_EQUAL_FLOAT(0.2f, app.params.value[PARAM_AMP_MAX_RAD]);
}

static void test_of_two_limits_the_more_restrictive_holds(void) {
    params_t params, other;
    float limits[LIMIT_COUNT];
    params_reset(&params);
    params_reset(&other);
    other.value[PARAM_AMP_MAX_RAD] = 0.3f;    /* lower */
    params.value[PARAM_REF_MAX_M_S] = 0.1f;   /* lower already */
    other.value[PARAM_BATT_LOW_V] = 7.5f;     /* higher */
    other.value[PARAM_ERR_MAX_M_S] = 0.1f;    /* switched on */
    other.value[PARAM_LINK_TIMEOUT_S] = 0.0f; /* switched off */
    other.value[PARAM_DU_MAX_RAD] = 0.05f;
    other.value[PARAM_ILC_GAIN] = 1.0f; /* no limit */
    limits_get(&other, limits);
    limits_restrict(&params, limits);
    TEST_ASSERT_EQUAL_FLOAT(0.3f, params.value[PARAM_AMP_MAX_RAD]);
    TEST_ASSERT_EQUAL_FLOAT(0.1f, params.value[PARAM_REF_MAX_M_S]);
    TEST_ASSERT_EQUAL_FLOAT(7.5f, params.value[PARAM_BATT_LOW_V]);
    TEST_ASSERT_EQUAL_FLOAT(0.1f, params.value[PARAM_ERR_MAX_M_S]);
    TEST_ASSERT_EQUAL_FLOAT(5.0f, params.value[PARAM_LINK_TIMEOUT_S]);
    TEST_ASSERT_EQUAL_FLOAT(0.05f, params.value[PARAM_DU_MAX_RAD]);
    TEST_ASSERT_EQUAL_FLOAT(4.0f, params.value[PARAM_ILC_GAIN]);
}

/* Raw pages that take no data: the store works on, and the counter is a file again. */
static bool dead_raw(hal_t *board, uint32_t offset, const uint8_t *page) {
    if (offset >= RAW_BEGIN) {
        return false;
    }
    memcpy(board->flash + offset, page, STORE_PAGE_BYTES);
    return true;
}

static void test_dead_raw_pages_cost_the_witness_only(void) {
    hal.flash_write = dead_raw;
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_GREATER_THAN_UINT32(0, app.vault.store.failures);
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT32(2, app.trial.next);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_the_newest_intact_version_counts);
    RUN_ON_HOST(test_the_newest_version_outlives_every_cut);
    RUN_TEST(test_the_only_block_with_the_newest_version_is_not_erased);
    RUN_TEST(test_nothing_in_littlefs_points_to_the_raw_blocks);
    if (!MOCK_FLASH_ERASES_FIRST) { /* earlier firmware knew the fish's own flash only */
        RUN_TEST(test_a_store_of_an_earlier_firmware_is_taken_over);
        RUN_ON_HOST(test_a_cut_at_every_write_of_taking_over);
        RUN_ON_HOST(test_a_flipped_bit_does_not_bring_back_what_was_taken_over);
        RUN_TEST(test_a_firmware_without_witness_in_between_is_no_fault);
    }
    RUN_TEST(test_a_removal_that_was_cut_is_completed);
    RUN_TEST(test_a_store_without_a_witness_is_no_fault);
    RUN_TEST(test_the_fault_lasts_until_it_is_cleared);
    RUN_TEST(test_lost_limits_fall_back_to_the_more_restrictive);
    RUN_TEST(test_of_two_limits_the_more_restrictive_holds);
    RUN_TEST(test_dead_raw_pages_cost_the_witness_only);
    return UNITY_END();
}
