#include "ftp_fixture.h"

static void test_paths(void) {
    static const struct {
        const char *wire;
        ftp_path_t kind;
        const char *path;
    } cases[] = {
        {"", FTP_PATH_ROOT, "/"},
        {"/", FTP_PATH_ROOT, "/"},
        {"/trials", FTP_PATH_TRIALS, "/trials"},
        {"trials/", FTP_PATH_TRIALS, "/trials"},
        {"/in/", FTP_PATH_IN, "/in"},
        {"/trials/0001.ulg", FTP_PATH_TRIAL, "/trials/0001.ulg"},
        {"in/speeds.bin", FTP_PATH_UPLOAD, "/in/speeds.bin"},
        {"/in/other.bin", FTP_PATH_HIDDEN, NULL},
        {"/reference.bin", FTP_PATH_RECORD, "/reference.bin"},
        {"/crash.bin", FTP_PATH_RECORD, "/crash.bin"},
        {"/past0.bin", FTP_PATH_RECORD, "/past0.bin"},
        {"past7.bin", FTP_PATH_RECORD, "/past7.bin"},
        {"/past8.bin", FTP_PATH_HIDDEN, "/past8.bin"},
        {"/params.bin", FTP_PATH_HIDDEN, NULL},
        {"/learned.bin", FTP_PATH_HIDDEN, NULL},
        {"/in/learned.bin", FTP_PATH_UPLOAD, "/in/learned.bin"},
        {"/trials/../params.bin", FTP_PATH_HIDDEN, NULL},
        {"/trials/..", FTP_PATH_HIDDEN, NULL},
        {"/trials/.", FTP_PATH_HIDDEN, NULL},
        {"/trials//params.bin", FTP_PATH_HIDDEN, NULL},
        {"//params.bin", FTP_PATH_HIDDEN, NULL},
        {"/in/../in/speeds.bin", FTP_PATH_HIDDEN, NULL},
        {"/trials/0001.ulg/x", FTP_PATH_HIDDEN, NULL},
        {"/trials/\n", FTP_PATH_HIDDEN, NULL},
        {"/trials/0123456789012345678901234567890", FTP_PATH_TRIAL, NULL},
        {"/trials/01234567890123456789012345678901", FTP_PATH_HIDDEN, NULL},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        char path[STORE_PATH_BYTES];
        const ftp_path_t kind =
            ftp_path_parse((const uint8_t *)cases[i].wire, (uint8_t)strlen(cases[i].wire), path);
        TEST_ASSERT_EQUAL_MESSAGE(cases[i].kind, kind, cases[i].wire);
        TEST_ASSERT_NOT_NULL(memchr(path, '\0', sizeof path));
        if (cases[i].path != NULL) {
            TEST_ASSERT_EQUAL_STRING(cases[i].path, path);
        }
    }
}

static void test_a_path_ends_at_its_length_or_at_a_zero(void) {
    char path[STORE_PATH_BYTES];
    const uint8_t wire[] = "/trials/1.ulg\0/params.bin";
    TEST_ASSERT_EQUAL(FTP_PATH_TRIAL, ftp_path_parse(wire, sizeof wire, path));
    TEST_ASSERT_EQUAL_STRING("/trials/1.ulg", path);
    TEST_ASSERT_EQUAL(FTP_PATH_TRIALS, ftp_path_parse(wire, 7, path));
}

static void test_lists_the_root(void) {
    ask_path(FTP_OP_LIST, "/");
    expect_ack();
    TEST_ASSERT_EQUAL(12, reply[4]);
    TEST_ASSERT_EQUAL_MEMORY("Dtrials\0Din\0", reply + 12, 12);
    put_file("/crash.bin", 5);
    put_file("/params.bin", 5);
    ask_path(FTP_OP_LIST, "");
    TEST_ASSERT_EQUAL_MEMORY("Dtrials\0Din\0Fcrash.bin\t5\0", reply + 12, 25);
    TEST_ASSERT_EQUAL(25, reply[4]);
    TEST_ASSERT_TRUE(ask(FTP_OP_LIST, 0, 3, "/", 1));
    expect_nak(FTP_EOF);
}

static uint32_t count_entries(void) {
    uint32_t count = 0;
    for (uint8_t i = 0; i < reply[4]; i++) {
        count += reply[12 + i] == 0 ? 1 : 0;
    }
    return count;
}

static void test_lists_a_long_folder_in_pieces(void) {
    for (uint32_t i = 1; i <= 30; i++) {
        char path[STORE_PATH_BYTES];
        trial_log_path(i, path);
        put_file(path, i);
    }
    uint32_t seen = 0, pieces = 0;
    while (ask(FTP_OP_LIST, 0, seen, "/trials", 7) && reply[3] == FTP_OP_ACK) {
        TEST_ASSERT_LESS_OR_EQUAL(FTP_DATA_BYTES, reply[4]);
        TEST_ASSERT_EQUAL('F', reply[12]);
        TEST_ASSERT_EQUAL(0, reply[12 + reply[4] - 1]);
        seen += count_entries();
        pieces++;
    }
    expect_nak(FTP_EOF);
    TEST_ASSERT_EQUAL(30, seen);
    TEST_ASSERT_GREATER_THAN(1, pieces);
}

