/*
 * How evenly the flash wears: whole trials of the real firmware, one after the other, and every
 * page write counted. WEAR_TRIALS of them (300). And what happens when pages die of it.
 */
#include "app_fixture.h"
#include "flash_model.h"
#include "store_ledger.h"
#include "target.h"

#include <stdio.h>
#include <stdlib.h>

#define BEATS 40u
#define SPEED 0.05f
#define PAGE_CYCLES 10000u /* what the chip promises */
#define TRIALS_PER_BOOT 6u
#define WEAK_CYCLES 60u
#define PAGES_PER_BLOCK (BLOCK_BYTES / STORE_PAGE_BYTES)

static flash_model_t model;

void setUp(void) {}
void tearDown(void) {}

static uint32_t trials_wanted(void) {
    const char *text = getenv("WEAR_TRIALS");
    return text != NULL ? (uint32_t)strtoul(text, NULL, 10) : MOCK_FLASH_ERASES_FIRST ? 60u : 300u;
}

static void begin(uint32_t endurance) {
    fixture_reset();
    hal.reset_cause = HAL_RESET_POWER;
    flash_model_attach(&model, &hal, 1);
    model.endurance = endurance;
    key_record_t key = {.set = true, .mark = 1000};
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, KEY_PATH, upload_bytes,
                                              record_encode_key(&key, upload_bytes)));
    reboot();
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS, SPEED));
}

/* A trial and all that is stored for it; the board is switched off after some. */
static void swim_one(uint32_t trial) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, trial));
    run_ticks_ms(BEATS * 1000u + 5000u);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT32(trial, app.trial.run.trial.number);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, trial));
    if (trial % TRIALS_PER_BOOT == 0) {
        reboot();
    }
}

static int by_count(const void *a, const void *b) {
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

typedef struct {
    uint32_t min, median, p99, max;
} spread_t;

static spread_t spread_of(const uint32_t *counts, uint32_t count) {
    static uint32_t sorted[FLASH_PAGES];
    memcpy(sorted, counts, count * sizeof sorted[0]);
    qsort(sorted, count, sizeof sorted[0], by_count);
    return (spread_t){sorted[0], sorted[count / 2u], sorted[count * 99u / 100u],
                      sorted[count - 1u]};
}

static void print_spread(const char *what, spread_t spread) {
    printf("%s: min %u, median %u, p99 %u, max %u\n", what, (unsigned)spread.min,
           (unsigned)spread.median, (unsigned)spread.p99, (unsigned)spread.max);
}

static void test_the_flash_wears_evenly(void) {
    const uint32_t trials = trials_wanted();
    begin(0);
    for (uint32_t trial = 1; trial <= trials; trial++) {
        swim_one(trial);
    }
    uint32_t blocks[BLOCKS_FIT] = {0};
    for (uint32_t page = 0; page < FLASH_PAGES; page++) {
        uint32_t *block = &blocks[page / PAGES_PER_BLOCK];
        *block = model.page_writes[page] > *block ? model.page_writes[page] : *block;
    }
    print_spread("erases of a unit", spread_of(model.unit_erases, FLASH_UNITS));
    const spread_t pages = spread_of(model.page_writes, FLASH_PAGES);
    uint32_t log_bytes = 0;
    char path[STORE_PATH_BYTES];
    trial_log_path(trials, path);
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, path, &log_bytes));
    printf("%s: %u trials of %u beats, %u bytes each, %u page writes, %u erases, %u s busy\n",
           mock_flash_name(), (unsigned)trials, (unsigned)BEATS, (unsigned)log_bytes,
           (unsigned)model.writes, (unsigned)model.erases, (unsigned)(model.busy_us / 1000000u));
    TEST_ASSERT_EQUAL_UINT32(0, hal.flash_misuses);
    print_spread("page writes", pages);
    print_spread("blocks, their busiest page", spread_of(blocks, BLOCKS_FIT));
    printf("first page at %u cycles after %.0f trials, half of them after %.0f\n", PAGE_CYCLES,
           (double)trials * PAGE_CYCLES / pages.max, (double)trials * PAGE_CYCLES / pages.median);
    TEST_ASSERT_EQUAL_UINT32(0, app.vault.store.failures);
    /* littlefs puts another pair of superblocks before a root that was rewritten often, for ever.
     */
    const int32_t lost = ledger_lost_blocks(&app.vault.store);
    TEST_ASSERT_TRUE(lost == 0 || lost <= 2 * (int32_t)(trials / 5000u));
    if (trials >= 300u) {
        TEST_ASSERT_LESS_THAN_UINT32(trials * PAGE_CYCLES / 20000u, pages.max);
    }
}

/* Pages that take their data no more after WEAK_CYCLES: trials go on until hardly a block is
 * left, and what was stored stays. */
static void test_dying_pages_cost_nothing_that_was_stored(void) {
    begin(WEAK_CYCLES);
    uint32_t trial = 1;
    fault_t fault = FAULT_NONE;
    for (; fault == FAULT_NONE && trial < 5000u; trial++) {
        const memory_t before = app.learner.memory;
        fault = command(LINK_COMMAND_ARM, 0);
        fault = fault == FAULT_NONE ? command(LINK_COMMAND_START, trial) : fault;
        if (fault == FAULT_NONE) {
            run_ticks_ms(BEATS * 1000u + 5000u);
            fault = app.supervisor.reason;
        }
        fault = fault == FAULT_NONE ? command(LINK_COMMAND_LEARN, trial) : fault;
        const memory_t told = app.learner.memory;
        reboot();
        TEST_ASSERT_EQUAL_MEMORY(fault == FAULT_NONE ? &told : &before, &app.learner.memory,
                                 sizeof told);
        TEST_ASSERT_GREATER_THAN_UINT32(trial - (fault == FAULT_NONE ? 0u : 1u), app.trial.next);
    }
    printf("pages that last %u to %u cycles: %u trials, then %s; %u writes failed\n", WEAK_CYCLES,
           WEAK_CYCLES * 9u / 8u, (unsigned)trial - 2u, fault_info(fault)->name,
           (unsigned)model.worn);
    TEST_ASSERT_GREATER_THAN_UINT32(100, model.worn);
    TEST_ASSERT_LESS_THAN_UINT32(5000, trial);
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(test_the_flash_wears_evenly);
    RUN_ON_HOST(test_dying_pages_cost_nothing_that_was_stored);
    return UNITY_END();
}
