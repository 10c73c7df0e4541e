/*
 * Random bytes rich in what messages are made of, against a second reader that has the whole block
 * at hand and looks at every place of it, one byte at a time. A million bytes; as many as
 * IMU_FUZZ_BYTES says, where there is an environment.
 */
#include "imu_stream.h"

#include <stdio.h>
#include <stdlib.h>

#define BLOCK_BYTES 4096u
#define DEFAULT_BYTES 1000000u

static stream_t pieces, expected;
static uint8_t block[BLOCK_BYTES];
static imu_reader_counters_t wanted;

void setUp(void) {}
void tearDown(void) {}

/* Length of a frame of which |length| bytes are there at most: 0 = none, more than |length| = cut.
 */
static size_t plain_frame(const uint8_t *bytes, size_t length, bool exact) {
    uint16_t frame_bytes = 0;
    if (exact) {
        const size_t there = length < OWN_HEADER_BYTES ? length : OWN_HEADER_BYTES;
        return memcmp(bytes, OWN_HEADER, there) == 0 ? 64 : 0;
    }
    switch (imu_layout_header(bytes, length, &frame_bytes)) {
    case IMU_HEADER_IMPOSSIBLE:
        return 0;
    case IMU_HEADER_CUT:
        return length + 1;
    default:
        return frame_bytes;
    }
}

/* Length of a line up to its LF: 0 = none, more than |length| = cut. */
static size_t plain_line(const uint8_t *bytes, size_t length) {
    for (size_t i = 0; i < length && i < 256; i++) {
        const uint8_t byte = bytes[i];
        if (i < 3 && byte != "$VN"[i]) {
            return 0;
        }
        if (byte == '\n') {
            return i + 1;
        }
        if (byte == '\r' && (i + 1 == length || bytes[i + 1] == '\n')) {
            continue;
        }
        if (byte < 32 || byte > 126 || (byte == '$' && i > 0)) {
            return 0;
        }
    }
    return length < 256 ? length + 1 : 0;
}

static int plain_digit(uint8_t digit) {
    const char *const digits = "0123456789ABCDEF";
    const char *const place = digit == 0 ? NULL : strchr(digits, digit);
    return place == NULL ? -1 : (int)(place - digits);
}

/* 1 = right, 0 = wrong, -1 = no check at all. */
static int plain_check(const uint8_t *line, size_t length) {
    size_t star = 1;
    unsigned sum = 0, given = 0;
    while (star < length && line[star] != '*') {
        sum ^= line[star++];
    }
    size_t end = star + 1;
    while (end < length && plain_digit(line[end]) >= 0) {
        given = given * 16 + (unsigned)plain_digit(line[end++]);
    }
    const size_t digits = end - star - 1;
    if (end < length && line[end] == '\r') {
        end++;
    }
    if ((digits != 2 && digits != 4) || end + 1 != length) {
        return -1;
    }
    return given == (digits == 4 ? slow_crc(0, line + 1, star - 1) : sum);
}

/* What is found at the begin of |bytes|: the length of a message, or 0. Counts. */
static size_t plain_message(const uint8_t *bytes, size_t length, bool exact) {
    const bool frame = bytes[0] == 0xFA;
    if (!frame && bytes[0] != '$') {
        return 0;
    }
    const size_t whole = frame ? plain_frame(bytes, length, exact) : plain_line(bytes, length);
    if (whole == 0) {
        wanted.header_rejects += frame;
        return 0;
    }
    if (whole > length) {
        wanted.dropped++;
        return 0;
    }
    const int check = frame ? slow_crc(0, bytes + 1, whole - 1) == 0 : plain_check(bytes, whole);
    if (check != 1) {
        wanted.crc_failed += frame;
        wanted.checksum_failed += !frame && check == 0;
        return 0;
    }
    wanted.binary += frame;
    wanted.lines += !frame;
    return whole;
}

static void read_plainly(bool exact) {
    clear(&expected);
    memset(&wanted, 0, sizeof wanted);
    size_t at = 0;
    while (at < BLOCK_BYTES) {
        const size_t whole = plain_message(block + at, BLOCK_BYTES - at, exact);
        if (whole != 0) {
            add_message(&expected, block + at, whole);
        }
        wanted.skipped_bytes += whole == 0;
        at += whole != 0 ? whole : 1;
    }
}

static void make_pieces(void) {
    static const uint8_t time_imu[] = {0xFA, 0x06, 0x01, 0x00, 0x0E, 0x00};
    static const uint8_t all_fields[] = {0xFA, 0x17, 0xFF, 0x7F, 0xFF,
                                         0x03, 0xFF, 0x0F, 0xFF, 0x31};
    static const uint8_t shortest[] = {0xFA, 0x02, 0x00, 0x02};
    clear(&pieces);
    random_state = 19u;
    add_frame(&pieces, OWN_HEADER, OWN_HEADER_BYTES, 64);
    add_frame(&pieces, time_imu, sizeof time_imu, 52);
    add_frame(&pieces, all_fields, sizeof all_fields, 523);
    add_frame(&pieces, shortest, sizeof shortest, 7);
    add_line(&pieces, "VNYPR,+010.071,+000.278,-002.026", false, "\r\n");
    add_line(&pieces, "VNRRG,75,3,400,01,0321", true, "\n");
    add_line(&pieces, "VNERR,03", false, "\r\n");
}

