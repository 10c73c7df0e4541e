#include "power_cuts.h"

#include "target.h"
#include "unity.h"

#include <stdio.h>
#include <string.h>

#define WORK_EVERY 3u      /* cuts, after one of which the store goes on working */
#define SECOND_CUT_MAX 24u /* writes of a boot with repairs and of ledger_work */

/* The world that goes on, and the one in which the power went. */
static hal_t hal, dark_hal;
static store_t store, dark_store;
static ledger_t ledger, dark_ledger;
static flash_model_t model, dark_model;

static struct {
    const power_cuts_t *scenario;
    uint32_t cuts, writes, pairs_wanted, pairs_done, at;
    uint32_t seed;
    cut_kind_t kind, second_kind;
    uint32_t second_in, offset;
    bool erase;
} now;

void power_cuts_explain(void) {
    if (now.scenario == NULL || !Unity.CurrentTestFailed) {
        return;
    }
    printf("%s: cut %u (%s at %u) of kind %u, then %u of kind %u, seed %u\n", now.scenario->name,
           (unsigned)now.at, now.erase ? "erase" : "write", (unsigned)now.offset, now.kind,
           (unsigned)now.second_in, now.second_kind, (unsigned)now.seed);
}

/* What is left of the first world when the power goes. */
static void fork_world(cut_kind_t kind, uint32_t offset, const uint8_t *page) {
    mock_flash_copy(&dark_hal, &hal, false);
    flash_model_attach(&dark_model, &dark_hal, now.seed + now.at * CUT_KINDS + kind);
    flash_model_cut(&dark_model, &dark_hal, kind, offset, page);
    ledger_copy(&dark_ledger, &ledger, &dark_store);
    now.kind = kind;
    now.offset = offset;
    now.erase = page == NULL;
}

static void boot_and_check(bool work) {
    memset(&dark_store, 0xCD, sizeof dark_store);
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&dark_store, &dark_hal));
    TEST_ASSERT_TRUE(now.scenario->prepare == NULL || !dark_store.formatted);
    ledger_check(&dark_ledger);
    if (work) {
        ledger_work(&dark_ledger);
    }
    TEST_ASSERT_EQUAL_UINT32(0, dark_store.failures);
    TEST_ASSERT_EQUAL_UINT32(0, dark_hal.flash_misuses);
    store_unmount(&dark_store);
}

static void cut_in_every_way(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    now.at++;
    for (unsigned kind = 0; kind < CUT_KINDS; kind++) {
        if (!ON_TARGET || kind == now.at % CUT_KINDS) {
            fork_world((cut_kind_t)kind, offset, page);
            boot_and_check((now.at + kind) % WORK_EVERY == 0);
            now.cuts++;
        }
    }
}

static void cut_twice(uint32_t offset, const uint8_t *page) {
    fork_world((cut_kind_t)flash_model_random(&model, CUT_KINDS), offset, page);
    now.second_in = 1u + flash_model_random(&model, SECOND_CUT_MAX);
    now.second_kind = (cut_kind_t)flash_model_random(&model, CUT_KINDS);
    dark_model.cut_in = now.second_in;
    dark_model.cut_kind = now.second_kind;
    if (setjmp(flash_model_off) == 0) {
        boot_and_check(true);
        dark_model.cut_in = 0;
    }
    boot_and_check(true);
    now.pairs_done++;
}

static void cut_some_twice(void *context, uint32_t offset, const uint8_t *page) {
    (void)context;
    now.at++;
    while (now.pairs_done < (uint64_t)now.pairs_wanted * now.at / now.writes) {
        cut_twice(offset, page);
    }
}

static void run(const power_cuts_t *scenario, uint32_t seed,
                void (*at_write)(void *context, uint32_t offset, const uint8_t *page)) {
    memset(&now, 0, sizeof now);
    now.scenario = scenario;
    now.seed = seed;
    mock_hal_init(&hal);
    ledger_init(&ledger, &store);
    if (scenario->prepare != NULL) {
        TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
        scenario->prepare(&ledger);
        store_unmount(&store);
    }
    flash_model_attach(&model, &hal, seed);
    model.before_write = at_write;
}

static void play(void) {
    TEST_ASSERT_EQUAL_INT(STORE_OK, store_mount(&store, &hal));
    now.scenario->body(&ledger);
    ledger_check(&ledger);
    TEST_ASSERT_EQUAL_UINT32(0, store.failures);
    TEST_ASSERT_EQUAL_UINT32(0, hal.flash_misuses);
    store_unmount(&store);
}

uint32_t power_cuts_linear(const power_cuts_t *scenario) {
    run(scenario, 1, cut_in_every_way);
    play();
    printf("%s, %s: %u writes and erases, %u cuts\n", mock_flash_name(), scenario->name,
           (unsigned)now.at, (unsigned)now.cuts);
    return now.at;
}

void power_cuts_pairs(const power_cuts_t *scenario, uint32_t writes, uint32_t pairs,
                      uint32_t seed) {
    run(scenario, seed, cut_some_twice);
    now.writes = writes;
    now.pairs_wanted = pairs;
    play();
    TEST_ASSERT_EQUAL_UINT32(writes, now.at);
    TEST_ASSERT_EQUAL_UINT32(pairs, now.pairs_done);
}
