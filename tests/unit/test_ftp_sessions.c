#include "ftp_fixture.h"

static void test_uploads_out_of_order(void) {
    const uint8_t session = create("/in/reference.bin");
    uint8_t piece[100];
    static const uint32_t order[] = {2, 0, 1, 3, 1};
    for (size_t i = 0; i < sizeof order / sizeof order[0]; i++) {
        for (size_t k = 0; k < sizeof piece; k++) {
            piece[k] = file_byte(order[i] * 100 + k);
        }
        TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, order[i] * 100, piece, 100));
        expect_ack();
    }
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
    expect_ack();
    uint8_t stored[400];
    TEST_ASSERT_EQUAL(STORE_OK, store_load(&store, "/in/reference.bin", stored, sizeof stored));
    for (size_t i = 0; i < sizeof stored; i++) {
        TEST_ASSERT_EQUAL(file_byte(i), stored[i]);
    }
}

static void test_a_new_upload_starts_empty(void) {
    put_file("/in/speeds.bin", 500);
    const uint8_t session = create("/in/speeds.bin");
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
    uint32_t size = 1;
    TEST_ASSERT_EQUAL(STORE_OK, store_size(&store, "/in/speeds.bin", &size));
    TEST_ASSERT_EQUAL(0, size);
}

static void test_writes_only_the_uploads(void) {
    static const char *const refused[] = {"/reference.bin",     "/params.bin", "/in/other.bin",
                                          "/trials/0001.ulg",   "/in",         "/in/../params.bin",
                                          "/in/speeds.bin/../x"};
    for (size_t i = 0; i < sizeof refused / sizeof refused[0]; i++) {
        ask_path(FTP_OP_CREATE, refused[i]);
        expect_nak(FTP_PROTECTED);
        ask_path(FTP_OP_OPEN_WO, refused[i]);
        expect_nak(FTP_PROTECTED);
    }
    TEST_ASSERT_FALSE(ftp.session.open);
}

static void test_an_upload_has_a_limit(void) {
    const uint8_t session = create("/in/reference.bin");
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, FTP_IN_FILE_MAX_BYTES - 3, "abc", 3));
    expect_ack();
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, FTP_IN_FILE_MAX_BYTES - 2, "abc", 3));
    expect_nak(FTP_FAIL_ERRNO);
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0xFFFFFFFFu, "abc", 3));
    expect_nak(FTP_FAIL_ERRNO);
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, NULL, 0));
    expect_nak(FTP_INVALID_SIZE);
}

static void test_a_read_session_does_not_write_nor_the_other_way_round(void) {
    put_file("/trials/0001.ulg", 10);
    uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, "abc", 3));
    expect_nak(FTP_INVALID_SESSION);
    session = create("/in/speeds.bin");
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 3));
    expect_nak(FTP_INVALID_SESSION);
    TEST_ASSERT_TRUE(ask(FTP_OP_BURST, session, 0, NULL, 3));
    expect_nak(FTP_INVALID_SESSION);
}

static void test_removes_trials_and_uploads_only(void) {
    put_file("/trials/0001.ulg", 10);
    put_file("/in/speeds.bin", 10);
    put_file("/reference.bin", 10);
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    expect_ack();
    ask_path(FTP_OP_REMOVE, "/in/speeds.bin");
    expect_ack();
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    expect_nak(FTP_NOT_FOUND);
    ask_path(FTP_OP_REMOVE, "/reference.bin");
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_REMOVE, "/trials");
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_REMOVE, "/params.bin");
    expect_nak(FTP_NOT_FOUND);
}

