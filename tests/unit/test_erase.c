/*
 * A flash that erases first (MOCK_FLASH): no erase runs while a trial is open, for the blocks that
 * the trial takes are blank before it starts; and chips that no store can be made of are refused.
 * On the fish's own flash the first part is nothing but what it always was: no erase at all.
 */
#include "app_fixture.h"
#include "flash_model.h"
#include "store/erase_ahead.h"
#include "target.h"

#include <stdio.h>

#define BEATS 20u
#define SPEED 0.04f
#define TRIALS 30u
#define ARMED_MS 30000u

static flash_model_t model;
static bool open_trial; /* the tail moves, or the fish comes to rest */
static uint32_t erases_in_trial, blocks_in_trial;

void setUp(void) {
    fixture_reset();
    flash_model_attach(&model, &hal, 1);
    open_trial = false;
    impatient = true;
    erases_in_trial = blocks_in_trial = 0;
}

void tearDown(void) {}

static void watch(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    erases_in_trial += open_trial && page == NULL;
    blocks_in_trial += open_trial && page != NULL && offset % BLOCK_BYTES == 0;
}

/* Armed until all is ready; the number of erases that took. */
static uint32_t arm(void) {
    const uint32_t before = model.erases;
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    for (uint32_t ms = 0; ms < ARMED_MS && !app.trial.preparation.room_made; ms += 100u) {
        run_ms(100);
    }
    TEST_ASSERT_TRUE(app.trial.preparation.room_made);
    return model.erases - before;
}

static void swim(uint32_t beats) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    open_trial = true;
    for (uint32_t ms = 0; app.vault.store.erase_forbidden || ms < 1000u; ms += 20u) {
        run_ms(20);
        open_trial = app.vault.store.erase_forbidden;
        TEST_ASSERT_LESS_THAN_UINT32(beats * 1000u + 60000u, ms);
    }
    open_trial = false;
    run_ms(MOCK_FLASH_ERASES_FIRST ? 100u : beats * 1000u + 6000u);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_DISCARD, app.trial.run.trial.number));
    hal.pulse_count = 0;
}

static void expect_clean(void) {
    TEST_ASSERT_EQUAL_UINT32(0, erases_in_trial);
    TEST_ASSERT_EQUAL_UINT32(0, app.vault.store.failures);
    TEST_ASSERT_EQUAL_UINT32(0, hal.flash_misuses);
    TEST_ASSERT_FALSE(app.vault.store.erase_forbidden);
}

static void swim_many(uint32_t trials, uint16_t beats) {
    uint32_t first = 0, most = 0, refused = 0;
    for (uint32_t n = 0; n < trials; n++) {
        const uint32_t erases = arm();
        first = n == 0 ? erases : first;
        most = n != 0 && erases > most ? erases : most;
        swim(beats);
        refused += app.vault.store.erases_refused;
        app.vault.store.erases_refused = 0;
    }
    printf("%s: %u trials of %u beats: %u erases before the first, at most %u before another, %u "
           "in a trial, %u blocks taken in it, %u passed over\n",
           mock_flash_name(), (unsigned)trials, (unsigned)beats, (unsigned)first, (unsigned)most,
           (unsigned)erases_in_trial, (unsigned)(blocks_in_trial / trials), (unsigned)refused);
    expect_clean();
}

static void test_no_erase_while_a_trial_is_open(void) {
    model.before_write = watch;
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    swim_many(TRIALS, BEATS);
    TEST_ASSERT_TRUE(!MOCK_FLASH_ERASES_FIRST || blocks_in_trial > 0);
}

static void test_no_erase_in_the_longest_trial(void) {
    model.before_write = watch;
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_TANK_LEN_M, 0.0f));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS_MAX, SPEED));
    swim_many(2, BEATS_MAX);
}

/* Started at once, before the blocks are blank. */
static void test_the_start_is_refused_until_the_blocks_are_blank(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    const uint32_t trial = app.trial.next;
    const fault_t wanted = MOCK_FLASH_ERASES_FIRST ? FAULT_ERASING : FAULT_NONE;
    TEST_ASSERT_EQUAL(wanted, command(LINK_COMMAND_START, trial));
    if (wanted == FAULT_NONE) {
        return;
    }
    TEST_ASSERT_EQUAL(STATE_ARMED, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT32(trial, app.trial.next);
    (void)arm();
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, trial));
}

/* One erase in a pass. */
static void test_a_step_erases_one_block(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    while (!app.trial.preparation.room_made) {
        const uint32_t before = model.erases;
        run_ms(10);
        /* A folder that is compacted takes one, too. */
        TEST_ASSERT_LESS_OR_EQUAL_UINT32(before + 4u, model.erases);
    }
}

