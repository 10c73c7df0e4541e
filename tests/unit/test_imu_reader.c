/* Which messages the reader takes, when it delivers them, and what it counts. */
#include "imu_stream.h"

#include <stdio.h>

/* Examples of the VN-100 manual and of public recordings. */
static const uint8_t YPR_FRAME[] = {0xFA, 0x01, 0x08, 0x00, 0x93, 0x50, 0x2E, 0x42, 0x83,
                                    0x3E, 0xF1, 0x3F, 0x48, 0xB5, 0x04, 0xBB, 0x92, 0x88};
static const uint8_t TIME_IMU_FRAME[] = {
    0xFA, 0x06, 0x01, 0x00, 0x0E, 0x00, 0xE0, 0x9D, 0xBA, 0xB3, 0x8C, 0x35, 0x01,
    0x00, 0xB2, 0x40, 0x0E, 0xBF, 0x8B, 0x5D, 0x20, 0xBE, 0x0E, 0x06, 0xD6, 0x3E,
    0x8C, 0x8D, 0x5C, 0x3E, 0x3A, 0x62, 0x32, 0xBE, 0x2A, 0x0E, 0x1D, 0xC1, 0xA5,
    0xD3, 0xBF, 0xB9, 0x23, 0x8E, 0xBB, 0x39, 0x9E, 0x7B, 0x5C, 0xBA, 0xD6, 0x9C};
static const uint8_t MISPRINTED_FRAME[] = {0xFA, 0x01, 0x08, 0x00, 0x01, 0x00, 0xA4, 0x15,
                                           0x02, 0x42, 0x4D, 0xDF, 0xEB, 0x3F, 0xF6, 0x1A,
                                           0x36, 0xBE, 0xBF, 0x2D, 0xA4, 0x41, 0xA8, 0x3A};

#define YPR_LINE "$VNYPR,+010.071,+000.278,-002.026*60\r\n"
#define REGISTER_LINE "$VNRRG,75,3,400,01,0321*3B31\r\n"

void setUp(void) { start_reader(false); }
void tearDown(void) {}

static void push_text(const char *text) { push(text, strlen(text), 5); }

static void assert_found(size_t messages, size_t skipped) {
    TEST_ASSERT_EQUAL_size_t(messages, found.messages);
    TEST_ASSERT_EQUAL_UINT32(skipped, reader.counters.skipped_bytes);
}

/* In two pieces, split at every place. */
static void assert_taken(const void *bytes, size_t length) {
    for (size_t split = 0; split <= length; split++) {
        start_reader(false);
        push(bytes, split, length);
        TEST_ASSERT_EQUAL_size_t(split == length, found.messages);
        push((const uint8_t *)bytes + split, length - split, length);
        assert_found(1, 0);
        TEST_ASSERT_EQUAL_size_t(length, found.length);
        TEST_ASSERT_EQUAL_UINT8_ARRAY(bytes, found.bytes, length);
    }
}

static void assert_line_refused(const char *line, uint32_t checksum_failed) {
    start_reader(false);
    push_text(line);
    fall_silent();
    assert_found(0, strlen(line));
    TEST_ASSERT_EQUAL_UINT32(checksum_failed, reader.counters.checksum_failed);
}

static void frames_of_any_layout_are_taken(void) {
    assert_taken(YPR_FRAME, sizeof YPR_FRAME);
    assert_taken(TIME_IMU_FRAME, sizeof TIME_IMU_FRAME);
    assert_taken(OWN_FRAME, sizeof OWN_FRAME);
}

