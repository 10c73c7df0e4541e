/* Headers of binary frames. Sizes and places are those of the VN-100 manual and of real frames. */
#include "imu/layout.h"

#include "unity.h"

#include <string.h>

static const imu_group_t groups[] = {IMU_GROUP_COMMON, IMU_GROUP_TIME, IMU_GROUP_IMU,
                                     IMU_GROUP_ATTITUDE};
/* Times 1 byte; a point is no field. In the order of the manual's bits. */
static const char *const sizes[] = {
    "8 8 8 12 16 12 24 12 12 24 20 28 2 4 8 .",
    "8 8 8 2 8 8 8 4 4 1 . . . . . .",
    "2 12 12 12 4 4 16 12 12 12 12 2 . . . .",
    "2 12 16 36 12 12 12 12 12 . . . 12 4 . .",
};

void setUp(void) {}
void tearDown(void) {}

/* Of field |bit| in |text|; 0 = none. */
static unsigned size_of(const char *text, unsigned bit) {
    for (; bit > 0; bit--) {
        text = strchr(text, ' ') + 1;
    }
    unsigned size = 0;
    for (; *text >= '0' && *text <= '9'; text++) {
        size = size * 10 + (unsigned)(*text - '0');
    }
    return size;
}

static imu_header_t judge(const uint8_t *bytes, size_t held, unsigned *length) {
    uint16_t frame_bytes = 0xFFFF;
    const imu_header_t header = imu_layout_header(bytes, held, &frame_bytes);
    *length = frame_bytes;
    return header;
}

static void assert_length(unsigned expected, const uint8_t *header, size_t header_bytes) {
    unsigned length = 0;
    TEST_ASSERT_EQUAL(IMU_HEADER_COMPLETE, judge(header, header_bytes, &length));
    TEST_ASSERT_EQUAL_UINT(expected, length);
    for (size_t held = 1; held < header_bytes; held++) {
        TEST_ASSERT_EQUAL(IMU_HEADER_CUT, judge(header, held, &length));
    }
}

static void assert_impossible(const uint8_t *header, size_t header_bytes) {
    unsigned length = 0;
    TEST_ASSERT_EQUAL(IMU_HEADER_IMPOSSIBLE, judge(header, header_bytes, &length));
}

static void real_frames_have_their_lengths(void) {
    assert_length(18, (const uint8_t[]){0xFA, 0x01, 0x08, 0x00}, 4);
    assert_length(26, (const uint8_t[]){0xFA, 0x01, 0x09, 0x00}, 4);
    assert_length(62, (const uint8_t[]){0xFA, 0x01, 0x28, 0x05}, 4);
    assert_length(52, (const uint8_t[]){0xFA, 0x06, 0x01, 0x00, 0x0E, 0x00}, 6);
    assert_length(40, (const uint8_t[]){0xFA, 0x12, 0x01, 0x00, 0x02, 0x01}, 6);
    assert_length(52, (const uint8_t[]){0xFA, 0x11, 0x29, 0x00, 0x40, 0x00}, 6);
    assert_length(64, (const uint8_t[]){0xFA, 0x11, 0x29, 0x01, 0x40, 0x00}, 6);
    assert_length(124, (const uint8_t[]){0xFA, 0x14, 0x3E, 0x00, 0x3A, 0x00}, 6);
}

static void every_single_field_has_its_size(void) {
    for (unsigned g = 0; g < 4; g++) {
        for (unsigned bit = 0; bit < 16; bit++) {
            const uint8_t header[] = {0xFA, (uint8_t)(1u << groups[g]), (uint8_t)(1u << bit),
                                      (uint8_t)((1u << bit) >> 8)};
            const unsigned size = size_of(sizes[g], bit);
            if (size == 0) {
                assert_impossible(header, sizeof header);
            } else {
                assert_length(4 + size + 2, header, sizeof header);
            }
        }
    }
}

static void the_longest_frame_is_short_enough(void) {
    const uint8_t header[] = {0xFA, 0x17, 0xFF, 0x7F, 0xFF, 0x03, 0xFF, 0x0F, 0xFF, 0x31};
    unsigned payload = 0;
    for (unsigned g = 0; g < 4; g++) {
        for (unsigned bit = 0; bit < 16; bit++) {
            payload += size_of(sizes[g], bit);
        }
    }
    TEST_ASSERT_EQUAL_size_t(IMU_HEADER_MAX_BYTES, sizeof header);
    assert_length(10 + payload + 2, header, sizeof header);
    TEST_ASSERT_TRUE(10 + payload + 2 <= IMU_BINARY_MAX_BYTES);
}

