#include "imu/line.h"

#include "base/crc.h"

#include <math.h>
#include <string.h>

#define FLOAT_MAX_DIGITS 9u

/* A machine word of equal bytes. */
#define EACH_BYTE(value) ((size_t)-1 / 0xFFu * (size_t)(value))

static size_t load_word(const uint8_t *bytes) {
    size_t word;
    memcpy(&word, bytes, sizeof word);
    return word;
}

static bool is_plain(uint8_t byte) { return byte >= ' ' && byte < 0x7Fu && byte != '$'; }

/* Each sum's top bit tells about one byte, as long as the word's own top bits are all 0; if one is
 * not, carries may spoil its neighbours, but then the answer is no anyhow. */
static bool all_plain(size_t word) {
    const size_t not_control = word + EACH_BYTE(0x80u - ' ');
    const size_t not_delete = ~(word | (word + EACH_BYTE(0x80u - 0x7Fu)));
    const size_t not_dollar = (word ^ EACH_BYTE('$')) + EACH_BYTE(0x7Fu);
    return (not_control & not_delete & not_dollar & EACH_BYTE(0x80u)) == EACH_BYTE(0x80u);
}

size_t imu_line_plain(const uint8_t *bytes, size_t length) {
    size_t plain = 0;
    while (length - plain >= sizeof(size_t) && all_plain(load_word(bytes + plain))) {
        plain += sizeof(size_t);
    }
    while (plain < length && is_plain(bytes[plain])) {
        plain++;
    }
    return plain;
}

static uint32_t xor8(const uint8_t *bytes, size_t length) {
    const uint8_t *const end = bytes + length;
    size_t word = 0;
    for (; (size_t)(end - bytes) >= sizeof word; bytes += sizeof word) {
        word ^= load_word(bytes);
    }
    for (; bytes != end; bytes++) {
        word ^= *bytes;
    }
    for (size_t bits = 4u * sizeof word; bits >= 8u; bits /= 2u) {
        word ^= word >> bits;
    }
    return (uint8_t)word;
}

static uint32_t check_of(imu_check_t check, const uint8_t *body, size_t length) {
    return check == IMU_CHECK_CRC16 ? crc16_update(0, body, length) : xor8(body, length);
}

imu_line_t imu_line_verify(const uint8_t *line, size_t length) {
    const uint8_t *const star = memchr(line, '*', length);
    if (star == NULL) {
        return IMU_LINE_NONE;
    }
    const size_t ending = line[length - 2u] == '\r' ? 2 : 1;
    const imu_text_t given = {(const char *)star + 1,
                              (uint16_t)((size_t)(line + length - star) - 1u - ending)};
    uint32_t value = 0;
    if ((given.length != 2 && given.length != 4) || !imu_text_unsigned(given, 16, &value)) {
        return IMU_LINE_NONE;
    }
    const imu_check_t check = given.length == 4 ? IMU_CHECK_CRC16 : IMU_CHECK_XOR8;
    const uint8_t *const body = line + 1;
    return value == check_of(check, body, (size_t)(star - body)) ? IMU_LINE_GOOD : IMU_LINE_DAMAGED;
}

static const uint8_t *find_star(const imu_message_t *message) {
    return memchr(message->bytes, '*', message->length);
}

imu_text_t imu_line_body(const imu_message_t *message) {
    const uint8_t *const body = message->bytes + 1;
    const imu_text_t text = {(const char *)body, (uint16_t)(find_star(message) - body)};
    return text;
}

imu_check_t imu_line_check(const imu_message_t *message) {
    return find_star(message)[3] < ' ' ? IMU_CHECK_XOR8 : IMU_CHECK_CRC16;
}

bool imu_line_is(imu_text_t body, const char *type) {
    return body.length >= IMU_LINE_TYPE_CHARS && memcmp(body.chars, type, IMU_LINE_TYPE_CHARS) == 0;
}

/* Cuts the first field off |rest|. */
static imu_text_t next_field(imu_text_t *rest) {
    imu_text_t field = *rest;
    const char *const comma = memchr(rest->chars, ',', rest->length);
    const size_t cut = comma == NULL ? rest->length : (size_t)(comma - rest->chars) + 1u;
    if (comma != NULL) {
        field.length = (uint16_t)(comma - rest->chars);
    }
    rest->chars += cut;
    rest->length = (uint16_t)(rest->length - cut);
    return field;
}

unsigned imu_line_fields(imu_text_t body) {
    unsigned fields = 1;
    for (size_t i = 0; i < body.length; i++) {
        fields += body.chars[i] == ',';
    }
    return fields;
}

