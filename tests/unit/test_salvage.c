/* What comes back from a flash whose filesystem or files are damaged. */
#include "app_fixture.h"
#include "boot_cuts.h"
#include "store_ledger.h"
#include "target.h"

#include <stdio.h>

#define BEATS 5u
#define SPEED 0.05f
#define MAGIC_BYTES 4u

/* So many that the blocks of the first ones have been used again. */
#define VERSIONS (MOCK_FLASH_ERASES_FIRST ? 150u : 40u)

static uint8_t record[RECORD_TRIAL_MAX_BYTES], whole[MOCK_FLASH_BYTES];
static memory_t learned;

void setUp(void) { fixture_reset(); }
void tearDown(void) {}

/* Two trials learned from, a third pending, parameters saved once. */
static void live(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 3.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    for (uint32_t trial = 1; trial <= 3; trial++) {
        swim_whole_trial(BEATS, SPEED);
        if (trial < 3) {
            TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial));
        }
    }
    learned = app.learner.memory;
}

static void wipe_block(uint32_t block, uint8_t with) {
    memset(hal.flash + block * BLOCK_BYTES, with, BLOCK_BYTES);
}

static void wipe_superblocks(uint8_t with) {
    wipe_block(0, with);
    wipe_block(1, with);
}

static void wipe_folder(const char *path) {
    lfs_dir_t dir;
    TEST_ASSERT_EQUAL_INT(0, lfs_dir_open(&app.vault.store.lfs, &dir, path));
    wipe_block(dir.m.pair[0], 0xA5);
    wipe_block(dir.m.pair[1], 0xA5);
    (void)lfs_dir_close(&app.vault.store.lfs, &dir);
}

static bool said(const char *text) {
    const mock_queue_t *queue = &hal.tx[HAL_PORT_CONSOLE];
    for (size_t at = 0; at + strlen(text) <= queue->tail; at++) {
        if (memcmp(queue->bytes + at, text, strlen(text)) == 0) {
            return true;
        }
    }
    return false;
}

static void expect_all_back(void) {
    TEST_ASSERT_EQUAL_MEMORY(&learned, &app.learner.memory, sizeof learned);
    TEST_ASSERT_EQUAL_HEX32(learned.reference_crc, app.learner.reference.crc);
    TEST_ASSERT_EQUAL_FLOAT(3.0f, app.params.value[PARAM_ILC_GAIN]);
    TEST_ASSERT_TRUE(app.trial.run.pending);
    TEST_ASSERT_EQUAL_UINT32(3, app.trial.run.trial.number);
    TEST_ASSERT_EQUAL_UINT32(4, app.trial.next);
    TEST_ASSERT_EQUAL_INT32(0, ledger_lost_blocks(&app.vault.store));
}

static void expect_renewed(void) {
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
    expect_all_back();
    TEST_ASSERT_TRUE(said("saved /learned.bin"));
    TEST_ASSERT_TRUE(said("saved /params.bin"));
    TEST_ASSERT_FALSE(said("lost"));
}

static void expect_goes_on(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    expect_all_back();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 3));
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL_UINT32(4, app.trial.run.trial.number);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 4));
}

static void test_blank_flash_is_no_fault(void) {
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_TRUE(app.vault.store.formatted);
    TEST_ASSERT_FALSE(said("saved"));
    memset(hal.flash, 0x5A, sizeof hal.flash); /* of no use to anybody */
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT32(1, app.trial.next);
}

static void test_lost_superblocks_cost_the_trials_only(void) {
    const uint8_t patterns[] = {0xFF, 0x00, 0xA5};
    live();
    memcpy(whole, hal.flash, sizeof whole);
    for (size_t i = 0; i < sizeof patterns; i++) {
        memcpy(hal.flash, whole, sizeof whole);
        wipe_superblocks(patterns[i]);
        reboot();
        expect_renewed();
        expect_goes_on();
    }
}

static void test_one_lost_superblock_costs_nothing(void) {
    live();
    memcpy(whole, hal.flash, sizeof whole);
    for (uint32_t block = 0; block < 2; block++) {
        memcpy(hal.flash, whole, sizeof whole);
        reboot();
        /* Both blocks know all: the last change of the root folder compacted it. */
        for (uint32_t i = 0; i < 2; i++) {
            TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
            TEST_ASSERT_EQUAL_INT(0, lfs_fs_gc(&app.vault.store.lfs));
        }
        wipe_block(block, 0xA5);
        reboot();
        TEST_ASSERT_NOT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
        TEST_ASSERT_FALSE(app.vault.store.formatted);
        TEST_ASSERT_EQUAL_HEX32(learned.reference_crc, app.learner.reference.crc);
    }
}