static void test_skips_what_is_not_in_the_tree(void) {
    put_file("/in/other.bin", 3);
    put_file("/in/speeds.bin", 4);
    ask_path(FTP_OP_LIST, "/in");
    expect_ack();
    TEST_ASSERT_EQUAL(2, count_entries());
    TEST_ASSERT_EQUAL_MEMORY("S\0Fspeeds.bin\t4\0", reply + 12, 16);
}

static void test_lists_nothing_elsewhere(void) {
    ask_path(FTP_OP_LIST, "/nowhere");
    expect_nak(FTP_NOT_FOUND);
    ask_path(FTP_OP_LIST, "/trials");
    expect_nak(FTP_EOF);
    TEST_ASSERT_TRUE(ask(FTP_OP_LIST, 0, 0xFFFFFFFFu, "/trials", 7));
    expect_nak(FTP_EOF);
}

static void test_reads_a_file(void) {
    put_file("/trials/0001.ulg", 300);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_EQUAL(4, reply[4]);
    TEST_ASSERT_EQUAL(300, bytes_get_u32(reply + 12));
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 10, NULL, 100));
    expect_ack();
    TEST_ASSERT_EQUAL(session, reply[2]);
    TEST_ASSERT_EQUAL(100, reply[4]);
    TEST_ASSERT_EQUAL(file_byte(10), reply[12]);
    TEST_ASSERT_EQUAL(file_byte(109), reply[12 + 99]);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 290, NULL, 239));
    TEST_ASSERT_EQUAL(10, reply[4]);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 300, NULL, 239));
    expect_nak(FTP_EOF);
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0xFFFFFFF0u, NULL, 239));
    expect_nak(FTP_EOF);
}

static void test_reads_an_empty_file(void) {
    put_file("/trials/0001.ulg", 0);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_EQUAL(0, bytes_get_u32(reply + 12));
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 0, NULL, 239));
    expect_nak(FTP_EOF);
    TEST_ASSERT_TRUE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    expect_nak(FTP_EOF);
    TEST_ASSERT_FALSE(ftp_server_burst(&ftp, reply));
}

static void test_opens_only_what_it_shows(void) {
    put_file("/params.bin", 10);
    static const char *const hidden[] = {"/params.bin", "/trials/../params.bin", "/trials",
                                         "/",           "/trials/0009.ulg",      "/in/speeds.bin"};
    for (size_t i = 0; i < sizeof hidden / sizeof hidden[0]; i++) {
        ask_path(FTP_OP_OPEN_RO, hidden[i]);
        expect_nak(FTP_NOT_FOUND);
        ask_path(FTP_OP_CRC32, hidden[i]);
        expect_nak(FTP_NOT_FOUND);
    }
}

static void test_reads_what_the_image_holds(void) {
    for (size_t i = 0; i < LINK_METADATA_FILES; i++) {
        const link_file_bytes_t *file = &link_metadata[i];
        const uint8_t session = open_ro(file->path);
        TEST_ASSERT_EQUAL(file->size, bytes_get_u32(reply + 12));
        uint32_t at = 0;
        TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
        while (ftp_server_burst(&ftp, reply)) {
            TEST_ASSERT_EQUAL_MEMORY(file->bytes + at, reply + 12, reply[4]);
            at += reply[4];
        }
        TEST_ASSERT_EQUAL(file->size, at);
        TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, file->size - 3, NULL, 239));
        TEST_ASSERT_EQUAL(3, reply[4]);
        TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, file->size, NULL, 239));
        expect_nak(FTP_EOF);
        ask_path(FTP_OP_CRC32, file->path);
        TEST_ASSERT_EQUAL_HEX32(crc32_update(0, file->bytes, file->size),
                                bytes_get_u32(reply + 12));
    }
    put_file("/trials/0001.ulg", 300); /* and then a file of the store */
    (void)open_ro("/trials/0001.ulg");
    TEST_ASSERT_EQUAL(300, bytes_get_u32(reply + 12));
    ask_path(FTP_OP_CREATE, link_metadata[0].path);
    expect_nak(FTP_PROTECTED);
}

static void test_crc32_is_that_of_mavlink_ftp(void) {
    TEST_ASSERT_EQUAL(STORE_OK, store_replace(&store, "/reference.bin", "123456789", 9));
    ask_path(FTP_OP_CRC32, "/reference.bin");
    expect_ack();
    TEST_ASSERT_EQUAL(4, reply[4]);
    TEST_ASSERT_EQUAL_HEX32(0x2DFD2D88, bytes_get_u32(reply + 12));
}