static void lines_with_either_check_are_taken(void) {
    const char *const lines[] = {
        YPR_LINE,
        "$VNYPR,+010.071,+000.278,-002.026*60\n",
        "$VNYPR,+010.071,+000.278,-002.026,T1162704*2F\r\n",
        "$VNYPR,+010.071,+000.278,-002.026,S0000*1F\n",
        "$VNYPR,+010.071,+000.278,-002.026,T1162704,S0000*50\r\n",
        "$VNYMR,+006.380,+000.023,-001.953,+1.0640,-0.2531,+3.0614,+00.005,+00.344,-09.758,"
        "-0.001222,-0.000450,-0.001218*67\r\n",
        "$VNYBA,+059.745,+003.857,-004.949,+00.001,-00.008,+00.150,+00.000478,-00.000896,"
        "-00.001366*5B\r\n",
        "$VNERR,0C*02\r\n",
        "$VNRRG,06,1,1*0865\r\n",
        "$VNRRG,07,1,1*A234\n",
        REGISTER_LINE,
    };
    for (size_t i = 0; i < sizeof lines / sizeof lines[0]; i++) {
        assert_taken(lines[i], strlen(lines[i]));
    }
}

static void misprints_are_refused(void) {
    push(MISPRINTED_FRAME, sizeof MISPRINTED_FRAME, 7);
    fall_silent();
    assert_found(0, sizeof MISPRINTED_FRAME);
    TEST_ASSERT_EQUAL_UINT32(1, reader.counters.crc_failed);
    assert_line_refused("$VNWRG,05,115200*5D\r\n", 1);
    assert_line_refused("$VNWRG,06,14*5C\n", 1);
    assert_line_refused("$VNRRG,240,-124.642,+000.993,-000.203,+00.009,-00.027,+00.084,-00.000479,"
                        "-00.000522,+00.000076*5F\r\n",
                        1);
    assert_line_refused("$VNYIA,-170.94,+007.34,+000.70,-1.7866,+0.1747,+2.2113,-00.085,+00.005,"
                        "-09.847,+00.0003,-00.0012,-00.0001*61\r\n",
                        1);
    assert_line_refused("$VNRRG,07,1,1*A235\r\n", 1);
}

static void what_is_no_line_is_not_counted_as_one(void) {
    assert_line_refused("$VNRRG,07*XX\r\n", 0);
    assert_line_refused("$VNRRG,07*\r\n", 0);
    assert_line_refused("$VNRRG,07*7\r\n", 0);
    assert_line_refused("$VNRRG,07*074\r\n", 0);
    assert_line_refused("$VNRRG,07*00074\r\n", 0);
    assert_line_refused("$VNRRG,07*74 \r\n", 0);
    assert_line_refused("$VNRRG,0774\r\n", 0);
    assert_line_refused("$VNYPR,+010.071,+000.278,-002.026,S0000*1f\r\n", 0);
    assert_line_refused("$VNRRG,07*\r74\r\n", 0);
    assert_line_refused("$VNRRG\r,07*79\r\n", 0);
    assert_line_refused("$VNRRG,07*74\r\r\n", 0);
    assert_line_refused("$VNRRG,07*74\t\n", 0);
    assert_line_refused("$GPRMC,092204.999,A,4250.5589,S,14718.5084,E,0.00,89.68,211200,,*25\r\n",
                        0);
    assert_line_refused("$VN", 0);
    assert_line_refused("$\n", 0);
    assert_line_refused("$VN\n", 0);
    assert_line_refused("$VN\r\n", 0);
}

/* XOR of "VNRRG,07" and the 0x01, 0xC0 or 0x7F in it: checks that fit but for the byte. */
static void unprintable_bytes_end_a_line(void) {
    assert_line_refused("$VNRRG,07\x01*75\r\n", 0);
    assert_line_refused("$VNRRG,07\xC0*B4\r\n", 0);
    assert_line_refused("$VNRRG,07\x7F*0B\r\n", 0);
    assert_line_refused("$VNRRG,07\t*7D\r\n", 0);
    assert_line_refused("$VNRRG,07$*50\r\n", 0);
}

