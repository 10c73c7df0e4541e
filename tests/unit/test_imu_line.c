/* Fields of lines, numbers and commands. Strings with their checks are public examples. */
#include "imu/line.h"

#include "unity.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char YMR[] = "$VNYMR,+100.949,-007.330,+000.715,-00.0049,-00.2449,+00.5397,-01.258,"
                          "-00.100,-09.701,-00.000018,+00.001122,-00.000551*69\r\n";
static uint32_t random_state = 1u;

void setUp(void) {}
void tearDown(void) {}

static uint32_t random_u32(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return random_state >> 8;
}

static imu_message_t message_of(const char *line) {
    const imu_message_t message = {IMU_LINE, (uint16_t)strlen(line), (const uint8_t *)line};
    return message;
}

static imu_text_t text_of(const char *chars) {
    const imu_text_t text = {chars, (uint16_t)strlen(chars)};
    return text;
}

static imu_text_t body_of(const char *line) {
    const imu_message_t message = message_of(line);
    return imu_line_body(&message);
}

static void assert_text(const char *expected, imu_text_t text) {
    TEST_ASSERT_EQUAL_size_t(strlen(expected), text.length);
    TEST_ASSERT_EQUAL_INT(0, memcmp(expected, text.chars, text.length));
}

static void the_body_lies_between_dollar_and_star(void) {
    const imu_message_t short_check = message_of("$VNRRG,07,40*5C\r\n");
    const imu_message_t long_check = message_of("$VNRRG,06,1,1*0865\n");
    assert_text("VNRRG,07,40", imu_line_body(&short_check));
    assert_text("VNRRG,06,1,1", imu_line_body(&long_check));
    TEST_ASSERT_EQUAL(IMU_CHECK_XOR8, imu_line_check(&short_check));
    TEST_ASSERT_EQUAL(IMU_CHECK_CRC16, imu_line_check(&long_check));
    const imu_message_t bare = message_of("$VNWNV*57\n");
    TEST_ASSERT_EQUAL(IMU_CHECK_XOR8, imu_line_check(&bare));
}

static void types_are_told_apart(void) {
    const imu_text_t body = body_of(YMR);
    TEST_ASSERT_TRUE(imu_line_is(body, "VNYMR"));
    TEST_ASSERT_FALSE(imu_line_is(body, "VNYMA"));
    TEST_ASSERT_TRUE(imu_line_is(text_of("VNWNV"), "VNWNV"));
    TEST_ASSERT_FALSE(imu_line_is(text_of("VNWN"), "VNWNV"));
}

static void fields_are_found_by_their_commas(void) {
    const imu_text_t body = body_of(YMR);
    TEST_ASSERT_EQUAL_UINT(13, imu_line_fields(body));
    assert_text("VNYMR", imu_line_field(body, 0));
    assert_text("+100.949", imu_line_field(body, 1));
    assert_text("-00.000551", imu_line_field(body, 12));
    assert_text("", imu_line_field(body, 13));
    assert_text("", imu_line_field(body, 1000));
    const imu_text_t holes = text_of("VNRRG,,01,");
    TEST_ASSERT_EQUAL_UINT(4, imu_line_fields(holes));
    assert_text("", imu_line_field(holes, 1));
    assert_text("01", imu_line_field(holes, 2));
    assert_text("", imu_line_field(holes, 3));
    assert_text("", imu_line_field(holes, 4));
    TEST_ASSERT_EQUAL_UINT(1, imu_line_fields(text_of("VNWNV")));
}

static void assert_unsigned(const char *text, uint32_t base, uint32_t expected) {
    uint32_t value = 0;
    TEST_ASSERT_TRUE(imu_text_unsigned(text_of(text), base, &value));
    TEST_ASSERT_EQUAL_UINT32(expected, value);
}

static void assert_no_unsigned(const char *text, uint32_t base) {
    uint32_t value = 0;
    TEST_ASSERT_FALSE(imu_text_unsigned(text_of(text), base, &value));
}

