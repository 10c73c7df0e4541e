/*
 * Flipped bits: whatever bit of the store flips while the board is off, the next boot finds the
 * newest state or says that it did not. One bit of every FLIP_STRIDE-th byte of what matters, in
 * the end state of one lifetime; 3, on flashes that erase first, whose stores are larger, 15 or 63:
 * odd, so that all four bytes of words have their turn. FLIP_BITS=8 flips every bit of every used
 * page, in the end state of each scenario; FLIP_LIFETIMES=20 adds lifetimes of other seeds at one
 * bit per byte; FLIP_DAMAGE (100) rounds damage several pages at once.
 *
 * A boot is a function of the bytes it reads: a flip in a byte that the boot of the undamaged store
 * does not read cannot change it. Of those, one per page is flipped all the same.
 */
#include "app_fixture.h"
#include "target.h"

#include <stdio.h>
#include <stdlib.h>

#define SPEED 0.05f
#define TRIALS_MIN 200u
#define PAGES (MOCK_FLASH_BYTES / STORE_PAGE_BYTES)
#define SAMPLE_AT 200u /* of the bytes of a page that are not read, this one */
#define WIDE_RAD 0.7f
#define NARROW_RAD 0.2f

typedef enum { KEY_SET, KEY_REPLACED, LIMIT_NARROWED, LEARNED, EXECUTED, SCENARIOS } scenario_t;

static const char *const names[SCENARIOS] = {"key set", "key replaced", "limit narrowed", "learned",
                                             "trial executed"};

/* What lasts, as a boot finds it. */
typedef struct {
    bool locked, keyed;
    uint8_t key[SIGNING_KEY_BYTES];
    params_t params;
    memory_t memory;
    uint32_t reference_crc, pending, next_trial;
} knowledge_t;

typedef struct {
    uint32_t flips, unread, unchanged, reported, silent, open, revoked, wider;
} tally_t;

static uint8_t whole[MOCK_FLASH_BYTES]; /* as the board was switched off */
static bool written[PAGES], touched[PAGES], watching, is_read[MOCK_FLASH_BYTES];
static knowledge_t expected;
static uint32_t random_state, seed;

void setUp(void) {}
void tearDown(void) {}

static uint32_t random_below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % limit;
}

static uint32_t wish(const char *name, uint32_t otherwise) {
    const char *text = getenv(name);
    return text != NULL ? (uint32_t)strtoul(text, NULL, 10) : otherwise;
}

static bool note_write(hal_t *board, uint32_t offset, const uint8_t *page) {
    memcpy(board->flash + offset, page, STORE_PAGE_BYTES);
    written[offset / STORE_PAGE_BYTES] = touched[offset / STORE_PAGE_BYTES] = true;
    return true;
}

static bool note_erase(hal_t *board, uint32_t offset) {
    memset(board->flash + offset, 0xFF, MOCK_FLASH_ERASE_BYTES);
    for (uint32_t at = offset; at < offset + MOCK_FLASH_ERASE_BYTES; at += STORE_PAGE_BYTES) {
        touched[at / STORE_PAGE_BYTES] = true;
    }
    return true;
}

static void note_read(hal_t *board, uint32_t offset, uint8_t *read, uint32_t length) {
    (void)board;
    (void)read;
    if (watching) {
        memset(is_read + offset, true, length);
    }
}

static void boot(void) {
    hal.tx[0].head = hal.tx[0].tail = hal.tx[1].head = hal.tx[1].tail = 0;
    reboot();
}

static void execute(void) {
    const uint32_t trial = app.trial.next;
    swim_speed_m_s = 0.03f + 0.001f * (float)random_below(20);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    run_ticks_ms(200);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, trial));
    run_ticks_ms(app.learner.reference.beats * 1000u + 5000u);
    TEST_ASSERT_TRUE(app.trial.run.pending);
}

static void learn(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_LEARN, app.trial.run.trial.number));
}

static void save_limit(float limit_rad) {
    TEST_ASSERT_EQUAL(FAULT_NONE, commands_param_set(&app, PARAM_AMP_MAX_RAD, limit_rad));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_PARAMS_SAVE, 0));
}

static void set_key(uint8_t first) {
    const uint8_t key[SIGNING_KEY_BYTES] = {first, 2, 3};
    TEST_ASSERT_EQUAL(FAULT_NONE,
                      commands_set_key(&app, key, 1000u + app.link.outbox.signing.mark));
}

static void begin_life(scenario_t scenario) {
    fixture_reset();
    memset(written, 0, sizeof written);
    hal.flash_write = note_write;
    hal.flash_erase = note_erase;
    hal.flash_read = note_read;
    boot();
    if (scenario != KEY_SET) {
        set_key(1);
    }
    save_limit(WIDE_RAD);
    const uint16_t beats = (uint16_t)(4u + random_below(5));
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(beats, SPEED));
}