static void a_line_has_at_most_256_bytes(void) {
    char line[300];
    for (size_t length = 250; length <= 260; length++) {
        const size_t body = length - 6;
        memset(line, 'A', sizeof line);
        memcpy(line, "$VN", 3);
        unsigned sum = (unsigned)'V' ^ 'N' ^ (body % 2 != 0 ? 'A' : 0);
        sprintf(line + 1 + body, "*%02X\r\n", sum);
        TEST_ASSERT_EQUAL_size_t(length, strlen(line));
        start_reader(false);
        push(line, length, 64);
        TEST_ASSERT_EQUAL_size_t(length <= 256, found.messages);
        TEST_ASSERT_EQUAL_UINT16(0, reader.held - reader.taken);
    }
}

static void a_line_cut_short_hides_nothing(void) {
    push_text("$VNYMR,+148.954,+001");
    push(YPR_FRAME, sizeof YPR_FRAME, 64);
    TEST_ASSERT_EQUAL_size_t(1, found.messages);
    push_text("$VNYMR,+148.954,+001" YPR_LINE);
    TEST_ASSERT_EQUAL_size_t(2, found.messages);
    push_text("$V$VN" YPR_LINE);
    assert_found(3, 20 + 20 + 5);
}

static void split_packets_are_no_messages(void) {
    uint8_t split[sizeof OWN_FRAME];
    memcpy(split, OWN_FRAME, sizeof split);
    split[0] = 0xFB;
    push(split, sizeof split, 64);
    fall_silent();
    assert_found(0, sizeof split);
}

static void impossible_headers_are_counted_at_once(void) {
    const uint8_t headers[][4] = {
        {0xFA, 0x00, 0x01, 0x00}, {0xFA, 0x81, 0x01, 0x00}, {0xFA, 0x08, 0x01, 0x00},
        {0xFA, 0x20, 0x01, 0x00}, {0xFA, 0x01, 0x00, 0x00}, {0xFA, 0x02, 0x01, 0x04},
    };
    for (size_t i = 0; i < sizeof headers / sizeof headers[0]; i++) {
        start_reader(false);
        push(headers[i], sizeof headers[i], 4);
        assert_found(0, sizeof headers[i]);
        TEST_ASSERT_EQUAL_UINT32(1, reader.counters.header_rejects);
    }
}

static void the_exact_header_alone_is_believed(void) {
    start_reader(true);
    push(TIME_IMU_FRAME, sizeof TIME_IMU_FRAME, 64);
    assert_found(0, sizeof TIME_IMU_FRAME);
    TEST_ASSERT_EQUAL_UINT32(1, reader.counters.header_rejects);
    push(OWN_FRAME, sizeof OWN_FRAME, 64);
    push_text(YPR_LINE);
    assert_found(2, sizeof TIME_IMU_FRAME);
}

/* With the exact header a false sync byte must not hold back what follows. */
static void a_frame_is_delivered_with_its_last_byte(void) {
    start_reader(true);
    push("\xFA\x11\x29\xFA\xFA\xFA", 6, 1);
    push(OWN_FRAME, sizeof OWN_FRAME - 1, 1);
    assert_found(0, 6);
    push(OWN_FRAME + sizeof OWN_FRAME - 1, 1, 1);
    assert_found(1, 6);
}

static void a_push_ends_with_its_message(void) {
    uint8_t bytes[3 * sizeof OWN_FRAME];
    imu_message_t message;
    bool got = false;
    memcpy(bytes, OWN_FRAME, 64);
    memcpy(bytes + 64, YPR_LINE, sizeof YPR_LINE - 1);
    memcpy(bytes + 64 + sizeof YPR_LINE - 1, YPR_FRAME, sizeof YPR_FRAME);
    TEST_ASSERT_EQUAL_size_t(64, imu_reader_push(&reader, bytes, sizeof bytes, &message, &got));
    TEST_ASSERT_TRUE(got && message.kind == IMU_BINARY && message.length == 64);
    TEST_ASSERT_EQUAL_size_t(sizeof YPR_LINE - 1,
                             imu_reader_push(&reader, bytes + 64, 128, &message, &got));
    TEST_ASSERT_TRUE(got && message.kind == IMU_LINE && message.length == sizeof YPR_LINE - 1);
    TEST_ASSERT_EQUAL_size_t(
        18, imu_reader_push(&reader, bytes + 64 + sizeof YPR_LINE - 1, 64, &message, &got));
    TEST_ASSERT_TRUE(got && message.kind == IMU_BINARY && message.length == 18);
    TEST_ASSERT_EQUAL_size_t(0, imu_reader_push(&reader, bytes, 0, &message, &got));
    TEST_ASSERT_FALSE(got);
}