static void whole_numbers_are_read_in_both_bases(void) {
    assert_unsigned("0", 10, 0);
    assert_unsigned("0129", 10, 129);
    assert_unsigned("0129", 16, 0x129);
    assert_unsigned("FF", 16, 255);
    assert_unsigned("4294967295", 10, UINT32_MAX);
    assert_unsigned("00FFFFFFFF", 16, UINT32_MAX);
    assert_no_unsigned("4294967296", 10);
    assert_no_unsigned("9999999999", 10);
    assert_no_unsigned("100000000", 16);
    assert_no_unsigned("", 10);
    assert_no_unsigned("-1", 10);
    assert_no_unsigned("+1", 10);
    assert_no_unsigned("1A", 10);
    assert_no_unsigned("1a", 16);
    assert_no_unsigned("0x1A", 16);
    assert_no_unsigned("1G", 16);
    assert_no_unsigned("1.0", 10);
    assert_no_unsigned("1 ", 10);
}

static void assert_float(const char *text) {
    float value = 0.0f;
    TEST_ASSERT_TRUE_MESSAGE(imu_text_float(text_of(text), &value), text);
    /* The C library rounds rightly; neighbours of one sign have neighbouring bits. */
    const float right = strtof(text, NULL);
    int32_t bits = 0, right_bits = 0;
    memcpy(&bits, &value, sizeof bits);
    memcpy(&right_bits, &right, sizeof right_bits);
    TEST_ASSERT_INT32_WITHIN_MESSAGE(1, right_bits, bits, text);
}

static void fixed_point_numbers_are_read(void) {
    const char *const texts[] = {
        "+01.0640",    "-9.81",    "123",        "-00.000551", "+1.0640",    "-085.598",
        "0.",          ".5",       "-0",         "999999999",  "0.99999999", "-16777217",
        "+00.0000001", "+180.000", "-09.793746", "033554431",  "1.67772170", "8388608.50"};
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        assert_float(texts[i]);
    }
}

static void any_nine_digits_are_read(void) {
    for (unsigned i = 0; i < 5000; i++) {
        char text[16];
        const unsigned whole = random_u32() % 10;
        for (unsigned digit = 0; digit < 10; digit++) {
            text[1 + digit] = digit == whole ? '.' : (char)('0' + random_u32() % 10);
        }
        text[0] = random_u32() % 2 == 0 ? '+' : '-';
        text[11] = '\0';
        assert_float(text);
    }
}

static void what_is_no_number_is_refused(void) {
    const char *const texts[] = {"",     "+",        "-.",         ".",    "+-1",  "1e3",
                                 "nan",  "T1162704", "1.2.3",      " 1.0", "1.0 ", "1,0",
                                 "0x10", "inf",      "1234567890", "--1",  "A",    "0.123456789"};
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        float value = 0.0f;
        TEST_ASSERT_FALSE_MESSAGE(imu_text_float(text_of(texts[i]), &value), texts[i]);
    }
}

static void a_real_line_gives_its_values(void) {
    const float expected[] = {100.949f, -7.33f, 0.715f,  -0.0049f,   -0.2449f,  0.5397f,
                              -1.258f,  -0.1f,  -9.701f, -0.000018f, 0.001122f, -0.000551f};
    for (unsigned i = 0; i < 12; i++) {
        float value = 0.0f;
        TEST_ASSERT_TRUE(imu_text_float(imu_line_field(body_of(YMR), i + 1), &value));
        TEST_ASSERT_EQUAL_FLOAT(expected[i], value);
    }
}

