/*
 * The signing key in flash: set, kept, renewed, lost. The power is cut at every page write of a
 * life with a key; after the next boot somebody replays all that he recorded before.
 */
#include "app_fixture.h"
#include "link/ftp_paths.h"
#include "target.h"

#include <stdio.h>

#define SECOND ((uint64_t)SIGNING_TICKS_PER_S)
#define YEAR (SECOND * 31536000u)
#define TODAY (11u * YEAR)
#define FRAMES_MAX 64u
#define CUTS_MAX 200u
#define PAGE STORE_PAGE_BYTES

static const uint8_t key_a[SIGNING_KEY_BYTES] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14};
static const uint8_t key_b[SIGNING_KEY_BYTES] = {31, 32, 33, 34, 35, 36, 37, 38, 39, 40, 41};

typedef struct {
    uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
    size_t length;
    hal_port_t port;
} recorded_t;

static recorded_t recorded[FRAMES_MAX];
static uint32_t frames, obeyed;
static mavlink_signing_t sender;
static mavlink_status_t sender_status;

static void use_key(const uint8_t *key) {
    memset(&sender, 0, sizeof sender);
    memset(&sender_status, 0, sizeof sender_status);
    memcpy(sender.secret_key, key, SIGNING_KEY_BYTES);
    sender.flags = MAVLINK_SIGNING_FLAG_SIGN_OUTGOING;
    sender.link_id = 1;
    sender_status.signing = &sender;
}

void setUp(void) {
    fixture_reset();
    host_alive = camera_on = false;
    frames = obeyed = 0;
    use_key(key_a);
}

void tearDown(void) {}

static uint64_t clock_now(void) { return signing_clock(&app.link.outbox.signing, hal.now_us); }

static fault_t set_key(const uint8_t *key, uint64_t time) {
    return app.link.handlers.set_key(app.link.handlers.context, key, time);
}

/* What flash holds, whatever RAM says. */
static key_record_t stored(void) {
    static uint8_t bytes[RECORD_KEY_MAX_BYTES];
    key_record_t record = {0};
    uint32_t length = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, KEY_PATH, &length));
    TEST_ASSERT_LESS_OR_EQUAL(sizeof bytes, length);
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&app.vault.store, KEY_PATH, bytes, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, record_decode_key(bytes, length, &record));
    return record;
}

static bool power_is_on(void) {
    return hal.flash_fail_after == 0 || hal.flash_writes < hal.flash_fail_after;
}

static void send_and_record(hal_port_t port, const mavlink_message_t *message) {
    TEST_ASSERT_LESS_THAN_UINT32(FRAMES_MAX, frames);
    if (power_is_on()) {
        recorded_t *frame = &recorded[frames++];
        frame->length = mavlink_msg_to_send_buffer(frame->bytes, message);
        frame->port = port;
        mock_feed(&hal, port, frame->bytes, frame->length);
        run_ms(20);
    }
}

static void say_clear(uint64_t time) {
    mavlink_message_t message;
    const mavlink_command_long_t fields = {.command = TAILBEAT_CMD_CLEAR, .target_system = 1};
    sender.timestamp = time;
    mavlink_msg_command_long_encode_status(HOST_SYSTEM, 190, &sender_status, &message, &fields);
    send_and_record(HAL_PORT_RADIO, &message);
}

static void say_key(const uint8_t *key, uint64_t time) {
    mavlink_message_t message;
    sender.timestamp = time;
    mavlink_msg_setup_signing_pack_status(HOST_SYSTEM, 190, &sender_status, &message, 1, 1, key,
                                          TODAY);
    send_and_record(HAL_PORT_CONSOLE, &message);
}

static fault_t obey(void *context, const link_command_t *command) {
    obeyed++;
    return commands_run(context, command);
}

static void boot(void) {
    reboot();
    app.link.handlers.command = obey;
}