/* What looked like a long frame holds three messages: they come one by one, without new bytes. */
static void a_false_frame_gives_up_what_it_holds(void) {
    const uint8_t header[] = {0xFA, 0x01, 0xFF, 0x7F}; /* 204 bytes */
    push(header, sizeof header, 4);
    push(OWN_FRAME, sizeof OWN_FRAME, 64);
    push_text(YPR_LINE);
    push(TIME_IMU_FRAME, sizeof TIME_IMU_FRAME, 64);
    TEST_ASSERT_EQUAL_size_t(0, found.messages);
    const size_t held = 4 + 64 + sizeof YPR_LINE - 1 + 52;
    TEST_ASSERT_EQUAL_UINT16(held, reader.held);
    for (size_t i = held; i < 204; i++) {
        push("", 1, 1);
    }
    assert_found(3, 4 + 204 - held);
    TEST_ASSERT_EQUAL_UINT32(1, reader.counters.crc_failed);
    TEST_ASSERT_EQUAL_UINT32(0, reader.counters.dropped);
}

static void a_silence_drops_half_a_frame(void) {
    for (size_t half = 1; half < sizeof OWN_FRAME; half++) {
        start_reader(true);
        push(OWN_FRAME, half, 64);
        fall_silent();
        TEST_ASSERT_EQUAL_UINT32(1, reader.counters.dropped);
        push(OWN_FRAME, sizeof OWN_FRAME, 7);
        assert_found(1, half);
        TEST_ASSERT_EQUAL_UINT32(0, reader.counters.crc_failed);
    }
}

static void a_silence_drops_half_a_line(void) {
    for (size_t half = 1; half < sizeof YPR_LINE - 1; half++) {
        start_reader(false);
        push(YPR_LINE, half, 64);
        fall_silent();
        TEST_ASSERT_EQUAL_UINT32(1, reader.counters.dropped);
        push_text(YPR_LINE);
        push(OWN_FRAME, sizeof OWN_FRAME, 7);
        assert_found(2, half);
    }
}

static void a_silence_finds_what_half_a_frame_held(void) {
    const uint8_t header[] = {0xFA, 0x01, 0xFF, 0x7F};
    push(header, sizeof header, 4);
    push(YPR_FRAME, sizeof YPR_FRAME, 64);
    push_text(REGISTER_LINE "$VNYP");
    TEST_ASSERT_EQUAL_size_t(0, found.messages);
    fall_silent();
    assert_found(2, sizeof header + 5);
    TEST_ASSERT_EQUAL_UINT32(2, reader.counters.dropped);
    fall_silent();
    TEST_ASSERT_EQUAL_UINT32(2, reader.counters.dropped);
}