static void test_an_unreadable_folder_costs_the_trials_only(void) {
    live();
    memcpy(whole, hal.flash, sizeof whole);
    const char *const folders[] = {"/trials", "/in"};
    for (size_t i = 0; i < 2; i++) {
        memcpy(hal.flash, whole, sizeof whole);
        reboot();
        wipe_folder(folders[i]);
        reboot();
        expect_renewed();
        expect_goes_on();
    }
}

/* Flips a bit in the newest copy of what |path| holds. */
static void damage_file(const char *path) {
    uint32_t length = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, path, &length));
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&app.vault.store, path, record, length));
    lfs_file_t file;
    static uint8_t cache[STORE_CACHE_BYTES];
    const struct lfs_file_config config = {.buffer = cache};
    TEST_ASSERT_EQUAL_INT(
        0, lfs_file_opencfg(&app.vault.store.lfs, &file, path, LFS_O_RDONLY, &config));
    const uint32_t head = file.ctz.head;
    (void)lfs_file_close(&app.vault.store.lfs, &file);
    hal.flash[head * BLOCK_BYTES + length / 2u] ^= 0x10u;
}

static void test_a_damaged_file_costs_itself_only(void) {
    live();
    memcpy(whole, hal.flash, sizeof whole);
    damage_file("/learned.bin");
    reboot();
    TEST_ASSERT_EQUAL(FAULT_FILE_DAMAGED, app.supervisor.reason);
    TEST_ASSERT_TRUE(said("older /learned.bin"));
    TEST_ASSERT_EQUAL_UINT32(1, app.learner.memory.last_trial); /* the version before */
    TEST_ASSERT_TRUE(app.trial.run.pending);
    uint32_t size = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, "/trials/0001.ulg", &size));
    reboot();
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);

    memcpy(hal.flash, whole, sizeof whole);
    reboot();
    damage_file("/params.bin");
    hal.tx[HAL_PORT_CONSOLE].tail = 0;
    reboot();
    TEST_ASSERT_EQUAL(FAULT_FILE_DAMAGED, app.supervisor.reason);
    TEST_ASSERT_TRUE(said("older /params.bin")); /* the defaults, with the limits */
    TEST_ASSERT_EQUAL_FLOAT(4.0f, app.params.value[PARAM_ILC_GAIN]);
    TEST_ASSERT_EQUAL_MEMORY(&learned, &app.learner.memory, sizeof learned);
}

/* A sound record of amplitudes that arming would refuse to guess again. */
static void test_learned_input_that_contradicts_itself_is_damaged(void) {
    live();
    memory_t wrong = learned;
    wrong.input = MEMORY_INPUT_FIRST;
    TEST_ASSERT_EQUAL_UINT16(3, wrong.iteration);
    const size_t length = record_encode_memory(&wrong, record);
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, LEARNED_PATH, record, length));
    reboot();
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_FILE_DAMAGED, app.supervisor.reason);
    TEST_ASSERT_TRUE(said("saved /learned.bin"));
    expect_all_back();
    expect_goes_on();
}

static void wipe_witness(void) {
    memset(hal.flash + DATA_BLOCKS * BLOCK_BYTES, 0xFF, STORE_RAW_BLOCKS * BLOCK_BYTES);
}

/* The witness names the newest of several copies. Without it only equal ones count. */
static void test_parameters_come_back_only_when_there_is_no_doubt(void) {
    live();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 3));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_ILC_GAIN, 2.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    memcpy(whole, hal.flash, sizeof whole);
    for (uint32_t witnessed = 0; witnessed < 2; witnessed++) {
        memcpy(hal.flash, whole, sizeof whole);
        wipe_superblocks(0xFF);
        if (witnessed == 0) {
            wipe_witness();
        }
        hal.tx[HAL_PORT_CONSOLE].tail = 0;
        reboot();
        TEST_ASSERT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
        TEST_ASSERT_TRUE(said(witnessed == 1 ? "saved /params.bin" : "lost /params.bin"));
        TEST_ASSERT_EQUAL_FLOAT(witnessed == 1 ? 2.0f : 4.0f, app.params.value[PARAM_ILC_GAIN]);
        TEST_ASSERT_EQUAL_UINT32(3, app.learner.memory.last_trial);
    }
}

static void test_the_newest_reference_comes_back_with_what_was_learned_for_it(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, 1));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS + 1u, SPEED));
    const uint32_t crc = app.learner.reference.crc;
    wipe_superblocks(0xFF);
    reboot();
    TEST_ASSERT_EQUAL_HEX32(crc, app.learner.reference.crc);
    TEST_ASSERT_EQUAL_UINT16(0, app.learner.memory.iteration);
    TEST_ASSERT_EQUAL_UINT32(1, app.learner.memory.last_trial);
    TEST_ASSERT_FALSE(app.trial.run.pending);
}