/* The folders move to other blocks meanwhile, and the log files go round the whole flash. */
static void live(scenario_t scenario) {
    begin_life(scenario);
    const uint32_t trials = TRIALS_MIN + random_below(12);
    for (uint32_t i = 0; i < trials; i++) {
        execute();
        learn();
        if (random_below(6) == 0) {
            boot();
        }
        if (random_below(20) == 0) {
            save_limit(WIDE_RAD);
        }
    }
    switch (scenario) {
    case KEY_SET:
    case KEY_REPLACED:
        set_key(9);
        break;
    case LIMIT_NARROWED:
        save_limit(NARROW_RAD);
        break;
    case LEARNED:
        execute();
        learn();
        break;
    case EXECUTED:
        execute();
        break;
    case SCENARIOS:
        break;
    }
    memcpy(whole, hal.flash, sizeof whole);
}

static knowledge_t known(void) {
    knowledge_t knowledge;
    memset(&knowledge, 0, sizeof knowledge);
    knowledge.locked = app.link.outbox.signing.locked;
    knowledge.keyed = app.link.outbox.signing.keyed;
    if (knowledge.keyed) {
        memcpy(knowledge.key, app.link.outbox.signing.out.secret_key, SIGNING_KEY_BYTES);
    }
    knowledge.params = app.params;
    knowledge.memory = app.learner.memory;
    knowledge.reference_crc = app.learner.reference.crc;
    knowledge.pending = app.trial.run.pending ? app.trial.run.trial.number : 0;
    knowledge.next_trial = app.trial.next;
    return knowledge;
}

/* The flash as it was, but for what the caller damaged: those pages are in |touched|. */
static void put_back(void) {
    for (uint32_t page = 0; page < PAGES; page++) {
        if (touched[page]) {
            const uint32_t at = page * STORE_PAGE_BYTES;
            memcpy(hal.flash + at, whole + at, STORE_PAGE_BYTES);
            touched[page] = false;
        }
    }
}

/* Boots what the damage left, judges it and puts the flash back. */
static bool judge(tally_t *tally) {
    boot();
    const knowledge_t found = known();
    const bool said = app.supervisor.state == STATE_FAULT;
    const bool same = memcmp(&found, &expected, sizeof found) == 0;
    const bool silent = !same && !said;
    tally->flips++;
    tally->unchanged += same && !said;
    tally->reported += said;
    tally->silent += silent;
    const bool open = !found.locked;
    const bool revoked = found.keyed && memcmp(found.key, expected.key, SIGNING_KEY_BYTES) != 0;
    const bool wider =
        found.params.value[PARAM_AMP_MAX_RAD] > expected.params.value[PARAM_AMP_MAX_RAD];
    tally->open += open;
    tally->revoked += revoked;
    tally->wider += wider;
    put_back();
    return silent || open || revoked || wider;
}

static void expect_what_is_there(void) {
    memset(touched, 0, sizeof touched);
    memset(is_read, 0, sizeof is_read);
    watching = true;
    boot();
    watching = false;
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    expected = known();
    TEST_ASSERT_TRUE(expected.locked);
    put_back();
}

static void flip(uint32_t at, uint32_t bit, tally_t *tally) {
    hal.flash[at] ^= (uint8_t)(1u << bit);
    touched[at / STORE_PAGE_BYTES] = true;
    if (judge(tally)) {
        printf("seed %u: bit %u of byte %u (block %u) is not told: reason %u\n", (unsigned)seed,
               (unsigned)bit, (unsigned)at, (unsigned)(at / BLOCK_BYTES),
               (unsigned)app.supervisor.reason);
    }
}

/* Pages with metadata, witness or critical records: what a lifetime in make test flips. */
static bool matters(uint32_t page) {
    const uint32_t block = page * STORE_PAGE_BYTES / BLOCK_BYTES;
    const uint8_t *first = whole + block * BLOCK_BYTES;
    const bool log = memcmp(first, "ULog", 4) == 0;
    const bool metadata = memcmp(first + 4, "\xF0\x0F\xFF\xF7", 4) == 0 || first[7] == 0xF7u;
    return written[page] && !log &&
           (block >= DATA_BLOCKS || metadata || memcmp(first, "TB", 2) == 0);
}

