/* Logs over MAVLink FTP: as ULog by their name, as they are stored by the other one. */
#include "ftp_fixture.h"
#include "store/unpacker.h"
#include "unity.h"

#define SLOTS 900u
#define LOG_PATH "/trials/0007.ulg"
#define STORED_PATH "/trials/0007.ulz"
#define CUT_PATH "/trials/0008.ulg"

static uint8_t stored[30000], ulog[40000];
static uint32_t stored_bytes, ulog_bytes;
static trial_log_t log_;
static params_t params;

static uint32_t random_state = 1;
static uint32_t random_below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % limit;
}

static void begin_log(uint32_t trial) {
    const trial_log_header_t header = {
        .trial = trial, .input = "law", .beats = 40, .build_id = "1.0.0", .board = "simulated"};
    params_reset(&params);
    TEST_ASSERT_EQUAL(STORE_OK, trial_log_begin(&log_, &store, &header, &params));
    for (uint32_t i = 0; i < SLOTS; i++) {
        const speed_slot_t slot = {.index = (uint16_t)i,
                                   .samples = 2,
                                   .speed_m_s = 0.07f + 1e-6f * (float)random_below(1000),
                                   .sigma_10um_s = (uint16_t)(60u + random_below(9))};
        trial_log_slot(&log_, 100000u * i, &slot, SPEED_NO_MOTION);
        trial_log_poll(&log_, 100000u * i);
    }
}

/* A whole log, and what it holds. */
static void make_log(void) {
    bool damaged = true;
    begin_log(7);
    TEST_ASSERT_EQUAL(STORE_OK, trial_log_close(&log_));
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&store, LOG_PATH, &stored_bytes));
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&store, LOG_PATH, stored, stored_bytes));
    ulog_bytes = (uint32_t)unpacker_all(stored, stored_bytes, ulog, sizeof ulog, &damaged);
    TEST_ASSERT_FALSE(damaged);
    TEST_ASSERT_GREATER_THAN(2u * stored_bytes, ulog_bytes);
}

static void expect_crc(const char *path, const uint8_t *bytes, uint32_t length) {
    ask_path(FTP_OP_CRC32, path);
    expect_ack();
    TEST_ASSERT_EQUAL_HEX32(crc32_update(0, bytes, length), bytes_get_u32(reply + 12));
}

static void test_both_names_have_their_size_and_crc(void) {
    make_log();
    (void)open_ro(LOG_PATH);
    TEST_ASSERT_EQUAL_UINT32(ulog_bytes, bytes_get_u32(reply + 12));
    (void)open_ro(STORED_PATH);
    TEST_ASSERT_EQUAL_UINT32(stored_bytes, bytes_get_u32(reply + 12));
    expect_crc(LOG_PATH, ulog, ulog_bytes);
    expect_crc(STORED_PATH, stored, stored_bytes);
    char line[60];
    const int length = snprintf(line, sizeof line, "F0007.ulg\t%u", (unsigned)ulog_bytes);
    ask_path(FTP_OP_LIST, "/trials");
    TEST_ASSERT_EQUAL_MEMORY(line, reply + 12, length + 1);
    TEST_ASSERT_EQUAL(length + 1, reply[4]);
}

static void expect_burst(const char *path, const uint8_t *bytes, uint32_t length) {
    const uint8_t session = open_ro(path);
    uint32_t offset = 0;
    while (offset < length) {
        TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, offset, NULL, 239));
        while (ftp_server_burst(&ftp, reply)) {
            expect_ack();
            TEST_ASSERT_EQUAL_UINT32(offset, bytes_get_u32(reply + 8));
            TEST_ASSERT_EQUAL_MEMORY(bytes + offset, reply + 12, reply[4]);
            offset += reply[4];
        }
    }
    TEST_ASSERT_EQUAL_UINT32(length, offset);
}

static void test_bursts_of_both(void) {
    make_log();
    expect_burst(LOG_PATH, ulog, ulog_bytes);
    expect_burst(STORED_PATH, stored, stored_bytes);
}