static void test_a_key_is_stored_before_it_counts(void) {
    TEST_ASSERT_EQUAL(FAULT_NONE, set_key(key_a, TODAY));
    const key_record_t record = stored();
    TEST_ASSERT_TRUE(record.set);
    TEST_ASSERT_EQUAL_MEMORY(key_a, record.key, sizeof key_a);
    TEST_ASSERT_EQUAL_UINT64(TODAY + SIGNING_RESERVE_TICKS, record.mark);
    TEST_ASSERT_EQUAL_UINT64(record.mark, app.link.outbox.signing.mark);
    TEST_ASSERT_EQUAL_UINT64(TODAY, clock_now());
    for (size_t i = 0; i + 4 <= sizeof app.vault.record; i++) {
        TEST_ASSERT_NOT_EQUAL(0, memcmp(app.vault.record + i, key_a, 4));
    }
}

static void test_a_boot_goes_on_from_the_mark(void) {
    (void)set_key(key_a, TODAY);
    for (uint32_t n = 1; n <= 5; n++) {
        boot();
        TEST_ASSERT_TRUE(app.link.outbox.signing.keyed);
        TEST_ASSERT_EQUAL_UINT64(TODAY + n * SIGNING_RESERVE_TICKS, clock_now());
        TEST_ASSERT_EQUAL_UINT64(clock_now() + SIGNING_RESERVE_TICKS, stored().mark);
        TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    }
}

static void test_erased_and_set_again(void) {
    (void)set_key(key_a, TODAY);
    boot();
    const uint64_t mark = stored().mark;
    TEST_ASSERT_EQUAL(FAULT_NONE, set_key(NULL, 0));
    TEST_ASSERT_FALSE(app.link.outbox.signing.locked);
    const key_record_t record = stored();
    TEST_ASSERT_FALSE(record.set);
    TEST_ASSERT_EACH_EQUAL_HEX8(0, record.key, sizeof record.key);
    TEST_ASSERT_EQUAL_UINT64(mark + 1u, record.mark); /* newer than any copy with the key */
    boot();
    TEST_ASSERT_FALSE(app.link.outbox.signing.locked);
    TEST_ASSERT_EQUAL(FAULT_NONE, set_key(key_a, 0)); /* no earlier than it was */
    TEST_ASSERT_EQUAL_UINT64(mark + 1u, clock_now());
}

/* The mark is lost with the chip's content: the host's clock keeps the old frames dead. */
static void test_an_old_key_after_a_chip_erase(void) {
    (void)set_key(key_a, TODAY);
    boot();
    say_clear(clock_now() + 5u);
    TEST_ASSERT_EQUAL_UINT32(1, obeyed);
    memset(hal.flash, 0xFF, sizeof hal.flash);
    boot();
    TEST_ASSERT_EQUAL(FAULT_NONE, set_key(key_a, TODAY + 3600u * SECOND));
    mock_feed(&hal, HAL_PORT_RADIO, recorded[0].bytes, recorded[0].length);
    run_ms(100);
    TEST_ASSERT_EQUAL_UINT32(1, obeyed);
}

static void test_a_time_that_makes_no_sense(void) {
    TEST_ASSERT_EQUAL(FAULT_BAD_DATA, set_key(key_a, SIGNING_TIME_MAX));
    TEST_ASSERT_EQUAL(FAULT_BAD_DATA, set_key(key_a, UINT64_MAX));
    TEST_ASSERT_EQUAL(FAULT_BAD_DATA, set_key(key_a, SIGNING_JUMP_MAX_TICKS + 1u));
    TEST_ASSERT_FALSE(app.link.outbox.signing.locked);
    TEST_ASSERT_EQUAL(FAULT_NONE, set_key(key_a, SIGNING_JUMP_MAX_TICKS));
}

/* Older versions of the file, which a boot would go back to. */
static void spoil_copies(void) {
    key_record_t record;
    for (uint32_t at = 0; at < MOCK_FLASH_BYTES; at += BLOCK_BYTES) {
        if (record_decode_key(hal.flash + at, RECORD_KEY_MAX_BYTES, &record) == FAULT_NONE) {
            hal.flash[at + 21u] ^= 0x5A;
        }
    }
}

static void expect_locked(void) {
    spoil_copies();
    boot();
    TEST_ASSERT_TRUE(app.link.outbox.signing.locked);
    TEST_ASSERT_FALSE(app.link.outbox.signing.keyed);
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_KEY_UNREADABLE, app.supervisor.reason);
}