/* |bits| of 8 of each byte. */
static void flip_all(uint32_t bits, bool only_what_matters, tally_t *tally) {
    const uint32_t of_erased_first = BLOCK_BYTES > 4096u ? 63u : 15u;
    const uint32_t stride = wish("FLIP_STRIDE", MOCK_FLASH_ERASES_FIRST ? of_erased_first : 3u);
    for (uint32_t at = 0; at < MOCK_FLASH_BYTES; at++) {
        const uint32_t page = at / STORE_PAGE_BYTES;
        if (only_what_matters ? !matters(page) : !written[page]) {
            continue;
        }
        const uint32_t first = bits == 8u ? 0u : random_below(8);
        if ((!is_read[at] && at % STORE_PAGE_BYTES != SAMPLE_AT) ||
            (only_what_matters && at % stride != 0)) {
            tally->unread += bits;
            continue;
        }
        for (uint32_t i = 0; i < bits; i++) {
            flip(at, (first + i) % 8u, tally);
        }
    }
}

static void print_tally(const char *what, const tally_t *tally) {
    printf("%s, seed %u: %u cases, %u in bytes not read or left out, %u booted: %u unchanged, %u "
           "reported, %u "
           "silent, %u open, %u revoked, %u "
           "wider\n",
           what, (unsigned)seed, (unsigned)(tally->flips + tally->unread), (unsigned)tally->unread,
           (unsigned)tally->flips, (unsigned)tally->unchanged, (unsigned)tally->reported,
           (unsigned)tally->silent, (unsigned)tally->open, (unsigned)tally->revoked,
           (unsigned)tally->wider);
}

static void require_none(const char *what, const tally_t *tally) {
    print_tally(what, tally);
    TEST_ASSERT_EQUAL_UINT32(0, tally->silent);
    TEST_ASSERT_EQUAL_UINT32(0, tally->open);
    TEST_ASSERT_EQUAL_UINT32(0, tally->revoked);
    TEST_ASSERT_EQUAL_UINT32(0, tally->wider);
    TEST_ASSERT_GREATER_THAN_UINT32(0, tally->reported);
}

static void begin(uint32_t with, scenario_t scenario) {
    seed = random_state = with;
    live(scenario);
    expect_what_is_there();
}

static void test_a_flipped_bit_is_told(void) {
    tally_t tally = {0};
    begin(wish("FLIP_SEED", 1), (scenario_t)wish("FLIP_SCENARIO", KEY_REPLACED));
    flip_all(1, true, &tally);
    require_none("one bit of a byte", &tally);
}

static void test_every_bit_of_every_scenario(void) {
    const uint32_t bits = wish("FLIP_BITS", 0);
    for (uint32_t scenario = 0; bits != 0 && scenario < SCENARIOS; scenario++) {
        tally_t tally = {0};
        begin(1000u + scenario, (scenario_t)scenario);
        flip_all(bits, false, &tally);
        require_none(names[scenario], &tally);
    }
}

static void test_other_lifetimes(void) {
    const uint32_t lifetimes = wish("FLIP_LIFETIMES", 0);
    for (uint32_t i = 0; i < lifetimes; i++) {
        tally_t tally = {0};
        begin(2000u + i, (scenario_t)(i % SCENARIOS));
        flip_all(1, false, &tally);
        require_none(names[i % SCENARIOS], &tally);
    }
}

static void damage_page(uint32_t page) {
    uint8_t *at = hal.flash + page * STORE_PAGE_BYTES;
    const uint32_t kind = random_below(4);
    for (uint32_t i = 0; i < STORE_PAGE_BYTES; i++) {
        const uint8_t noise = (uint8_t)random_below(256);
        at[i] = kind == 0   ? 0xFFu
                : kind == 1 ? 0x00u
                : kind == 2 ? noise
                            : (uint8_t)(at[i] ^ (random_below(64) == 0 ? 1u << noise % 8u : 0u));
    }
    touched[page] = true;
}

/* Of a flash that is far larger than what is stored, a page that holds something. */
static uint32_t random_page(void) {
    uint32_t page = random_below(PAGES);
    while (MOCK_FLASH_ERASES_FIRST && !written[page]) {
        page = random_below(PAGES);
    }
    return page;
}

/* Up to 16 pages at once, each in one of four ways. */
static void test_damaged_pages_are_told(void) {
    const uint32_t rounds = wish("FLIP_DAMAGE", 100);
    tally_t tally = {0};
    const uint32_t lifetimes = rounds < 1000u ? 1u : SCENARIOS;
    for (uint32_t scenario = 0; scenario < lifetimes; scenario++) {
        begin(3000u + scenario, (scenario_t)scenario);
        for (uint32_t round = 0; round < rounds / lifetimes; round++) {
            for (uint32_t pages = 1u + random_below(16); pages != 0; pages--) {
                damage_page(random_page());
            }
            (void)judge(&tally);
        }
    }
    require_none("random pages", &tally);
}

int main(void) {
    UNITY_BEGIN();
    RUN_ON_HOST(test_a_flipped_bit_is_told);
    RUN_ON_HOST(test_damaged_pages_are_told);
    RUN_ON_HOST(test_every_bit_of_every_scenario);
    RUN_ON_HOST(test_other_lifetimes);
    return UNITY_END();
}