static void test_removing_an_open_file_hurts_nobody(void) {
    put_file("/trials/0001.ulg", 9000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    expect_ack();
    for (uint32_t i = 2; i < 12; i++) {
        char path[STORE_PATH_BYTES];
        trial_log_path(i, path);
        put_file(path, 9000);
    }
    (void)ask(FTP_OP_BURST, session, 0, NULL, 239);
    for (uint32_t i = 0; i < FTP_BURST_PACKETS && ftp_server_burst(&ftp, reply); i++) {
    }
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
}

static void test_a_lost_answer_is_repeated_not_the_deed(void) {
    put_file("/trials/0001.ulg", 10);
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    expect_ack();
    uint8_t first[FTP_PAYLOAD_BYTES];
    memcpy(first, reply, sizeof first);
    TEST_ASSERT_TRUE(send());
    TEST_ASSERT_EQUAL_MEMORY(first, reply, sizeof first);
}

static void test_a_repeated_open_goes_on_where_it_was(void) {
    put_file("/trials/0001.ulg", 1000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    const uint16_t open_seq = seq;
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    seq = open_seq;
    fill(FTP_OP_OPEN_RO, session, 0, "/trials/0001.ulg", 16);
    TEST_ASSERT_TRUE(send());
    TEST_ASSERT_EQUAL(session, reply[2]);
    TEST_ASSERT_EQUAL(1000, bytes_get_u32(reply + 12));
    TEST_ASSERT_TRUE(ftp.session.bursting);
    const uint8_t newer = open_ro("/trials/0001.ulg"); /* not a repetition: a new session */
    TEST_ASSERT_FALSE(ftp.session.bursting);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_nak(FTP_INVALID_SESSION);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, newer, 0, NULL, 10));
    expect_ack();
}

static void test_blocks_may_follow_an_open_at_once(void) {
    seq++;
    fill(FTP_OP_CREATE, 9, 0, "/in/speeds.bin", 14);
    TEST_ASSERT_TRUE(send());
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, 9, 0, "abc", 3));
    expect_ack();
}

static void test_what_looks_alike_is_not_repeated(void) {
    put_file("/trials/0001.ulg", 10);
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    host = stranger; /* somebody else's same number */
    TEST_ASSERT_TRUE(send());
    expect_nak(FTP_NOT_FOUND);
    host = laptop;
    ftp.session.conditions.now_us += FTP_SESSION_SILENT_US; /* long ago */
    TEST_ASSERT_TRUE(send());
    expect_nak(FTP_NOT_FOUND);
}

static void test_reset_forgets_the_last_answer(void) {
    put_file("/trials/0001.ulg", 10);
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    TEST_ASSERT_TRUE(ask(FTP_OP_RESET, 0, 0, NULL, 0));
    expect_ack();
    seq--;
    fill(FTP_OP_REMOVE, 0, 0, "/trials/0001.ulg", 16);
    TEST_ASSERT_TRUE(send());
    expect_nak(FTP_NOT_FOUND);
}

static void test_a_second_host_waits_for_the_first(void) {
    put_file("/trials/0001.ulg", 1000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    host = stranger;
    ask_path(FTP_OP_OPEN_RO, "/trials/0001.ulg");
    expect_nak(FTP_NO_SESSIONS);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_nak(FTP_INVALID_SESSION);
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
    expect_nak(FTP_INVALID_SESSION);
    TEST_ASSERT_TRUE(ask(FTP_OP_RESET, 0, 0, NULL, 0));
    expect_ack();
    TEST_ASSERT_TRUE(ftp.session.open);
    ftp.session.conditions.now_us += FTP_SESSION_SILENT_US;
    open_ro("/trials/0001.ulg");
    host = laptop;
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_nak(FTP_INVALID_SESSION);
}

/* Who has the key need not wait for who has not; the other way round he does. */
static void test_a_trusted_host_goes_first(void) {
    put_file("/trials/0001.ulg", 1000);
    host.trusted = false;
    uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    host = stranger;
    session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ftp_server_burst(&ftp, reply));
    host = laptop;
    host.trusted = false;
    ask_path(FTP_OP_OPEN_RO, "/trials/0001.ulg");
    expect_nak(FTP_NO_SESSIONS);
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
    expect_nak(FTP_INVALID_SESSION);
    host = stranger;
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_ack();
    host.trusted = false; /* the same address, but nobody knows by whom */
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_nak(FTP_INVALID_SESSION);
}