static void test_a_key_that_cannot_be_read(void) {
    static uint8_t bytes[sizeof app.vault.record + 1u];
    (void)set_key(key_a, TODAY);
    TEST_ASSERT_EQUAL(STORE_OK,
                      store_load(&app.vault.store, KEY_PATH, bytes, RECORD_KEY_MAX_BYTES));
    static const size_t lengths[] = {0, 20, RECORD_KEY_MAX_BYTES - 1u, sizeof bytes};
    for (size_t i = 0; i < 4; i++) {
        TEST_ASSERT_EQUAL(STORE_OK, store_replace(&app.vault.store, KEY_PATH, bytes, lengths[i]));
        expect_locked();
    }
    for (size_t bit = 0; bit < 8u * RECORD_KEY_MAX_BYTES; bit += 7) {
        bytes[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
        TEST_ASSERT_EQUAL(STORE_OK,
                          store_replace(&app.vault.store, KEY_PATH, bytes, RECORD_KEY_MAX_BYTES));
        expect_locked();
        bytes[bit / 8u] ^= (uint8_t)(1u << bit % 8u);
    }
    say_clear(TODAY + YEAR);
    TEST_ASSERT_EQUAL_UINT32(0, obeyed);
    sender.flags = 0; /* nobody can sign with a key that nobody can read */
    say_key(key_b, 0);
    TEST_ASSERT_TRUE(app.link.outbox.signing.keyed);
    use_key(key_b);
    say_clear(clock_now() + 5u);
    TEST_ASSERT_EQUAL_UINT32(1, obeyed);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
}

static void test_only_with_the_tail_off(void) {
    (void)set_key(key_a, TODAY);
    host_alive = camera_on = true;
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(5, 0.03f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, set_key(key_b, TODAY));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_START, app.trial.next));
    run_ms(3000);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, set_key(NULL, TODAY));
    (void)command(LINK_COMMAND_ABORT, 0); /* ABORTED, but its file is still open */
    TEST_ASSERT_EQUAL(STATE_ABORTED, app.supervisor.state);
    TEST_ASSERT_EQUAL(FAULT_WRONG_STATE, set_key(key_b, TODAY));
    TEST_ASSERT_EQUAL_MEMORY(key_a, app.link.outbox.signing.out.secret_key, sizeof key_a);
    run_ms(5000);
    TEST_ASSERT_FALSE(app.trial.run.open);
    TEST_ASSERT_EQUAL(FAULT_NONE, set_key(key_b, TODAY));
}

/* The reserve is made before the tail moves; then nothing is, whatever is asked for. */
static void test_no_mark_is_written_while_swimming(void) {
    (void)set_key(key_a, TODAY);
    host_alive = camera_on = true;
    run_ms(1000);
    start_trial(20, 0.03f);
    const uint64_t mark = app.link.outbox.signing.mark;
    TEST_ASSERT_GREATER_OR_EQUAL_UINT64(clock_now() + 20u * SECOND + SIGNING_RESERVE_TICKS / 2u,
                                        mark);
    run_ms(1000);
    say_clear(TODAY + YEAR);
    run_ms(15000);
    TEST_ASSERT_EQUAL(STATE_RUNNING, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT64(mark, app.link.outbox.signing.mark);
    TEST_ASSERT_EQUAL_UINT64(mark, stored().mark);
    say_clear(clock_now() + 5u); /* whoever has the board's time is believed all the while */
    TEST_ASSERT_EQUAL_UINT32(1, app.link.outbox.signing.counters.stale);
    run_ms(10000);
    TEST_ASSERT_EQUAL(STATE_IDLE, app.supervisor.state);
    TEST_ASSERT_EQUAL_UINT64(TODAY + YEAR + 2u * SIGNING_RESERVE_TICKS, stored().mark);
}

/* 512 beats of 1 s and 30 s of rest are longer than the reserve. */
static void test_the_longest_swim_is_reserved_for(void) {
    (void)set_key(key_a, TODAY);
    TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(BEATS_MAX, 0.002f));
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_ARM, 0));
    const uint64_t needed = clock_now() + BEATS_MAX * SECOND + SIGNING_RESERVE_TICKS / 2u;
    TEST_ASSERT_GREATER_OR_EQUAL_UINT64(needed, stored().mark);
    TEST_ASSERT_EQUAL_UINT64(stored().mark, app.link.outbox.signing.mark);
}