/* What is not blank in a trial is passed over, and the log goes on. */
static void test_a_block_that_is_not_blank_is_passed_over(void) {
    store_t *store = &app.vault.store;
    static uint8_t bytes[3u * BLOCK_BYTES];
    bool done = !MOCK_FLASH_ERASES_FIRST;
    for (uint32_t i = 0; i < 2u * BLOCKS && !done; i++) {
        TEST_ASSERT_EQUAL(STORE_OK, erase_ahead_step(store, 12u * BLOCK_BYTES, &done));
    }
    TEST_ASSERT_TRUE(done);
    const uint32_t next = store->lfs.lookahead.start;
    store->blank[next / 8u] &= (uint8_t) ~(1u << next % 8u);
    const uint32_t erases = model.erases;
    erase_ahead_forbid(store, true);
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(store, "/a", bytes, sizeof bytes));
    erase_ahead_forbid(store, false);
    TEST_ASSERT_EQUAL_UINT32(erases, model.erases);
    TEST_ASSERT_EQUAL_UINT32(MOCK_FLASH_ERASES_FIRST ? 1 : 0, store->erases_refused);
}

/* Without a blank block nothing is erased in a trial either: the write fails. */
static void test_nothing_is_erased_for_lack_of_blank_blocks(void) {
    if (!MOCK_FLASH_ERASES_FIRST) {
        return;
    }
    reboot(); /* nothing is known to be blank */
    const uint32_t erases = model.erases;
    erase_ahead_forbid(&app.vault.store, true);
    TEST_ASSERT_NOT_EQUAL(STORE_OK, store_replace(&app.vault.store, "/a", "new", 3));
    TEST_ASSERT_EQUAL_UINT32(erases, model.erases);
    TEST_ASSERT_GREATER_THAN_UINT32(0, app.vault.store.erases_refused);
    erase_ahead_forbid(&app.vault.store, false);
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, "/a", "new", 3));
}

static void boot_with(uint32_t size_bytes, uint32_t erase_bytes, uint32_t program_bytes) {
    mock_hal_init(&hal);
    hal.flash_geometry = *hal_flash_geometry(&hal);
    hal.flash_geometry.size_bytes = size_bytes;
    hal.flash_geometry.erase_bytes = erase_bytes;
    hal.flash_geometry.program_bytes = program_bytes;
    reboot();
}

static void expect_unfit(store_result_t why) {
    TEST_ASSERT_EQUAL(why, store_fits(&hal));
    TEST_ASSERT_EQUAL(why, store_find(&app.vault.store, &hal));
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_STORE_UNFIT, app.supervisor.reason);
    TEST_ASSERT_FALSE(app.vault.store.mounted);
    TEST_ASSERT_EQUAL_UINT32(0, hal.flash_writes + hal.flash_erases);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, command(LINK_COMMAND_ARM, 0));
}

static void test_a_chip_that_is_too_small_is_refused(void) {
    boot_with((STORE_BLOCKS_MIN - 1u) * BLOCK_BYTES, MOCK_FLASH_ERASE_BYTES, 256);
    expect_unfit(STORE_TOO_SMALL);
    boot_with(0, 4096, 256);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state); /* 0: the mock's own */
}

static void test_a_chip_of_an_impossible_geometry_is_refused(void) {
    static const uint32_t units[][2] = {{3000, 256}, {4096, 0},  {0, 256},        {4096, 512},
                                        {128, 256},  {4096, 96}, {0x80000000u, 0}};
    for (size_t i = 0; i < sizeof units / sizeof units[0]; i++) {
        boot_with(MOCK_FLASH_SIZE_BYTES, units[i][0], units[i][1]);
        expect_unfit(STORE_BAD_GEOMETRY);
    }
}

/* The least that is accepted does a trial of 40 beats. */
static void test_the_smallest_chip_does_a_trial(void) {
    boot_with(STORE_BLOCKS_MIN * BLOCK_BYTES, MOCK_FLASH_ERASE_BYTES, 256);
    flash_model_attach(&model, &hal, 1);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(40, SPEED));
    for (uint32_t n = 0; n < 6u; n++) {
        (void)arm();
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
        run_ms(46000);
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
        TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
        hal.pulse_count = 0;
    }
    TEST_ASSERT_EQUAL_UINT32(0, app.vault.store.failures);
    for (uint32_t at = STORE_BLOCKS_MIN * BLOCK_BYTES; at < MOCK_FLASH_BYTES; at += 256u) {
        TEST_ASSERT_EQUAL_HEX8(0xFF, hal.flash[at]);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(test_no_erase_while_a_trial_is_open);
    RUN_ON_HOST(test_no_erase_in_the_longest_trial);
    RUN_TEST(test_the_start_is_refused_until_the_blocks_are_blank);
    RUN_TEST(test_a_step_erases_one_block);
    RUN_TEST(test_a_block_that_is_not_blank_is_passed_over);
    RUN_TEST(test_nothing_is_erased_for_lack_of_blank_blocks);
    RUN_TEST(test_a_chip_that_is_too_small_is_refused);
    RUN_TEST(test_a_chip_of_an_impossible_geometry_is_refused);
    RUN_TEST(test_the_smallest_chip_does_a_trial);
    return UNITY_END();
}