/* Whatever stands in a line: the same as field by field, and NaN for what is no number. */
static void a_line_is_read_in_one_pass(void) {
    for (unsigned i = 0; i < 3000; i++) {
        char line[128] = "$VNYMR";
        size_t length = strlen(line);
        while (length < 100 && random_u32() % 12 != 0) {
            const char *const bits = random_u32() % 4 == 0 ? ",,,,.+-A1" : "0123456789.,";
            line[length++] = ',';
            for (unsigned chars = random_u32() % 12; chars != 0; chars--) {
                line[length++] = bits[random_u32() % strlen(bits)];
            }
        }
        strcpy(line + length, "*00\r\n");
        const imu_message_t message = message_of(line);
        const imu_text_t body = imu_line_body(&message);
        float values[128];
        const unsigned count = imu_line_floats(&message, values, 128);
        TEST_ASSERT_EQUAL_UINT_MESSAGE(imu_line_fields(body) - 1, count, line);
        for (unsigned field = 0; field < count; field++) {
            float value = NAN;
            (void)imu_text_float(imu_line_field(body, field + 1), &value);
            TEST_ASSERT_TRUE_MESSAGE(memcmp(&value, &values[field], sizeof value) == 0 ||
                                         (isnan(value) && isnan(values[field])),
                                     line);
        }
    }
}

static void no_more_values_are_read_than_there_is_room_for(void) {
    const imu_message_t message = message_of(YMR), bare = message_of("$VNWNV*57\n");
    float values[3] = {0.0f, 0.0f, 7.0f};
    TEST_ASSERT_EQUAL_UINT(2, imu_line_floats(&message, values, 2));
    TEST_ASSERT_EQUAL_FLOAT(-7.33f, values[1]);
    TEST_ASSERT_EQUAL_FLOAT(7.0f, values[2]);
    TEST_ASSERT_EQUAL_UINT(0, imu_line_floats(&bare, values, 3));
}

static void error_codes_are_read_in_both_notations(void) {
    static const char *const hex[] = {"0A", "0B", "0C", "FF", "A"};
    static const unsigned hex_codes[] = {10, 11, 12, 255, 10};
    char body[20];
    for (unsigned code = 1; code <= 12; code++) {
        sprintf(body, "VNERR,%02u", code);
        TEST_ASSERT_EQUAL_UINT(code, imu_line_error(text_of(body)));
    }
    for (size_t i = 0; i < sizeof hex / sizeof hex[0]; i++) {
        sprintf(body, "VNERR,%s", hex[i]);
        TEST_ASSERT_EQUAL_UINT(hex_codes[i], imu_line_error(text_of(body)));
    }
    TEST_ASSERT_EQUAL_UINT(12, imu_line_error(body_of("$VNERR,0C*02\r\n")));
    TEST_ASSERT_EQUAL_UINT(12, imu_line_error(body_of("$VNERR,12*72\r\n")));
    TEST_ASSERT_EQUAL_UINT(3, imu_line_error(body_of("$VNERR,03*72\r\n")));
    TEST_ASSERT_EQUAL_UINT(255, imu_line_error(text_of("VNERR,255")));
    TEST_ASSERT_EQUAL_UINT(4, imu_line_error(text_of("VNERR,4,RRG")));
}

static void what_is_no_error_has_no_code(void) {
    const char *const bodies[] = {"VNERR",    "VNERR,",   "VNERR,0",  "VNERR,00", "VNERR,13",
                                  "VNERR,0D", "VNERR,XX", "VNERR,-1", "VNRRG,03", "VNERR,1F"};
    for (size_t i = 0; i < sizeof bodies / sizeof bodies[0]; i++) {
        TEST_ASSERT_EQUAL_UINT_MESSAGE(0, imu_line_error(text_of(bodies[i])), bodies[i]);
    }
}

static void assert_sealed(const char *expected, const char *body, imu_check_t check) {
    char line[160] = "$";
    strcat(line, body);
    const size_t before = strlen(line);
    memset(line + before, '#', sizeof line - before);
    const uint16_t length = imu_line_seal(line, (uint16_t)before, check);
    TEST_ASSERT_EQUAL_UINT(strlen(expected), length);
    TEST_ASSERT_EQUAL_INT(0, memcmp(expected, line, length));
    TEST_ASSERT_EQUAL_CHAR('#', line[length]);
    TEST_ASSERT_EQUAL(IMU_LINE_GOOD, imu_line_verify((const uint8_t *)line, length));
}