static void test_renewed_in_time_and_seldom(void) {
    (void)set_key(key_a, TODAY);
    const uint32_t before = hal.flash_writes;
    uint32_t renewals = 0;
    for (uint32_t minute = 0; minute < 60; minute++) {
        const uint64_t mark = app.link.outbox.signing.mark;
        hal.now_us += 59000000;
        run_ms(1000);
        renewals += app.link.outbox.signing.mark != mark ? 1u : 0u;
        TEST_ASSERT_GREATER_OR_EQUAL_UINT64(clock_now() + 4u * 60u * SECOND,
                                            app.link.outbox.signing.mark);
    }
    printf("an hour of IDLE: %u renewals, %u page writes\n", (unsigned)renewals,
           (unsigned)(hal.flash_writes - before));
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(12, renewals);
}

/* Nothing is believed beyond what could be stored, and the flash is not hammered. */
static void test_a_mark_that_cannot_be_stored(void) {
    (void)set_key(key_a, TODAY);
    boot();
    const uint64_t mark = app.link.outbox.signing.mark;
    hal.flash_fail_after = hal.flash_writes;
    uint32_t tries = app.vault.store.failures;
    for (uint32_t i = 0; i < 20; i++) {
        mavlink_message_t message;
        const mavlink_heartbeat_t fields = {.type = MAV_TYPE_GCS};
        uint8_t bytes[MAVLINK_MAX_PACKET_LEN];
        sender.timestamp = mark + YEAR + i;
        mavlink_msg_heartbeat_encode_status(HOST_SYSTEM, 190, &sender_status, &message, &fields);
        mock_feed(&hal, HAL_PORT_RADIO, bytes, mavlink_msg_to_send_buffer(bytes, &message));
        run_ms(1000);
    }
    TEST_ASSERT_EQUAL_UINT64(mark, app.link.outbox.signing.mark);
    TEST_ASSERT_EQUAL_UINT32(20, app.link.outbox.signing.counters.stale);
    tries = app.vault.store.failures - tries;
    TEST_ASSERT_GREATER_OR_EQUAL_UINT32(2, tries);
    TEST_ASSERT_LESS_OR_EQUAL_UINT32(4, tries);
    TEST_ASSERT_EQUAL(FAULT_STORAGE, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_STORAGE, set_key(key_b, TODAY));
    TEST_ASSERT_EQUAL(FAULT_STORAGE, set_key(NULL, TODAY));
    TEST_ASSERT_EQUAL_MEMORY(key_a, app.link.outbox.signing.out.secret_key, sizeof key_a);
    hal.flash_fail_after = 0;
    run_ms(11000);
    TEST_ASSERT_GREATER_THAN_UINT64(mark, app.link.outbox.signing.mark);
}

/* A store that cannot be mounted does not tell whether there is a key; nor does it hold a
 * reference, so whoever is obeyed, nothing swims. */
static void test_without_its_store_nothing_swims(void) {
    (void)set_key(key_a, TODAY);
    hal.flash_fail_after = hal.flash_writes;
    memset(hal.flash, 0x55, sizeof hal.flash);
    boot();
    TEST_ASSERT_EQUAL(FAULT_STORAGE, app.supervisor.reason);
    TEST_ASSERT_EQUAL(FAULT_NONE, command(LINK_COMMAND_CLEAR, 0));
    TEST_ASSERT_EQUAL(FAULT_NO_REFERENCE, command(LINK_COMMAND_ARM, 0));
    TEST_ASSERT_EQUAL(FAULT_STORAGE, set_key(key_b, TODAY));
    const size_t length = encode_flat_reference(5, 0.04f);
    TEST_ASSERT_NOT_EQUAL(
        STORE_OK, store_replace(&app.vault.store, "/in/reference.bin", upload_bytes, length));
    TEST_ASSERT_EQUAL(STATE_FAULT, app.supervisor.state);
}

