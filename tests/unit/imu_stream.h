/* Streams of VN-100 messages for tests, and what the reader makes of them. */
#ifndef IMU_STREAM_H
#define IMU_STREAM_H

#include "imu/reader.h"

#include "unity.h"

#include <string.h>

#define STREAM_MAX_BYTES 8192u
#define STREAM_MAX_MESSAGES 1200u

typedef struct {
    size_t length;
    size_t messages;
    uint16_t begin[STREAM_MAX_MESSAGES + 1]; /* of each message; the last entry is the end */
    uint8_t bytes[STREAM_MAX_BYTES];
} stream_t;

/* Synthetic, computed by hand from the layout in the manual. */
static const uint8_t OWN_FRAME[64] = {
    0xFA, 0x11, 0x29, 0x01, 0x40, 0x00, 0x08, 0x1A, 0x99, 0xBE, 0x1C, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x20, 0x41, 0x00, 0x00, 0x20, 0xC0, 0x00, 0x00, 0x40, 0x3F, 0x0A, 0xD7, 0x23, 0x3C, 0x0A, 0xD7,
    0xA3, 0xBC, 0x00, 0x00, 0x00, 0x3F, 0x21, 0xB0, 0xD2, 0xBE, 0x8A, 0xB0, 0xC1, 0xBE, 0xC4, 0xB1,
    0x1C, 0xC1, 0x6F, 0x12, 0x83, 0x3C, 0x00, 0x00, 0x80, 0xBE, 0x6F, 0x12, 0x83, 0x3B, 0x93, 0x1E,
};
#define OWN_HEADER OWN_FRAME
#define OWN_HEADER_BYTES 6u

static imu_reader_t reader;
static stream_t found; /* what came out, in order */
static uint32_t random_state = 1u;

static inline uint32_t random_u32(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return random_state >> 8;
}

static inline uint16_t slow_crc(uint16_t start, const uint8_t *bytes, size_t length) {
    uint32_t crc = start;
    for (size_t i = 0; i < length; i++) {
        crc ^= (uint32_t)bytes[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) != 0 ? (crc << 1) ^ 0x1021u : crc << 1;
        }
    }
    return (uint16_t)crc;
}

static inline void add_message(stream_t *stream, const void *bytes, size_t length) {
    TEST_ASSERT_TRUE(stream->length + length <= STREAM_MAX_BYTES);
    TEST_ASSERT_TRUE(stream->messages < STREAM_MAX_MESSAGES);
    memcpy(stream->bytes + stream->length, bytes, length);
    stream->length += length;
    stream->begin[++stream->messages] = (uint16_t)stream->length;
}

static inline void seal_frame(uint8_t *frame, size_t length) {
    const uint16_t crc = slow_crc(0, frame + 1, length - 3);
    frame[length - 2] = (uint8_t)(crc >> 8);
    frame[length - 1] = (uint8_t)crc;
}

/* A frame of |length| bytes with a payload that holds sync bytes and dollars more often than chance
 * would. */
static inline void add_frame(stream_t *stream, const uint8_t *header, size_t header_bytes,
                             size_t length) {
    uint8_t frame[IMU_BINARY_MAX_BYTES];
    memcpy(frame, header, header_bytes);
    for (size_t i = header_bytes; i < length; i++) {
        const uint32_t draw = random_u32();
        frame[i] = draw % 32 == 0 ? 0xFA : draw % 32 == 1 ? '$' : (uint8_t)(draw >> 8);
    }
    seal_frame(frame, length);
    add_message(stream, frame, length);
}

/* |body| with its 8-bit check, or the 16-bit one. */
static inline void add_line(stream_t *stream, const char *body, bool crc16, const char *ending) {
    char line[300] = "$";
    const size_t length = strlen(body);
    unsigned sum = crc16 ? slow_crc(0, (const uint8_t *)body, length) : 0;
    for (size_t i = 0; i < length && !crc16; i++) {
        sum ^= (uint8_t)body[i];
    }
    memcpy(line + 1, body, length);
    line[length + 1] = '*';
    const size_t digits = crc16 ? 4 : 2;
    for (size_t i = digits; i > 0; i--, sum >>= 4) {
        line[length + 1 + i] = "0123456789ABCDEF"[sum & 15u];
    }
    strcpy(line + length + 2 + digits, ending);
    add_message(stream, line, strlen(line));
}

static inline void clear(stream_t *stream) {
    stream->length = 0;
    stream->messages = 0;
    stream->begin[0] = 0;
}

static inline void start_reader(bool exact) {
    imu_reader_init(&reader, exact ? OWN_HEADER : NULL, exact ? OWN_HEADER_BYTES : 0);
    clear(&found);
}

static inline void keep(const imu_message_t *message) {
    TEST_ASSERT_EQUAL(message->bytes[0] == 0xFA ? IMU_BINARY : IMU_LINE, message->kind);
    add_message(&found, message->bytes, message->length);
}

/* Pushes as a caller does and keeps what comes out. */
static inline void push_piece(const uint8_t *bytes, size_t length) {
    size_t taken = 0;
    bool got = true;
    while (taken < length || got) {
        imu_message_t message;
        const size_t step = imu_reader_push(&reader, bytes + taken, length - taken, &message, &got);
        TEST_ASSERT_TRUE(step <= length - taken);
        TEST_ASSERT_TRUE(step > 0 || got || taken == length);
        taken += step;
        if (got) {
            keep(&message);
        }
    }
}

static inline void push(const void *bytes, size_t length, size_t chunk) {
    for (size_t begin = 0; begin < length; begin += chunk) {
        push_piece((const uint8_t *)bytes + begin, length - begin < chunk ? length - begin : chunk);
    }
}

static inline void fall_silent(void) {
    imu_message_t message;
    while (imu_reader_silence(&reader, &message)) {
        keep(&message);
    }
    TEST_ASSERT_EQUAL_UINT16(0, reader.held);
}

/* Nothing but a held half message is neither delivered nor counted as skipped. */
static inline void assert_all_bytes_accounted(size_t pushed) {
    TEST_ASSERT_EQUAL_size_t(pushed, found.length + reader.counters.skipped_bytes +
                                         (size_t)(reader.held - reader.taken));
    TEST_ASSERT_EQUAL_size_t(found.messages,
                             (size_t)reader.counters.binary + reader.counters.lines);
}

static inline size_t message_bytes(const stream_t *stream, size_t number) {
    return (size_t)(stream->begin[number + 1] - stream->begin[number]);
}

/* All of the stream came out byte for byte and in order, but for message |lost| (NONE_LOST: all of
 * it), and nothing else. */
static inline void assert_only_lost(const stream_t *stream, size_t lost) {
    bool same = true;
    size_t next = 0;
    for (size_t i = 0; i < stream->messages && same; i++) {
        if (i != lost) {
            same = next < found.messages &&
                   message_bytes(stream, i) == message_bytes(&found, next) &&
                   memcmp(stream->bytes + stream->begin[i], found.bytes + found.begin[next],
                          message_bytes(stream, i)) == 0;
            next++;
        }
    }
    TEST_ASSERT_TRUE(same);
    TEST_ASSERT_EQUAL_size_t(next, found.messages);
}

#define NONE_LOST STREAM_MAX_MESSAGES

#endif