static void test_numbers_go_on_when_only_the_trials_tell_them(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, 1));
    for (uint32_t at = 0; at < sizeof hal.flash; at += BLOCK_BYTES) {
        if (memcmp(hal.flash + at, "TB", 2) == 0) {
            memset(hal.flash + at, 0xFF, BLOCK_BYTES);
        }
    }
    wipe_superblocks(0xFF);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
    TEST_ASSERT_EQUAL_UINT32(2, app.trial.next);
}

/* Records longer than a block, among older ones that share some of their blocks' numbers. */
static void test_long_records_come_back(void) {
    static memory_t memory;
    static trial_record_t trial;
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_TANK_LEN_M, 0.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS_MAX, SPEED));
    for (uint32_t n = 1; n <= VERSIONS; n++) {
        memory = (memory_t){.reference_crc = app.learner.reference.crc,
                            .beats = BEATS_MAX,
                            .last_trial = n,
                            .iteration = (uint16_t)(n + 1u)};
        trial = (trial_record_t){.number = n + 1u,
                                 .reference_crc = app.learner.reference.crc,
                                 .beats = BEATS_MAX,
                                 .executed = BEATS_MAX};
        for (uint32_t k = 0; k < BEATS_MAX; k++) {
            memory.amplitude_rad[k] = 0.001f * (float)(k * n % 301u);
            trial.amplitude_rad[k] = memory.amplitude_rad[k];
        }
        size_t length = record_encode_memory(&memory, record);
        TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, LEARNED_PATH, record, length));
        length = record_encode_trial(&trial, record);
        TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, PENDING_PATH, record, length));
    }
    const uint32_t crc = app.learner.reference.crc;
    wipe_superblocks(0x00);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
    TEST_ASSERT_EQUAL_HEX32(crc, app.learner.reference.crc);
    TEST_ASSERT_EQUAL_MEMORY(&memory, &app.learner.memory, sizeof memory);
    TEST_ASSERT_EQUAL_MEMORY(&trial, &app.trial.run.trial, sizeof trial);
    TEST_ASSERT_EQUAL_UINT32(VERSIONS + 2u, app.trial.next);
}

static void store_key(bool set, uint8_t fill, uint64_t mark) {
    key_record_t key = {.set = set, .mark = mark};
    memset(key.key, set ? fill : 0, sizeof key.key);
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, KEY_PATH, record,
                                              record_encode_key(&key, record)));
}

static key_record_t stored_key(void) {
    key_record_t key = {0};
    uint32_t length = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, KEY_PATH, &length));
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&app.vault.store, KEY_PATH, record, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, record_decode_key(record, length, &key));
    return key;
}

static void test_the_newest_key_comes_back_and_old_messages_do_not(void) {
    store_key(true, 2, 1000);
    store_key(true, 2, 5000);
    wipe_superblocks(0xFF);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
    const key_record_t key = stored_key();
    TEST_ASSERT_TRUE(key.set);
    TEST_ASSERT_EQUAL_UINT8(2, key.key[31]);
    TEST_ASSERT_GREATER_THAN_UINT32(86400u, (uint32_t)(key.mark / SIGNING_TICKS_PER_S));
    TEST_ASSERT_TRUE(app.link.outbox.signing.locked);
}

static const uint8_t new_key[SIGNING_KEY_BYTES] = {1, 2, 3};

static void test_an_erased_key_does_not_come_back(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_set_key(&app, new_key, 1000));
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_set_key(&app, NULL, 0));
    wipe_superblocks(0xFF);
    reboot();
    TEST_ASSERT_FALSE(stored_key().set);
    TEST_ASSERT_FALSE(app.link.outbox.signing.locked);
}

/* A key that was replaced never comes back: the newest does, from its copy in the witness; without
 * a witness nobody knows, and the board is locked. */
static void test_a_replaced_key_does_not_come_back(void) {
    store_key(true, 1, 1000);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_set_key(&app, new_key, 2000));
    memcpy(whole, hal.flash, sizeof whole);
    for (uint32_t i = 0; i < 4u; i++) {
        const bool witnessed = i % 2u == 0, renewed = i / 2u == 1;
        memcpy(hal.flash, whole, sizeof whole);
        reboot();
        if (renewed) {
            wipe_superblocks(0xFF);
        } else {
            damage_file(KEY_PATH);
        }
        if (!witnessed) {
            wipe_witness();
        }
        reboot();
        TEST_ASSERT_EQUAL(renewed     ? FAULT_STORE_RENEWED
                          : witnessed ? FAULT_FILE_DAMAGED
                                      : FAULT_KEY_UNREADABLE,
                          app.supervisor.reason);
        TEST_ASSERT_TRUE(app.link.outbox.signing.locked);
        TEST_ASSERT_EQUAL(witnessed, app.link.outbox.signing.keyed);
        TEST_ASSERT_TRUE(!witnessed || stored_key().key[0] == new_key[0]);
    }
}