static void test_files_and_crashes_do_not_tell_the_key(void) {
    char path[STORE_PATH_BYTES];
    static const char *const spellings[] = {
        "/key.bin", "key.bin", "/key.bin.new", "/in/key.bin", "/trials/../key.bin", "//key.bin"};
    for (size_t i = 0; i < sizeof spellings / sizeof spellings[0]; i++) {
        const uint8_t length = (uint8_t)strlen(spellings[i]);
        TEST_ASSERT_EQUAL(FTP_PATH_HIDDEN,
                          ftp_path_parse((const uint8_t *)spellings[i], length, path));
    }
    (void)set_key(key_b, TODAY);
    hal.crashed = true;
    hal.crash = (hal_crash_t){.kind = HAL_CRASH_ASSERTION, .stack_words = HAL_CRASH_STACK_WORDS};
    uint8_t *stack = (uint8_t *)hal.crash.stack;
    for (uint32_t i = 0; i < SIGNING_KEY_BYTES; i++) {
        stack[3u + i] = key_b[i];         /* as it came in */
        stack[64u + (i ^ 3u)] = key_b[i]; /* as it is hashed */
    }
    memcpy(&hal.crash.registers[0], key_b + 4, 4);
    stack[1] = 0x77;
    boot();
    TEST_ASSERT_EQUAL(FAULT_CRASH, app.supervisor.reason);
    static uint8_t bytes[1024];
    crash_report_t report;
    uint32_t length = 0;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&app.vault.store, CRASH_PATH, &length));
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&app.vault.store, CRASH_PATH, bytes, length));
    TEST_ASSERT_EQUAL(FAULT_NONE, record_decode_crash(bytes, length, &report));
    TEST_ASSERT_EQUAL_HEX32(0x7700, report.crash.stack[0]);
    TEST_ASSERT_EACH_EQUAL_HEX32(0, report.crash.stack + 1, HAL_CRASH_STACK_WORDS - 1u);
    TEST_ASSERT_EQUAL_HEX32(0, report.crash.registers[0]);
    TEST_ASSERT_EQUAL_UINT32(HAL_CRASH_ASSERTION, report.crash.kind);
}

/* A life with a key: a boot, commands, a host of another time, another key, a swim to come. */
static void live(void) {
    boot();
    say_clear(clock_now() + 5u);
    say_clear(clock_now() + SIGNING_RESERVE_TICKS - 6u * SECOND); /* takes the clock along */
    say_clear(clock_now() + 5u);
    say_clear(app.link.outbox.signing.mark + YEAR); /* asks for a later mark */
    say_clear(clock_now() + 5u);
    say_key(key_b, clock_now() + 5u);
    use_key(key_b);
    say_clear(clock_now() + 5u);
    if (power_is_on()) {
        (void)command(LINK_COMMAND_ARM, 0);
        (void)command(LINK_COMMAND_DISARM, 0);
    }
    say_clear(app.link.outbox.signing.mark);
    say_key(key_a, clock_now() + 5u);
    use_key(key_a);
    say_clear(clock_now() + 5u);
}

static uint8_t start[MOCK_FLASH_BYTES], after_cut[MOCK_FLASH_BYTES];
static uint8_t one_page_more[MOCK_FLASH_BYTES];

/* True when it came to its end before the cut. */
static bool live_until(uint32_t pages) {
    memcpy(hal.flash, start, sizeof start);
    frames = 0;
    use_key(key_a);
    hal.flash_writes = 1; /* a limit of 0 would mean none */
    hal.flash_fail_after = 1u + pages;
    live();
    const bool finished = power_is_on();
    hal.flash_fail_after = 0;
    return finished;
}

/* The page that was being written holds half of the new over the old. */
static void tear_page(void) {
    for (uint32_t at = 0; at < MOCK_FLASH_BYTES; at += PAGE) {
        if (memcmp(after_cut + at, one_page_more + at, PAGE) != 0) {
            memcpy(hal.flash + at, one_page_more + at, PAGE / 2u);
            return;
        }
    }
}