static void test_who_is_not_trusted_only_reads(void) {
    static const uint8_t writing[] = {FTP_OP_CREATE, FTP_OP_OPEN_WO, FTP_OP_WRITE, FTP_OP_REMOVE};
    put_file("/in/speeds.bin", 10);
    host.trusted = false;
    const uint8_t session = open_ro("/in/speeds.bin");
    const uint32_t writes = hal.flash_writes;
    for (uint32_t opcode = 0; opcode < 32; opcode++) {
        fill((uint8_t)opcode, session, 0, "/in/speeds.bin", 14);
        TEST_ASSERT_EQUAL(memchr(writing, (int)opcode, sizeof writing) != NULL,
                          ftp_server_needs_trust(request));
    }
    for (uint32_t i = 0; i < sizeof writing; i++) {
        TEST_ASSERT_TRUE(ask(writing[i], session, 0, "/in/speeds.bin", 14));
        expect_nak(FTP_PROTECTED);
    }
    TEST_ASSERT_EQUAL_UINT32(writes, hal.flash_writes);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_ack();
}

/* His reset does not make the board forget what it did for the one it trusts. */
static void test_a_strangers_reset(void) {
    const uint8_t session = create("/in/speeds.bin");
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, "abc", 3));
    uint8_t last[FTP_PAYLOAD_BYTES];
    memcpy(last, request, sizeof last);
    const uint32_t writes = hal.flash_writes;
    host = stranger;
    host.trusted = false;
    TEST_ASSERT_TRUE(ask(FTP_OP_RESET, 0, 0, NULL, 0));
    expect_ack();
    TEST_ASSERT_TRUE(ftp.session.open && ftp.last.known);
    host = laptop;
    memcpy(request, last, sizeof last);
    TEST_ASSERT_TRUE(send());
    expect_ack();
    TEST_ASSERT_EQUAL_UINT32(writes, hal.flash_writes);
}

static void test_a_running_burst_is_not_silence(void) {
    put_file("/trials/0001.ulg", 1000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    ftp.session.conditions.now_us += FTP_SESSION_SILENT_US;
    host = stranger;
    ask_path(FTP_OP_OPEN_RO, "/trials/0001.ulg");
    expect_nak(FTP_NO_SESSIONS);
}

static void test_while_swimming_nothing_is_written(void) {
    put_file("/trials/0001.ulg", 10);
    put_file("/trials/0002.ulg", 10);
    const uint8_t session = create("/in/speeds.bin");
    const uint32_t writes = hal.flash_writes;
    ftp.session.conditions.read_only = true;
    ftp.session.conditions.busy_trial = 2;
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, "abc", 3));
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_REMOVE, "/trials/0001.ulg");
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_CREATE, "/in/reference.bin");
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_OPEN_RO, "/trials/0002.ulg");
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_CRC32, "/trials/0002.ulg");
    expect_nak(FTP_PROTECTED);
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
    expect_nak(FTP_PROTECTED);
    ask_path(FTP_OP_OPEN_RO, "/trials/0001.ulg");
    expect_nak(FTP_NO_SESSIONS);
    TEST_ASSERT_EQUAL(writes, hal.flash_writes);
}

static void test_a_file_that_is_gone_is_not_read_from_its_old_blocks(void) {
    static uint8_t other[100];
    memset(other, 0x5A, sizeof other);
    put_file("/trials/0001.ulg", 100);
    put_file("/reference.bin", 100);
    for (uint32_t i = 0; i < 2; i++) {
        const uint8_t session = open_ro(i == 0 ? "/trials/0001.ulg" : "/reference.bin");
        if (i == 0) {
            TEST_ASSERT_EQUAL(STORE_OK, store_remove(&store, "/trials/0001.ulg"));
        } else {
            put_file("/reference.bin", 50);
        }
        for (uint32_t n = 0; n < 2u * BLOCKS; n++) { /* until the block is used anew */
            TEST_ASSERT_EQUAL(STORE_OK, store_replace(&store, "/key.bin", other, sizeof other));
            TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 50));
            expect_nak(FTP_NOT_FOUND);
        }
        TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
        expect_ack();
    }
}

