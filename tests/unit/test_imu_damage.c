/*
 * One lost, added or flipped byte or bit, at every place of a window of messages: the touched one
 * is lost and no other, and nothing comes out that did not go in. The chance that damage makes
 * another right CRC is one in 65536; with these streams it never does.
 */
#include "imu_stream.h"
#include "target.h"

#define MESSAGES TIMES(20u, 10u)

static stream_t window;
static uint8_t damaged[STREAM_MAX_BYTES];

void setUp(void) {}
void tearDown(void) {}

static void make_own_frames(void) {
    clear(&window);
    random_state = 7u;
    while (window.messages < MESSAGES) {
        add_frame(&window, OWN_HEADER, OWN_HEADER_BYTES, 64);
    }
}

/* Layouts that real sensors were recorded with, and the shortest there is. */
static void add_any_frame(unsigned number) {
    static const uint8_t headers[][8] = {
        {0xFA, 0x06, 0x01, 0x00, 0x0E, 0x00}, {0xFA, 0x12, 0x01, 0x00, 0x02, 0x01},
        {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00}, {0xFA, 0x01, 0x08, 0x00},
        {0xFA, 0x14, 0x3E, 0x00, 0x3A, 0x00}, {0xFA, 0x02, 0x00, 0x02},
    };
    static const uint8_t sizes[][2] = {{6, 52}, {6, 40}, {6, 64}, {4, 18}, {6, 124}, {4, 7}};
    const size_t kind = number % 6u;
    add_frame(&window, headers[kind], sizes[kind][0], sizes[kind][1]);
}

static void make_any_frames(void) {
    clear(&window);
    random_state = 11u;
    while (window.messages < MESSAGES) {
        add_any_frame((unsigned)window.messages);
    }
}

static void make_mixed_messages(void) {
    clear(&window);
    random_state = 13u;
    while (window.messages < MESSAGES) {
        add_any_frame((unsigned)window.messages);
        add_line(&window, "VNYPR,+010.071,+000.278,-002.026,T1162704,S0000", false, "\r\n");
        add_frame(&window, OWN_HEADER, OWN_HEADER_BYTES, 64);
        add_line(&window, "VNRRG,75,3,400,01,0321", true, "\r\n");
        add_line(&window, "VNYBA,+059.745,+003.857,-004.949,+00.001", false, "\n");
    }
}

static size_t message_at(size_t at) {
    size_t number = 0;
    while (window.begin[number + 1] <= at) {
        number++;
    }
    return number;
}

/* Which of several equal bytes in a row is gone nobody can tell: the last of the run is as good. */
static size_t end_of_run(size_t at) {
    while (at + 1 < window.length && window.bytes[at + 1] == window.bytes[at]) {
        at++;
    }
    return at;
}

/* Whether |stray| put in before |at| is the same as put in between two messages. */
static bool falls_between(size_t at, uint8_t stray) {
    size_t first = at, last = at;
    while (first > 0 && window.bytes[first - 1] == stray) {
        first--;
    }
    while (last < window.length && window.bytes[last] == stray) {
        last++;
    }
    for (size_t i = 0; i <= window.messages; i++) {
        if (window.begin[i] >= first && window.begin[i] <= last) {
            return true;
        }
    }
    return false;
}

static void read_damaged(size_t length, size_t chunk, bool exact) {
    start_reader(exact);
    push(damaged, length, chunk);
    fall_silent();
    assert_all_bytes_accounted(length);
}

/* A line may do without its CR. It is then found as it went in: a byte shorter. */
static bool is_cr_of_line(size_t at) {
    const size_t number = message_at(at);
    return window.bytes[window.begin[number]] == '$' && window.bytes[at] == '\r' &&
           at + 2 == window.begin[number + 1];
}

static void assert_came_without_cr(size_t number) {
    TEST_ASSERT_EQUAL_size_t(window.messages, found.messages);
    TEST_ASSERT_EQUAL_size_t(message_bytes(&window, number) - 1, message_bytes(&found, number));
    TEST_ASSERT_EQUAL_size_t(window.length - 1, found.length);
    TEST_ASSERT_EQUAL_INT(0, memcmp(damaged, found.bytes, found.length));
}

static void every_deletion_loses_one(bool exact) {
    const size_t chunks[] = {1, 7, 64, STREAM_MAX_BYTES};
    for (size_t at = 0; at < window.length; at++) {
        memcpy(damaged, window.bytes, at);
        memcpy(damaged + at, window.bytes + at + 1, window.length - at - 1);
        read_damaged(window.length - 1, chunks[at % 4], exact);
        if (is_cr_of_line(at)) {
            assert_came_without_cr(message_at(at));
        } else {
            assert_only_lost(&window, message_at(end_of_run(at)));
        }
    }
}