static void replay_everything(void) {
    boot();
    TEST_ASSERT_TRUE(app.link.outbox.signing.keyed);
    TEST_ASSERT_EQUAL_UINT64(stored().mark, app.link.outbox.signing.mark);
    obeyed = 0;
    const uint8_t key_before = app.link.outbox.signing.out.secret_key[0];
    for (uint32_t turn = 0; turn < 2; turn++) {
        for (uint32_t i = 0; i < frames; i++) {
            mock_feed(&hal, recorded[i].port, recorded[i].bytes, recorded[i].length);
            run_ms(20);
        }
    }
    TEST_ASSERT_EQUAL_UINT32(0, obeyed);
    TEST_ASSERT_EQUAL_UINT8(key_before, app.link.outbox.signing.out.secret_key[0]);
}

static void test_power_cut_and_replay(void) {
    uint32_t cuts = 0, attacks = 0, replayed = 0;
    for (uint32_t age = 0; age < 4; age++) {
        setUp();
        TEST_ASSERT_EQUAL(FAULT_NONE, upload_flat_reference(20, 0.03f));
        for (uint32_t i = 0; i <= 2u * age; i++) {
            TEST_ASSERT_EQUAL(FAULT_NONE, set_key(key_a, TODAY));
        }
        memcpy(start, hal.flash, sizeof start);
        bool finished = false;
        for (uint32_t cut = 0; !finished; cut++) {
            TEST_ASSERT_LESS_THAN_UINT32(CUTS_MAX, cut);
            (void)live_until(cut + 1u);
            memcpy(one_page_more, hal.flash, sizeof one_page_more);
            finished = live_until(cut);
            memcpy(after_cut, hal.flash, sizeof after_cut);
            replay_everything();
            memcpy(hal.flash, after_cut, sizeof after_cut);
            tear_page();
            replay_everything();
            attacks += 2;
            replayed += 4u * frames;
            cuts += finished ? 0u : 1u;
        }
        TEST_ASSERT_EQUAL_UINT32(10, frames); /* the whole life, at the end */
    }
    printf("key: %u cuts, %u attacks, %u frames replayed\n", (unsigned)cuts, (unsigned)attacks,
           (unsigned)replayed);
}

/* Pieces of the key at either end of the bytes and in their middle; what lies behind stays. */
static void test_pieces_of_the_key_are_hidden_wherever_they_lie(void) {
    (void)set_key(key_a, TODAY);
    for (size_t at = 0; at <= 12; at++) {
        uint8_t bytes[17];
        memset(bytes, 0xEE, sizeof bytes);
        memcpy(bytes + at, key_a + 9, 4);
        keyring_hide(&app.keyring, bytes, 16);
        for (size_t i = 0; i < sizeof bytes; i++) {
            TEST_ASSERT_EQUAL_HEX8(i >= at && i < at + 4 ? 0 : 0xEE, bytes[i]);
        }
    }
    /* Three bytes are no piece, even where the fourth of the key follows behind the end. */
    uint8_t bytes[17];
    memset(bytes, 0xEE, sizeof bytes);
    memcpy(bytes + 13, key_a + 9, 4);
    keyring_hide(&app.keyring, bytes, 16);
    TEST_ASSERT_EQUAL_MEMORY(key_a + 9, bytes + 13, 4);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_a_key_is_stored_before_it_counts);
    RUN_TEST(test_a_boot_goes_on_from_the_mark);
    RUN_TEST(test_erased_and_set_again);
    RUN_TEST(test_an_old_key_after_a_chip_erase);
    RUN_TEST(test_a_time_that_makes_no_sense);
    RUN_TEST(test_a_key_that_cannot_be_read);
    RUN_TEST(test_only_with_the_tail_off);
    RUN_TEST(test_no_mark_is_written_while_swimming);
    RUN_TEST(test_the_longest_swim_is_reserved_for);
    RUN_TEST(test_renewed_in_time_and_seldom);
    RUN_TEST(test_a_mark_that_cannot_be_stored);
    RUN_TEST(test_without_its_store_nothing_swims);
    RUN_TEST(test_files_and_crashes_do_not_tell_the_key);
    RUN_ON_HOST(test_power_cut_and_replay);
    RUN_TEST(test_pieces_of_the_key_are_hidden_wherever_they_lie);
    return UNITY_END();
}