static void test_an_upload_does_not_pose_as_the_boards_own_record(void) {
    static const char *const own[] = {"TBKY", "TBPA", "TBTR", "TBCT", "TBCR"};
    const uint8_t session = create("/in/reference.bin");
    for (uint32_t i = 0; i < 5; i++) {
        TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, own[i], 4));
        expect_nak(FTP_FAIL);
    }
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, "T", 1));
    expect_ack();
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 1, "BKY", 3));
    expect_nak(FTP_FAIL);
    TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, 0, "TBRF", 4));
    expect_ack();
}

static void test_an_upload_ends_where_a_trial_begins(void) {
    put_file("/trials/0001.ulg", 10);
    (void)create("/in/speeds.bin");
    ftp_server_end_upload(&ftp);
    const uint32_t writes = hal.flash_writes;
    ftp.session.conditions.read_only = true;
    const uint8_t session = open_ro("/trials/0001.ulg");
    ftp_server_end_upload(&ftp);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 10));
    expect_ack();
    TEST_ASSERT_EQUAL(writes, hal.flash_writes);
}

static const uint8_t block[200];

static void test_a_full_board_says_so(void) {
    put_file("/trials/0001.ulg", 20000);
    for (uint32_t i = 2; i < 40; i++) {
        static uint8_t bytes[9000];
        char path[STORE_PATH_BYTES];
        trial_log_path(i, path);
        if (store_replace(&store, path, bytes, sizeof bytes) != STORE_OK) {
            break;
        }
    }
    const uint8_t session = create("/in/reference.bin");
    for (uint32_t offset = 0; offset < 16000 && reply[3] == FTP_OP_ACK; offset += 200) {
        TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, offset, block, 200));
    }
    expect_nak(FTP_FAIL_ERRNO);
    TEST_ASSERT_EQUAL(28, reply[13]);
}

static void test_flash_that_fails(void) {
    const uint8_t session = create("/in/reference.bin");
    hal.flash_fail_after = hal.flash_writes;
    for (uint32_t offset = 0; offset < 8000 && reply[3] == FTP_OP_ACK; offset += 200) {
        TEST_ASSERT_TRUE(ask(FTP_OP_WRITE, session, offset, block, 200));
    }
    TEST_ASSERT_EQUAL(FTP_OP_NAK, reply[3]);
    TEST_ASSERT_TRUE(ask(FTP_OP_TERMINATE, session, 0, NULL, 0));
}

static void test_a_store_that_is_not_there(void) {
    store_unmount(&store);
    static const char *const paths[] = {"/", "/trials", "/trials/0001.ulg", "/in/speeds.bin"};
    static const uint8_t opcodes[] = {FTP_OP_LIST, FTP_OP_OPEN_RO, FTP_OP_CREATE, FTP_OP_REMOVE,
                                      FTP_OP_CRC32};
    for (size_t i = 0; i < sizeof paths / sizeof paths[0]; i++) {
        for (size_t k = 0; k < sizeof opcodes; k++) {
            ask_path(opcodes[k], paths[i]);
            TEST_ASSERT_EQUAL(i == 0 && k == 0 ? FTP_OP_ACK : FTP_OP_NAK, reply[3]);
        }
    }
}

static void test_malformed_requests(void) {
    TEST_ASSERT_TRUE(ask(FTP_OP_LIST, 0, 0, NULL, 240));
    expect_nak(FTP_INVALID_SIZE);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, 0, 0, NULL, 255));
    expect_nak(FTP_INVALID_SIZE);
    TEST_ASSERT_TRUE(ask(77, 0, 0, NULL, 0));
    expect_nak(FTP_UNKNOWN_COMMAND);
    TEST_ASSERT_TRUE(ask(9, 0, 0, "/in/x", 5)); /* CreateDirectory */
    expect_nak(FTP_UNKNOWN_COMMAND);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, 3, 0, NULL, 10));
    expect_nak(FTP_INVALID_SESSION);
    TEST_ASSERT_TRUE(ask(FTP_OP_NONE, 0, 0, NULL, 0));
    expect_ack();
    /* an answer is never answered: two boards on one line would talk for ever */
    TEST_ASSERT_FALSE(ask(FTP_OP_ACK, 0, 0, NULL, 0));
    TEST_ASSERT_FALSE(ask(FTP_OP_NAK, 0, 0, NULL, 0));
    uint8_t long_path[FTP_DATA_BYTES];
    memset(long_path, 'a', sizeof long_path);
    TEST_ASSERT_TRUE(ask(FTP_OP_OPEN_RO, 0, 0, long_path, FTP_DATA_BYTES));
    expect_nak(FTP_NOT_FOUND);
}