static void commands_get_the_published_checks(void) {
    assert_sealed("$VNRRG,01*72\r\n", "VNRRG,01", IMU_CHECK_XOR8);
    assert_sealed("$VNRRG,07*74\r\n", "VNRRG,07", IMU_CHECK_XOR8);
    assert_sealed("$VNWNV*57\r\n", "VNWNV", IMU_CHECK_XOR8);
    assert_sealed("$VNASY,0*4F\r\n", "VNASY,0", IMU_CHECK_XOR8);
    assert_sealed("$VNWRG,05,230400*5A\r\n", "VNWRG,05,230400", IMU_CHECK_XOR8);
    assert_sealed("$VNWRG,75,2,8,11,0129,0040*5C\r\n", "VNWRG,75,2,8,11,0129,0040", IMU_CHECK_XOR8);
    assert_sealed("$VNRRG,06,1,1*0865\r\n", "VNRRG,06,1,1", IMU_CHECK_CRC16);
    assert_sealed("$VNRRG,07,1,1*A234\r\n", "VNRRG,07,1,1", IMU_CHECK_CRC16);
    assert_sealed("$VNRRG,75,3,400,01,0321*3B31\r\n", "VNRRG,75,3,400,01,0321", IMU_CHECK_CRC16);
}

static void assert_verdict(imu_line_t expected, const char *line) {
    TEST_ASSERT_EQUAL_MESSAGE(expected, imu_line_verify((const uint8_t *)line, strlen(line)), line);
}

static void checks_are_judged(void) {
    assert_verdict(IMU_LINE_GOOD, "$VNRRG,07*74\r\n");
    assert_verdict(IMU_LINE_GOOD, "$VNRRG,07*74\n");
    assert_verdict(IMU_LINE_DAMAGED, "$VNRRG,07*75\r\n");
    assert_verdict(IMU_LINE_DAMAGED, "$VNRRG,06*74\n");
    assert_verdict(IMU_LINE_DAMAGED, "$VNRRG,06,1,1*0856\r\n");
    assert_verdict(IMU_LINE_DAMAGED, "$VNRRG,07*0074\r\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,07*XX\r\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,07*7\r\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,07*074\r\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,07*\r\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,07\r\n");
    assert_verdict(IMU_LINE_NONE, "$VN\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,07*4C**74\r\n");
    assert_verdict(IMU_LINE_NONE, "$VNRRG,10*+5\r\n");
}

/* At every place of runs of every length up to three words. */
static void every_byte_is_plain_or_not(void) {
    for (unsigned byte = 0; byte < 256; byte++) {
        const bool plain = byte >= 32 && byte < 127 && byte != '$';
        for (size_t length = 1; length <= 3 * sizeof(size_t); length++) {
            uint8_t bytes[3 * sizeof(size_t)];
            for (size_t i = 0; i < length; i++) {
                bytes[i] = (uint8_t) " ~#%A"[i % 5];
            }
            const size_t at = (byte + length) % length;
            bytes[at] = (uint8_t)byte;
            TEST_ASSERT_EQUAL_size_t(plain ? length : at, imu_line_plain(bytes, length));
        }
    }
    TEST_ASSERT_EQUAL_size_t(0, imu_line_plain((const uint8_t *)"", 0));
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(the_body_lies_between_dollar_and_star);
    RUN_TEST(types_are_told_apart);
    RUN_TEST(fields_are_found_by_their_commas);
    RUN_TEST(whole_numbers_are_read_in_both_bases);
    RUN_TEST(fixed_point_numbers_are_read);
    RUN_TEST(any_nine_digits_are_read);
    RUN_TEST(what_is_no_number_is_refused);
    RUN_TEST(a_real_line_gives_its_values);
    RUN_TEST(a_line_is_read_in_one_pass);
    RUN_TEST(no_more_values_are_read_than_there_is_room_for);
    RUN_TEST(error_codes_are_read_in_both_notations);
    RUN_TEST(what_is_no_error_has_no_code);
    RUN_TEST(commands_get_the_published_checks);
    RUN_TEST(checks_are_judged);
    RUN_TEST(every_byte_is_plain_or_not);
    return UNITY_END();
}