/* A whole message, its begin, its end, a few characters that matter, or noise. */
static size_t put_piece(uint8_t *to, size_t room) {
    static const char characters[] = "$VN*,\r\n0A$\xFA\xFA\x11\x01";
    const uint32_t draw = random_u32();
    const size_t number = draw / 8 % pieces.messages;
    const uint8_t *from = pieces.bytes + pieces.begin[number];
    size_t length = message_bytes(&pieces, number);
    uint8_t noise[16];
    if (draw % 8 == 1) {
        length = 1 + random_u32() % length;
    } else if (draw % 8 == 2) {
        const size_t cut = random_u32() % length;
        from += cut;
        length -= cut;
    } else if (draw % 8 > 3) {
        for (size_t i = 0; i < sizeof noise; i++) {
            noise[i] = draw % 8 == 4 ? (uint8_t)random_u32()
                                     : (uint8_t)characters[random_u32() % (sizeof characters - 1)];
        }
        from = noise;
        length = 1 + draw / 8 % sizeof noise;
    }
    length = length < room ? length : room;
    memcpy(to, from, length);
    return length;
}

static void make_block(void) {
    for (size_t filled = 0; filled < BLOCK_BYTES;) {
        filled += put_piece(block + filled, BLOCK_BYTES - filled);
    }
    for (uint32_t flips = random_u32() % 16; flips > 0; flips--) {
        block[random_u32() % BLOCK_BYTES] ^= (uint8_t)(1u << random_u32() % 8);
    }
}

static void push_in_random_chunks(void) {
    const uint32_t most = random_u32() % 2 == 0 ? 16 : 700;
    for (size_t at = 0; at < BLOCK_BYTES;) {
        const size_t draw = 1 + random_u32() % most;
        const size_t chunk = draw < BLOCK_BYTES - at ? draw : BLOCK_BYTES - at;
        push_piece(block + at, chunk);
        at += chunk;
        assert_all_bytes_accounted(at);
    }
}

static void assert_counted_alike(void) {
    TEST_ASSERT_EQUAL_UINT32(wanted.binary, reader.counters.binary);
    TEST_ASSERT_EQUAL_UINT32(wanted.lines, reader.counters.lines);
    TEST_ASSERT_EQUAL_UINT32(wanted.crc_failed, reader.counters.crc_failed);
    TEST_ASSERT_EQUAL_UINT32(wanted.checksum_failed, reader.counters.checksum_failed);
    TEST_ASSERT_EQUAL_UINT32(wanted.header_rejects, reader.counters.header_rejects);
    TEST_ASSERT_EQUAL_UINT32(wanted.dropped, reader.counters.dropped);
    TEST_ASSERT_EQUAL_UINT32(wanted.skipped_bytes, reader.counters.skipped_bytes);
}

static void random_bytes_are_read_as_if_looked_at_one_by_one(void) {
    const char *const asked = getenv("IMU_FUZZ_BYTES");
    const unsigned long bytes = asked != NULL ? strtoul(asked, NULL, 10) : DEFAULT_BYTES;
    imu_reader_counters_t total = {0};
    make_pieces();
    for (unsigned long done = 0; done < bytes; done += BLOCK_BYTES) {
        const bool exact = random_u32() % 4 == 0;
        make_block();
        read_plainly(exact);
        start_reader(exact);
        push_in_random_chunks();
        fall_silent();
        assert_all_bytes_accounted(BLOCK_BYTES);
        assert_only_lost(&expected, NONE_LOST);
        assert_counted_alike();
        total.binary += wanted.binary;
        total.lines += wanted.lines;
        total.crc_failed += wanted.crc_failed;
        total.checksum_failed += wanted.checksum_failed;
        total.dropped += wanted.dropped;
    }
    printf("fuzz: %lu bytes: %lu frames, %lu lines, %lu wrong CRCs, %lu wrong checks, %lu halves\n",
           bytes, (unsigned long)total.binary, (unsigned long)total.lines,
           (unsigned long)total.crc_failed, (unsigned long)total.checksum_failed,
           (unsigned long)total.dropped);
    TEST_ASSERT_TRUE(bytes < DEFAULT_BYTES || (total.binary > 1000 && total.lines > 1000));
    TEST_ASSERT_TRUE(bytes < DEFAULT_BYTES || (total.crc_failed > 1000 && total.dropped > 100));
    TEST_ASSERT_TRUE(bytes < DEFAULT_BYTES || total.checksum_failed > 10);
}

/* The begin of the longest frame, over and over: every place is a candidate of 523 bytes. */
static void the_worst_there_is_ends(void) {
    const uint8_t header[] = {0xFA, 0x17, 0xFF, 0x7F, 0xFF, 0x03, 0xFF, 0x0F, 0xFF, 0x31};
    for (size_t i = 0; i < BLOCK_BYTES; i++) {
        block[i] = header[i % sizeof header];
    }
    read_plainly(false);
    start_reader(false);
    push(block, BLOCK_BYTES, 64);
    TEST_ASSERT_TRUE(reader.counters.crc_failed >= (BLOCK_BYTES - 600) / sizeof header);
    fall_silent();
    assert_counted_alike();
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(random_bytes_are_read_as_if_looked_at_one_by_one);
    RUN_TEST(the_worst_there_is_ends);
    return UNITY_END();
}
