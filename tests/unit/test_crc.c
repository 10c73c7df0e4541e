/* Published check values, and a bit-by-bit computation that shares nothing with the tables. */
#include "base/crc.h"
#include "link/mavlink.h"

#include "checksum.h" /* MAVLink's */

#include "unity.h"

#define TEXT "123456789"
#define NOISE_BYTES 257u

void setUp(void) {}
void tearDown(void) {}

static void fill_noise(uint8_t *bytes, size_t count) {
    uint32_t state = 12345u;
    for (size_t i = 0; i < count; i++) {
        state = state * 1664525u + 1013904223u;
        bytes[i] = (uint8_t)(state >> 24);
    }
}

static uint32_t slow_crc32(uint32_t crc, const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count * 8u; i++) {
        const uint32_t bit = ((uint32_t)bytes[i / 8u] >> (i % 8u)) & 1u;
        crc = ((crc ^ bit) & 1u) != 0 ? (crc >> 1) ^ 0xEDB88320u : crc >> 1;
    }
    return crc;
}

/* As in the VN-100 manual: byte swap and shifts, no table. */
static uint16_t vn100_crc16(uint16_t crc, const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++) {
        crc = (uint16_t)((crc >> 8) | (crc << 8));
        crc = (uint16_t)(crc ^ bytes[i]);
        crc = (uint16_t)(crc ^ ((crc & 0xFFu) >> 4));
        crc = (uint16_t)(crc ^ (crc << 12));
        crc = (uint16_t)(crc ^ ((crc & 0xFFu) << 5));
    }
    return crc;
}

static void test_crc32_has_the_value_of_mavlink_ftp(void) {
    TEST_ASSERT_EQUAL_HEX32(0x2DFD2D88u, crc32_update(0, TEXT, 9));
}

/* zlib's CRC-32 of the same text is 0xCBF43926: same polynomial, all bits inverted before and
 * after. */
static void test_crc32_becomes_zlibs_by_inverting(void) {
    TEST_ASSERT_EQUAL_HEX32(0xCBF43926u, ~crc32_update(0xFFFFFFFFu, TEXT, 9));
}

static void test_crc16_has_the_xmodem_value(void) {
    TEST_ASSERT_EQUAL_HEX16(0x31C3u, crc16_update(0, TEXT, 9));
}

/* Of CRC-16/MCRF4XX; and each entry of the table against eight steps of one bit. */
static void test_mavlinks_sum_has_its_value(void) {
    TEST_ASSERT_EQUAL_HEX16(0x6F91u, crc_calculate((const uint8_t *)TEXT, 9));
#ifdef CRC_MCRF4XX_TABLE
    TEST_ASSERT_EQUAL_HEX16(0x6F91u, crc_mcrf4xx_update(0xFFFFu, TEXT, 9));
    for (unsigned byte = 0; byte < 256; byte++) {
        unsigned sum = byte;
        for (unsigned bit = 0; bit < 8; bit++) {
            sum = (sum & 1u) != 0 ? sum >> 1 ^ 0x8408u : sum >> 1;
        }
        TEST_ASSERT_EQUAL_HEX16(sum, crc_mcrf4xx_byte[byte]);
    }
#endif
}

static void test_nothing_changes_nothing(void) {
    TEST_ASSERT_EQUAL_HEX32(0x1234ABCDu, crc32_update(0x1234ABCDu, TEXT, 0));
    TEST_ASSERT_EQUAL_HEX16(0xABCDu, crc16_update(0xABCDu, TEXT, 0));
}

static void test_crc16_over_its_own_bytes_is_zero(void) {
    uint8_t frame[NOISE_BYTES];
    fill_noise(frame, sizeof frame);
    const uint16_t crc = crc16_update(0, frame, 62);
    frame[62] = (uint8_t)(crc >> 8);
    frame[63] = (uint8_t)crc;
    TEST_ASSERT_EQUAL_HEX16(0, crc16_update(0, frame, 64));
}

static void test_every_length_and_split_agrees_with_the_slow_way(void) {
    uint8_t noise[NOISE_BYTES];
    fill_noise(noise, sizeof noise);
    for (size_t length = 0; length <= NOISE_BYTES; length++) {
        const size_t split = length * 2u / 3u;
        const uint32_t head32 = crc32_update(0, noise, split);
        const uint16_t head16 = crc16_update(0, noise, split);
        TEST_ASSERT_EQUAL_HEX32(slow_crc32(0, noise, length),
                                crc32_update(head32, noise + split, length - split));
        TEST_ASSERT_EQUAL_HEX16(vn100_crc16(0, noise, length),
                                crc16_update(head16, noise + split, length - split));
    }
}

static void test_every_flipped_bit_is_noticed(void) {
    uint8_t frame[64];
    fill_noise(frame, sizeof frame);
    const uint32_t good32 = crc32_update(0, frame, sizeof frame);
    const uint16_t good16 = crc16_update(0, frame, sizeof frame);
    for (size_t bit = 0; bit < 8u * sizeof frame; bit++) {
        frame[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
        TEST_ASSERT_NOT_EQUAL(good32, crc32_update(0, frame, sizeof frame));
        TEST_ASSERT_NOT_EQUAL(good16, crc16_update(0, frame, sizeof frame));
        frame[bit / 8u] ^= (uint8_t)(1u << (bit % 8u));
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(test_crc32_has_the_value_of_mavlink_ftp);
    RUN_TEST(test_crc32_becomes_zlibs_by_inverting);
    RUN_TEST(test_crc16_has_the_xmodem_value);
    RUN_TEST(test_mavlinks_sum_has_its_value);
    RUN_TEST(test_nothing_changes_nothing);
    RUN_TEST(test_crc16_over_its_own_bytes_is_zero);
    RUN_TEST(test_every_length_and_split_agrees_with_the_slow_way);
    RUN_TEST(test_every_flipped_bit_is_noticed);
    return UNITY_END();
}