/* Who does not ask a silence for all it holds gets the rest from the next push, even of nothing. */
static void a_push_may_come_before_a_silence_is_searched(void) {
    const uint8_t header[] = {0xFA, 0x17, 0xFF, 0x7F, 0xFF, 0x03, 0xFF, 0x0F, 0xFF, 0x31};
    uint8_t zeros[456] = {0};
    imu_message_t message;
    push(header, sizeof header, 64);
    push(YPR_FRAME, sizeof YPR_FRAME, 64);
    push_text(YPR_LINE);
    push(zeros, sizeof zeros, 64);
    const size_t pushed = sizeof header + sizeof YPR_FRAME + sizeof YPR_LINE - 1 + sizeof zeros;
    TEST_ASSERT_EQUAL_size_t(522, pushed);
    TEST_ASSERT_EQUAL_UINT16(pushed, reader.held);
    TEST_ASSERT_TRUE(imu_reader_silence(&reader, &message));
    keep(&message);
    push_piece(zeros, 0);
    TEST_ASSERT_EQUAL_size_t(2, found.messages);
    push(OWN_FRAME, sizeof OWN_FRAME, 64);
    assert_found(3, sizeof header + sizeof zeros);
    assert_all_bytes_accounted(pushed + sizeof OWN_FRAME);
}

static void init_forgets_everything(void) {
    memset(&reader, 0xA5, sizeof reader);
    start_reader(true);
    push(OWN_FRAME, sizeof OWN_FRAME, 7);
    assert_found(1, 0);
    memset(&reader, 0xA5, sizeof reader);
    start_reader(false);
    push_text(YPR_LINE);
    push(YPR_FRAME, sizeof YPR_FRAME, 7);
    assert_found(2, 0);
    assert_all_bytes_accounted(sizeof YPR_LINE - 1 + sizeof YPR_FRAME);
}

static void a_silence_after_a_message_drops_nothing(void) {
    push(OWN_FRAME, sizeof OWN_FRAME, 64);
    fall_silent();
    push_text(YPR_LINE);
    fall_silent();
    assert_found(2, 0);
    TEST_ASSERT_EQUAL_UINT32(0, reader.counters.dropped);
}

static void any_chunks_give_the_same(void) {
    static stream_t stream;
    clear(&stream);
    random_state = 23u;
    for (int i = 0; i < 15; i++) {
        add_frame(&stream, TIME_IMU_FRAME, 6, 52);
        add_line(&stream, "VNYPR,+010.071,+000.278,-002.026", i % 2 == 0, "\r\n");
        add_frame(&stream, YPR_FRAME, 4, 18);
        add_line(&stream, "VNRRG,08,+0", i % 3 == 0, "\n");
    }
    const size_t chunks[] = {1, 2, 3, 7, 63, 64, 65, 600, STREAM_MAX_BYTES};
    for (size_t i = 0; i < sizeof chunks / sizeof chunks[0]; i++) {
        start_reader(false);
        push(stream.bytes, stream.length, chunks[i]);
        assert_only_lost(&stream, NONE_LOST);
        assert_all_bytes_accounted(stream.length);
        TEST_ASSERT_EQUAL_UINT32(0, reader.counters.skipped_bytes);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(frames_of_any_layout_are_taken);
    RUN_TEST(lines_with_either_check_are_taken);
    RUN_TEST(misprints_are_refused);
    RUN_TEST(what_is_no_line_is_not_counted_as_one);
    RUN_TEST(unprintable_bytes_end_a_line);
    RUN_TEST(a_line_has_at_most_256_bytes);
    RUN_TEST(a_line_cut_short_hides_nothing);
    RUN_TEST(split_packets_are_no_messages);
    RUN_TEST(impossible_headers_are_counted_at_once);
    RUN_TEST(the_exact_header_alone_is_believed);
    RUN_TEST(a_frame_is_delivered_with_its_last_byte);
    RUN_TEST(a_push_ends_with_its_message);
    RUN_TEST(a_false_frame_gives_up_what_it_holds);
    RUN_TEST(a_silence_drops_half_a_frame);
    RUN_TEST(a_silence_drops_half_a_line);
    RUN_TEST(a_silence_finds_what_half_a_frame_held);
    RUN_TEST(a_push_may_come_before_a_silence_is_searched);
    RUN_TEST(init_forgets_everything);
    RUN_TEST(a_silence_after_a_message_drops_nothing);
    RUN_TEST(any_chunks_give_the_same);
    return UNITY_END();
}