/* Of the limits that the witness keeps and the defaults, the more restrictive ones. */
static void test_older_limits_do_not_come_back(void) {
    static const float limits_rad[] = {1.0f, 0.2f};
    for (size_t i = 0; i < 2; i++) {
        TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_AMP_MAX_RAD, limits_rad[i]));
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
    }
    damage_file(PARAMS_PATH);
    memcpy(whole, hal.flash, sizeof whole);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_FILE_DAMAGED, app.supervisor.reason);
    TEST_ASSERT_EQUAL_FLOAT(0.2f, app.params.value[PARAM_AMP_MAX_RAD]);
    memcpy(hal.flash, whole, sizeof whole);
    wipe_witness();
    reboot();
    TEST_ASSERT_EQUAL_FLOAT(0.5f, app.params.value[PARAM_AMP_MAX_RAD]);
}

static void test_a_trial_that_was_dropped_does_not_take_the_place_of_a_damaged_one(void) {
    swim_whole_trial(BEATS, SPEED);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, 1));
    swim_whole_trial(BEATS, SPEED);
    damage_file(PENDING_PATH);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_FILE_DAMAGED, app.supervisor.reason);
    TEST_ASSERT_FALSE(app.trial.run.pending);
    TEST_ASSERT_EQUAL_UINT32(3, app.trial.next);
}

static void test_a_key_that_cannot_be_saved_leaves_a_locked_board(void) {
    store_key(true, 1, 1000);
    uint8_t magic[MAGIC_BYTES];
    memcpy(magic, record, sizeof magic);
    for (uint32_t at = 0; at < sizeof hal.flash; at += BLOCK_BYTES) {
        if (memcmp(hal.flash + at, magic, sizeof magic) == 0) {
            hal.flash[at + 20u] ^= 1u;
        }
    }
    wipe_superblocks(0xFF);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_STORE_RENEWED, app.supervisor.reason);
    TEST_ASSERT_TRUE(said("lost /key.bin"));
    TEST_ASSERT_TRUE(app.link.outbox.signing.locked);
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    reboot();
    TEST_ASSERT_EQUAL(FAULT_KEY_UNREADABLE, app.supervisor.reason);
    TEST_ASSERT_TRUE(app.link.outbox.signing.locked);
}

static void expect_renewed_or_done(void) {
    TEST_ASSERT_TRUE(app.supervisor.state == STATE_IDLE ||
                     app.supervisor.reason == FAULT_STORE_RENEWED);
    expect_all_back();
}

/* The board that was renewing its store when the power went: the next boot finds the same. */
static void test_a_cut_at_every_write_of_the_salvage(void) {
    live();
    wipe_superblocks(0xA5);
    memcpy(whole, hal.flash, sizeof whole);
    const uint32_t cuts = cut_every_write_of_a_boot(whole, expect_renewed_or_done);
    printf("salvage: %u cuts\n", (unsigned)cuts);
    TEST_ASSERT_GREATER_THAN_UINT32(100, cuts);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_blank_flash_is_no_fault);
    RUN_TEST(test_lost_superblocks_cost_the_trials_only);
    RUN_TEST(test_one_lost_superblock_costs_nothing);
    RUN_TEST(test_an_unreadable_folder_costs_the_trials_only);
    RUN_TEST(test_a_damaged_file_costs_itself_only);
    RUN_TEST(test_learned_input_that_contradicts_itself_is_damaged);
    RUN_TEST(test_parameters_come_back_only_when_there_is_no_doubt);
    RUN_TEST(test_the_newest_reference_comes_back_with_what_was_learned_for_it);
    RUN_TEST(test_numbers_go_on_when_only_the_trials_tell_them);
    RUN_TEST(test_long_records_come_back);
    RUN_TEST(test_the_newest_key_comes_back_and_old_messages_do_not);
    RUN_TEST(test_an_erased_key_does_not_come_back);
    RUN_TEST(test_a_replaced_key_does_not_come_back);
    RUN_TEST(test_older_limits_do_not_come_back);
    RUN_TEST(test_a_trial_that_was_dropped_does_not_take_the_place_of_a_damaged_one);
    RUN_TEST(test_a_key_that_cannot_be_saved_leaves_a_locked_board);
    RUN_ON_HOST(test_a_cut_at_every_write_of_the_salvage);
    return UNITY_END();
}