imu_text_t imu_line_field(imu_text_t body, unsigned number) {
    imu_text_t field = next_field(&body);
    for (; number > 0; number--) {
        field = next_field(&body);
    }
    return field;
}

/* 16 or more when |digit| is none. */
static uint32_t digit_value(char digit) {
    const uint32_t decimal = (uint32_t)(uint8_t)digit - '0';
    const uint32_t letter = (uint32_t)(uint8_t)digit - 'A';
    return decimal < 10u ? decimal : letter < 6u ? letter + 10u : 16u;
}

bool imu_text_unsigned(imu_text_t text, uint32_t base, uint32_t *value) {
    uint32_t sum = 0;
    for (size_t i = 0; i < text.length; i++) {
        const uint32_t digit = digit_value(text.chars[i]);
        if (digit >= base || sum > (UINT32_MAX - digit) / base) {
            return false;
        }
        sum = sum * base + digit;
    }
    *value = sum;
    return text.length != 0;
}

/* Powers of ten up to 1e9 are exact in float32. */
static const float units[FLOAT_MAX_DIGITS + 1u] = {1.0f, 1e1f, 1e2f, 1e3f, 1e4f,
                                                   1e5f, 1e6f, 1e7f, 1e8f, 1e9f};

/* Reads digits up to what is none; |number| wraps when there are too many. */
static const char *read_digits(const char *at, uint32_t *number) {
    uint32_t digit;
    while ((digit = (uint32_t)(uint8_t)*at - '0') <= 9u) {
        *number = *number * 10u + digit;
        at++;
    }
    return at;
}

/* Reads a number from |at| on, behind which stands what belongs to none. Returns where it ends, or
 * NULL when there is none. */
static const char *read_float(const char *at, float *value) {
    const bool negative = *at == '-';
    const char *const begin = at + (negative || *at == '+');
    uint32_t number = 0;
    const char *stop = read_digits(begin, &number);
    size_t digits = (size_t)(stop - begin), decimals = 0;
    if (*stop == '.') {
        const char *const point = stop + 1;
        stop = read_digits(point, &number);
        decimals = (size_t)(stop - point);
        digits += decimals;
    }
    if (digits - 1u >= FLOAT_MAX_DIGITS) {
        return NULL;
    }
    /* Rounded twice, each time by half a place at most. */
    const float size = (float)number / units[decimals];
    *value = negative ? -size : size;
    return stop;
}

bool imu_text_float(imu_text_t text, float *value) {
    char ended[FLOAT_MAX_DIGITS + 3u] = {0}; /* a sign, a point, an end */
    float read;
    if (text.length == 0 || text.length >= sizeof ended) {
        return false;
    }
    memcpy(ended, text.chars, text.length);
    if (read_float(ended, &read) != ended + text.length) {
        return false;
    }
    *value = read;
    return true;
}

static const char *field_end(const char *at) {
    while (*at != ',' && *at != '*') {
        at++;
    }
    return at;
}

unsigned imu_line_floats(const imu_message_t *message, float *values, unsigned most) {
    const char *at = field_end((const char *)message->bytes + 1);
    unsigned count = 0;
    for (; *at == ',' && count < most; count++) {
        const char *const begin = at + 1;
        at = read_float(begin, &values[count]);
        if (at == NULL || (*at != ',' && *at != '*')) {
            values[count] = NAN;
            at = field_end(begin);
        }
    }
    return count;
}

static bool is_error_code(uint32_t code) { return (code >= 1u && code <= 12u) || code == 255u; }

unsigned imu_line_error(imu_text_t body) {
    if (!imu_line_is(body, "VNERR")) {
        return 0;
    }
    /* No code means one thing in one base and another in the other: 0x10 to 0x12 and 0x255 are
     * none. */
    const imu_text_t field = imu_line_field(body, 1);
    uint32_t code = 0;
    if (imu_text_unsigned(field, 10, &code) && is_error_code(code)) {
        return code;
    }
    return imu_text_unsigned(field, 16, &code) && is_error_code(code) ? code : 0;
}

uint16_t imu_line_seal(char *line, uint16_t length, imu_check_t check) {
    uint32_t sum = check_of(check, (const uint8_t *)line + 1, length - 1u);
    const uint32_t digits = check == IMU_CHECK_CRC16 ? 4 : 2;
    char *const tail = line + length;
    tail[0] = '*';
    for (uint32_t i = digits; i > 0; i--, sum >>= 4) {
        tail[i] = "0123456789ABCDEF"[sum & 15u];
    }
    tail[digits + 1u] = '\r';
    tail[digits + 2u] = '\n';
    return (uint16_t)(length + digits + 3u);
}