/* What was lost is asked for between two packets of the burst. */
static void test_reads_anywhere_while_a_burst_runs(void) {
    make_log();
    const uint8_t session = open_ro(LOG_PATH);
    uint32_t offset = 0;
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    while (ftp_server_burst(&ftp, reply)) {
        TEST_ASSERT_EQUAL_MEMORY(ulog + offset, reply + 12, reply[4]);
        offset += reply[4];
        const uint32_t at = random_below(ulog_bytes);
        const uint8_t length = (uint8_t)(1u + random_below(239));
        TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, at, NULL, length));
        expect_ack();
        TEST_ASSERT_EQUAL(length < ulog_bytes - at ? length : ulog_bytes - at, reply[4]);
        TEST_ASSERT_EQUAL_MEMORY(ulog + at, reply + 12, reply[4]);
    }
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, ulog_bytes, NULL, 1));
    expect_nak(FTP_EOF);
}

static void test_a_crc_does_not_disturb_a_session(void) {
    make_log();
    const uint8_t session = open_ro(LOG_PATH);
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 100));
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    expect_crc(LOG_PATH, ulog, ulog_bytes);
    TEST_ASSERT_TRUE(ask(FTP_OP_BURST, session, 50, NULL, 100) == false);
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    TEST_ASSERT_EQUAL_MEMORY(ulog + 50, reply + 12, 100);
}

static void test_while_a_trial_runs(void) {
    make_log();
    ftp.session.conditions = (ftp_conditions_t){.now_us = 1, .read_only = true, .busy_trial = 7};
    const char *const names[] = {LOG_PATH, STORED_PATH};
    for (uint32_t i = 0; i < 2; i++) {
        ask_path(FTP_OP_OPEN_RO, names[i]);
        expect_nak(FTP_PROTECTED);
        ask_path(FTP_OP_CRC32, names[i]);
        expect_nak(FTP_PROTECTED);
    }
    ftp.session.conditions.busy_trial = 9;
    expect_burst(LOG_PATH, ulog, ulog_bytes);
    expect_crc(STORED_PATH, stored, stored_bytes);
    ask_path(FTP_OP_CRC32, LOG_PATH); /* it takes too long */
    expect_nak(FTP_PROTECTED);
    put_file("/trials/0001.ulg", 300);
    ask_path(FTP_OP_CRC32, "/trials/0001.ulg");
    expect_ack();
}

static void test_only_the_ulog_is_removed(void) {
    make_log();
    ask_path(FTP_OP_REMOVE, STORED_PATH);
    expect_nak(FTP_PROTECTED);
    const uint8_t session = open_ro(LOG_PATH);
    ask_path(FTP_OP_REMOVE, LOG_PATH);
    expect_ack();
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 100));
    expect_nak(FTP_NOT_FOUND);
    ask_path(FTP_OP_OPEN_RO, STORED_PATH);
    expect_nak(FTP_NOT_FOUND);
}

/* Of the power: the log is what its last sync saw. */
static void test_a_log_that_a_cut_ended(void) {
    make_log();
    begin_log(8);
    TEST_ASSERT_EQUAL(STORE_OK, store_mount(&store, &hal));
    ftp_server_init(&ftp, &store);
    (void)open_ro(CUT_PATH);
    const uint32_t length = bytes_get_u32(reply + 12);
    TEST_ASSERT_LESS_THAN(ulog_bytes, length);
    TEST_ASSERT_GREATER_THAN(ulog_bytes - 60u * 29u, length);
    ask_path(FTP_OP_CRC32, CUT_PATH);
    expect_ack();
}

static void test_a_log_of_earlier_firmware(void) {
    put_file("/trials/0001.ulg", 1000);
    uint8_t bytes[1000];
    for (size_t i = 0; i < sizeof bytes; i++) {
        bytes[i] = file_byte(i);
    }
    expect_burst("/trials/0001.ulg", bytes, sizeof bytes);
    expect_burst("/trials/0001.ulz", bytes, sizeof bytes);
    expect_crc("/trials/0001.ulz", bytes, sizeof bytes);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_both_names_have_their_size_and_crc);
    RUN_TEST(test_bursts_of_both);
    RUN_TEST(test_reads_anywhere_while_a_burst_runs);
    RUN_TEST(test_a_crc_does_not_disturb_a_session);
    RUN_TEST(test_while_a_trial_runs);
    RUN_TEST(test_only_the_ulog_is_removed);
    RUN_TEST(test_a_log_that_a_cut_ended);
    RUN_TEST(test_a_log_of_earlier_firmware);
    return UNITY_END();
}