static void unknown_groups_are_impossible(void) {
    unsigned length = 0;
    for (unsigned byte = 0; byte < 256; byte++) {
        const uint8_t header[] = {0xFA, (uint8_t)byte, 0x01, 0x00, 0x01, 0x00, 0x01, 0x00, 0x01, 0};
        const bool known = byte != 0 && (byte & 0xE8u) == 0;
        TEST_ASSERT_EQUAL(known ? IMU_HEADER_COMPLETE : IMU_HEADER_IMPOSSIBLE,
                          judge(header, sizeof header, &length));
        TEST_ASSERT_EQUAL(known ? IMU_HEADER_CUT : IMU_HEADER_IMPOSSIBLE,
                          judge(header, 2, &length));
    }
}

static void a_word_without_fields_or_with_unknown_ones_is_impossible(void) {
    assert_impossible((const uint8_t[]){0xFA, 0x01, 0x00, 0x00}, 4);
    assert_impossible((const uint8_t[]){0xFA, 0x11, 0x29, 0x01, 0x00, 0x00}, 6);
    assert_impossible((const uint8_t[]){0xFA, 0x11, 0x00, 0x00}, 4);
    assert_impossible((const uint8_t[]){0xFA, 0x11, 0x29, 0x81}, 4);
    assert_impossible((const uint8_t[]){0xFA, 0x11, 0x29, 0x01, 0x41, 0x02}, 6);
}

static void assert_field(const uint8_t *frame, imu_group_t group, unsigned bit, unsigned at,
                         unsigned size) {
    uint16_t offset = 0, bytes = 0;
    TEST_ASSERT_TRUE(imu_layout_field(frame, group, bit, &offset, &bytes));
    TEST_ASSERT_EQUAL_UINT(at, offset);
    TEST_ASSERT_EQUAL_UINT(size, bytes);
}

static void fields_of_the_fishs_frame_are_found(void) {
    const uint8_t frame[64] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};
    uint16_t offset, bytes;
    assert_field(frame, IMU_GROUP_COMMON, 0, 6, 8);
    assert_field(frame, IMU_GROUP_COMMON, 3, 14, 12);
    assert_field(frame, IMU_GROUP_COMMON, 5, 26, 12);
    assert_field(frame, IMU_GROUP_COMMON, 8, 38, 12);
    assert_field(frame, IMU_GROUP_ATTITUDE, 6, 50, 12);
    TEST_ASSERT_FALSE(imu_layout_field(frame, IMU_GROUP_COMMON, 4, &offset, &bytes));
    TEST_ASSERT_FALSE(imu_layout_field(frame, IMU_GROUP_TIME, 0, &offset, &bytes));
    TEST_ASSERT_FALSE(imu_layout_field(frame, IMU_GROUP_ATTITUDE, 0, &offset, &bytes));
    TEST_ASSERT_FALSE(imu_layout_field(frame, IMU_GROUP_COMMON, 16, &offset, &bytes));
    TEST_ASSERT_FALSE(imu_layout_field(frame, IMU_GROUP_COMMON, 32, &offset, &bytes));
    TEST_ASSERT_FALSE(imu_layout_field(frame, (imu_group_t)3, 0, &offset, &bytes));
}

/* Temperature, pressure and attitude where an independent decoder of that recording found them. */
static void fields_of_a_recorded_frame_are_found(void) {
    const uint8_t frame[124] = {0xFA, 0x14, 0x3E, 0x00, 0x3A, 0x00};
    assert_field(frame, IMU_GROUP_IMU, 1, 6, 12);
    assert_field(frame, IMU_GROUP_IMU, 4, 42, 4);
    assert_field(frame, IMU_GROUP_IMU, 5, 46, 4);
    assert_field(frame, IMU_GROUP_ATTITUDE, 1, 50, 12);
    assert_field(frame, IMU_GROUP_ATTITUDE, 3, 62, 36);
    assert_field(frame, IMU_GROUP_ATTITUDE, 5, 110, 12);
}

static void all_fields_follow_one_another(void) {
    const uint8_t frame[IMU_HEADER_MAX_BYTES] = {0xFA, 0x17, 0xFF, 0x7F, 0xFF,
                                                 0x03, 0xFF, 0x0F, 0xFF, 0x31};
    unsigned at = sizeof frame;
    for (unsigned g = 0; g < 4; g++) {
        for (unsigned bit = 0; bit < 16; bit++) {
            const unsigned size = size_of(sizes[g], bit);
            if (size != 0) {
                assert_field(frame, groups[g], bit, at, size);
            }
            at += size;
        }
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(real_frames_have_their_lengths);
    RUN_TEST(every_single_field_has_its_size);
    RUN_TEST(the_longest_frame_is_short_enough);
    RUN_TEST(unknown_groups_are_impossible);
    RUN_TEST(a_word_without_fields_or_with_unknown_ones_is_impossible);
    RUN_TEST(fields_of_the_fishs_frame_are_found);
    RUN_TEST(fields_of_a_recorded_frame_are_found);
    RUN_TEST(all_fields_follow_one_another);
    return UNITY_END();
}