static void every_insertion_loses_at_most_one(bool exact) {
    for (size_t at = 0; at <= window.length; at++) {
        const uint8_t strays[] = {0xFA, '$', (uint8_t)random_u32()};
        for (size_t s = 0; s < sizeof strays; s++) {
            memcpy(damaged, window.bytes, at);
            damaged[at] = strays[s];
            memcpy(damaged + at + 1, window.bytes + at, window.length - at);
            read_damaged(window.length + 1, 1 + (3 * at + s) % 70, exact);
            assert_only_lost(&window, falls_between(at, strays[s]) ? NONE_LOST : message_at(at));
        }
    }
}

static void every_flipped_bit_loses_one(bool exact) {
    memcpy(damaged, window.bytes, window.length);
    for (size_t at = 0; at < window.length; at++) {
        for (unsigned bit = 0; bit < 8; bit++) {
            damaged[at] ^= (uint8_t)(1u << bit);
            read_damaged(window.length, bit % 2 == 0 ? 64 : STREAM_MAX_BYTES, exact);
            assert_only_lost(&window, message_at(at));
            damaged[at] ^= (uint8_t)(1u << bit);
        }
    }
}

static void own_frames_with_a_byte_less(void) {
    make_own_frames();
    every_deletion_loses_one(true);
}

static void own_frames_with_a_byte_more(void) {
    make_own_frames();
    every_insertion_loses_at_most_one(true);
}

static void own_frames_with_a_flipped_bit(void) {
    make_own_frames();
    every_flipped_bit_loses_one(true);
}

static void any_frames_with_a_byte_less(void) {
    make_any_frames();
    every_deletion_loses_one(false);
}

static void any_frames_with_a_byte_more(void) {
    make_any_frames();
    every_insertion_loses_at_most_one(false);
}

static void any_frames_with_a_flipped_bit(void) {
    make_any_frames();
    every_flipped_bit_loses_one(false);
}

static void mixed_messages_with_a_byte_less(void) {
    make_mixed_messages();
    every_deletion_loses_one(false);
}

static void mixed_messages_with_a_byte_more(void) {
    make_mixed_messages();
    every_insertion_loses_at_most_one(false);
}

static void mixed_messages_with_a_flipped_bit(void) {
    make_mixed_messages();
    every_flipped_bit_loses_one(false);
}

/* A CRC may look like a sync byte, or two of them. */
static void frames_whose_crc_equals_the_sync_byte(void) {
    clear(&window);
    random_state = 17u;
    const uint16_t wanted[] = {0xFAFA, 0x12FA, 0xFA12, 0xFA11};
    while (window.messages < MESSAGES) {
        add_frame(&window, OWN_HEADER, OWN_HEADER_BYTES, 64);
        uint8_t *const frame = window.bytes + window.begin[window.messages - 1];
        const uint16_t before = slow_crc(0, frame + 1, 59);
        const uint16_t crc = wanted[window.messages % 4];
        for (unsigned last = 0; slow_crc(before, frame + 60, 2) != crc; last++) {
            TEST_ASSERT_TRUE(last <= 0xFFFFu);
            frame[60] = (uint8_t)(last >> 8);
            frame[61] = (uint8_t)last;
        }
        seal_frame(frame, 64);
        TEST_ASSERT_TRUE(frame[62] == 0xFA || frame[63] == 0xFA);
    }
    for (int exact = 0; exact < 2; exact++) {
        memcpy(damaged, window.bytes, window.length);
        read_damaged(window.length, 64, exact != 0);
        assert_only_lost(&window, NONE_LOST);
        every_deletion_loses_one(exact != 0);
        every_insertion_loses_at_most_one(exact != 0);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(own_frames_with_a_byte_less);
    RUN_TEST(own_frames_with_a_byte_more);
    RUN_TEST(own_frames_with_a_flipped_bit);
    RUN_TEST(any_frames_with_a_byte_less);
    RUN_TEST(any_frames_with_a_byte_more);
    RUN_TEST(any_frames_with_a_flipped_bit);
    RUN_TEST(mixed_messages_with_a_byte_less);
    RUN_TEST(mixed_messages_with_a_byte_more);
    RUN_TEST(mixed_messages_with_a_flipped_bit);
    RUN_TEST(frames_whose_crc_equals_the_sync_byte);
    return UNITY_END();
}