/* Runs the burst to its end; returns the number of packets. */
static uint32_t run_burst(uint32_t offset, uint8_t size, uint8_t session) {
    uint32_t packets = 0;
    while (ftp_server_burst(&ftp, reply)) {
        packets++;
        TEST_ASSERT_EQUAL_UINT16(seq + packets, bytes_get_u16(reply));
        TEST_ASSERT_EQUAL(session, reply[2]);
        TEST_ASSERT_EQUAL(FTP_OP_ACK, reply[3]);
        TEST_ASSERT_EQUAL(FTP_OP_BURST, reply[5]);
        TEST_ASSERT_EQUAL(offset, bytes_get_u32(reply + 8));
        TEST_ASSERT_LESS_OR_EQUAL(size, reply[4]);
        for (uint8_t i = 0; i < reply[4]; i++) {
            TEST_ASSERT_EQUAL(file_byte(offset + i), reply[12 + i]);
        }
        offset += reply[4];
    }
    return packets;
}

static void test_burst_to_the_end_of_the_file(void) {
    put_file("/trials/0001.ulg", 1000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    TEST_ASSERT_EQUAL(5, run_burst(0, 239, session));
    TEST_ASSERT_EQUAL(1, reply[6]);
    TEST_ASSERT_EQUAL(1000 - 4 * 239, reply[4]);
    TEST_ASSERT_TRUE(ask(FTP_OP_BURST, session, 1000, NULL, 239));
    expect_nak(FTP_EOF);
}

static void test_burst_marks_only_its_last_packet(void) {
    put_file("/trials/0001.ulg", 160);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 80));
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    TEST_ASSERT_EQUAL(0, reply[6]);
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    TEST_ASSERT_EQUAL(1, reply[6]);
    TEST_ASSERT_FALSE(ftp_server_burst(&ftp, reply));
}

static void test_a_burst_has_a_limit_and_goes_on_when_asked(void) {
    put_file("/trials/0001.ulg", 8000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 40));
    TEST_ASSERT_EQUAL(FTP_BURST_PACKETS, run_burst(0, 40, session));
    TEST_ASSERT_EQUAL(1, reply[6]);
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, FTP_BURST_PACKETS * 40, NULL, 40));
    TEST_ASSERT_EQUAL(40, run_burst(FTP_BURST_PACKETS * 40, 40, session));
}

/* The stock client asks again with the same sequence number but from where it stands. */
static void test_a_burst_restarts_elsewhere_under_its_old_number(void) {
    put_file("/trials/0001.ulg", 1000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 100));
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    fill(FTP_OP_BURST, session, 300, NULL, 100);
    TEST_ASSERT_FALSE(send());
    TEST_ASSERT_EQUAL(7, run_burst(300, 100, session));
}

static void test_a_read_in_the_middle_of_a_burst(void) {
    put_file("/trials/0001.ulg", 1000);
    const uint8_t session = open_ro("/trials/0001.ulg");
    TEST_ASSERT_FALSE(ask(FTP_OP_BURST, session, 0, NULL, 239));
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    const uint16_t burst_seq = seq;
    TEST_ASSERT_TRUE(ask(FTP_OP_READ, session, 5, NULL, 3));
    TEST_ASSERT_EQUAL(file_byte(5), reply[12]);
    TEST_ASSERT_TRUE(ftp_server_burst(&ftp, reply));
    TEST_ASSERT_EQUAL(239, bytes_get_u32(reply + 8));
    TEST_ASSERT_EQUAL(burst_seq + 2, bytes_get_u16(reply));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_paths);
    RUN_TEST(test_a_path_ends_at_its_length_or_at_a_zero);
    RUN_TEST(test_lists_the_root);
    RUN_TEST(test_lists_a_long_folder_in_pieces);
    RUN_TEST(test_skips_what_is_not_in_the_tree);
    RUN_TEST(test_lists_nothing_elsewhere);
    RUN_TEST(test_reads_a_file);
    RUN_TEST(test_reads_an_empty_file);
    RUN_TEST(test_opens_only_what_it_shows);
    RUN_TEST(test_reads_what_the_image_holds);
    RUN_TEST(test_crc32_is_that_of_mavlink_ftp);
    RUN_TEST(test_burst_to_the_end_of_the_file);
    RUN_TEST(test_burst_marks_only_its_last_packet);
    RUN_TEST(test_a_burst_has_a_limit_and_goes_on_when_asked);
    RUN_TEST(test_a_burst_restarts_elsewhere_under_its_old_number);
    RUN_TEST(test_a_read_in_the_middle_of_a_burst);
    return UNITY_END();
}