/* Random requests, half of them with a path of the tree and a likely session. */
static void random_request(uint32_t *random) {
    static const char *const paths[] = {"/trials/0001.ulg", "/in/speeds.bin", "/", "/trials", "/in",
                                        "/reference.bin"};
    for (size_t i = 0; i < sizeof request; i++) {
        request[i] = (uint8_t)peer_random(random);
    }
    if (peer_random(random) % 2 == 0) {
        const char *path = paths[peer_random(random) % 6];
        request[3] = (uint8_t)(peer_random(random) % 17);
        request[4] = (uint8_t)strlen(path);
        memcpy(request + 12, path, strlen(path));
        request[2] = ftp.session.number;
        bytes_put_u32(request + 8, peer_random(random) % 20000);
    }
}

static void test_a_hundred_thousand_random_requests(void) {
    uint32_t random = 7;
    put_file("/trials/0001.ulg", 3000);
    put_file("/params.bin", 50);
    uint32_t crc_before = 0, crc_after = 1;
    TEST_ASSERT_EQUAL(STORE_OK, store_crc32(&store, "/params.bin", &crc_before));
    for (uint32_t i = 0; i < 100000; i++) {
        random_request(&random);
        host = i % 3 == 0 ? stranger : laptop;
        ftp.session.conditions.now_us += 100000;
        if (send()) {
            TEST_ASSERT_TRUE(reply[3] == FTP_OP_ACK || reply[3] == FTP_OP_NAK);
            TEST_ASSERT_LESS_OR_EQUAL(FTP_DATA_BYTES, reply[4]);
        }
        (void)ftp_server_burst(&ftp, reply);
        if (i % 1000 == 0) {
            put_file("/trials/0001.ulg", 3000);
        }
    }
    TEST_ASSERT_EQUAL(STORE_OK, store_crc32(&store, "/params.bin", &crc_after));
    TEST_ASSERT_EQUAL_HEX32(crc_before, crc_after);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_uploads_out_of_order);
    RUN_TEST(test_a_new_upload_starts_empty);
    RUN_TEST(test_writes_only_the_uploads);
    RUN_TEST(test_an_upload_has_a_limit);
    RUN_TEST(test_a_read_session_does_not_write_nor_the_other_way_round);
    RUN_TEST(test_removes_trials_and_uploads_only);
    RUN_TEST(test_removing_an_open_file_hurts_nobody);
    RUN_TEST(test_a_lost_answer_is_repeated_not_the_deed);
    RUN_TEST(test_a_repeated_open_goes_on_where_it_was);
    RUN_TEST(test_blocks_may_follow_an_open_at_once);
    RUN_TEST(test_what_looks_alike_is_not_repeated);
    RUN_TEST(test_reset_forgets_the_last_answer);
    RUN_TEST(test_a_second_host_waits_for_the_first);
    RUN_TEST(test_a_trusted_host_goes_first);
    RUN_TEST(test_who_is_not_trusted_only_reads);
    RUN_TEST(test_a_strangers_reset);
    RUN_TEST(test_a_running_burst_is_not_silence);
    RUN_TEST(test_while_swimming_nothing_is_written);
    RUN_TEST(test_an_upload_ends_where_a_trial_begins);
    RUN_TEST(test_a_file_that_is_gone_is_not_read_from_its_old_blocks);
    RUN_TEST(test_an_upload_does_not_pose_as_the_boards_own_record);
    RUN_TEST(test_a_full_board_says_so);
    RUN_TEST(test_flash_that_fails);
    RUN_TEST(test_a_store_that_is_not_there);
    RUN_TEST(test_malformed_requests);
    RUN_TEST(test_a_hundred_thousand_random_requests);
    return UNITY_END();
}
