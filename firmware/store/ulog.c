#include "store/ulog.h"

#include "base/panic.h"
#include "store/bytes.h"

#define FLAG_BITS_BYTES 40u
#define LEVEL_INFO '6'
#define VERSION 1u

static const uint8_t file_magic[] = {0x55, 0x4C, 0x6F, 0x67, 0x01, 0x12, 0x35};

static size_t finish(uint8_t *out, char type, const uint8_t *end) {
    const size_t length = (size_t)(end - out);
    (void)bytes_put_u16(out, (uint16_t)(length - ULOG_HEADER_BYTES));
    out[2] = (uint8_t)type;
    return length;
}

static uint8_t *put_bytes(const uint8_t *out, uint8_t *at, const void *bytes, size_t length) {
    REQUIRE((size_t)(at - out) + length <= ULOG_MESSAGE_MAX_BYTES);
    memcpy(at, bytes, length);
    return at + length;
}

static size_t keyed(uint8_t *out, char type, const char *key_type, const char *name,
                    const void *value, size_t length) {
    uint8_t *at = out + ULOG_HEADER_BYTES + 1;
    at = put_bytes(out, at, key_type, strlen(key_type));
    at = put_bytes(out, at, name, strlen(name));
    out[ULOG_HEADER_BYTES] = (uint8_t)((size_t)(at - out) - ULOG_HEADER_BYTES - 1u);
    return finish(out, type, put_bytes(out, at, value, length));
}

size_t ulog_file_header(uint8_t *out, uint64_t timestamp_us) {
    memcpy(out, file_magic, sizeof file_magic);
    out[sizeof file_magic] = VERSION;
    (void)bytes_put_u64(out + sizeof file_magic + 1, timestamp_us);
    return ULOG_FILE_HEADER_BYTES;
}

size_t ulog_flag_bits(uint8_t *out) {
    memset(out + ULOG_HEADER_BYTES, 0, FLAG_BITS_BYTES);
    return finish(out, 'B', out + ULOG_HEADER_BYTES + FLAG_BITS_BYTES);
}

size_t ulog_format(uint8_t *out, const char *format) {
    return finish(out, 'F', put_bytes(out, out + ULOG_HEADER_BYTES, format, strlen(format)));
}

size_t ulog_info(uint8_t *out, const char *key, const void *value, size_t length) {
    return keyed(out, 'I', "", key, value, length);
}

size_t ulog_info_u32(uint8_t *out, const char *key, uint32_t value) {
    uint8_t bytes[4];
    (void)bytes_put_u32(bytes, value);
    return ulog_info(out, key, bytes, sizeof bytes);
}

size_t ulog_info_text(uint8_t *out, const char *name, const char *text) {
    const size_t length = strlen(text);
    REQUIRE(length < 100u);
    char type[] = "char[00] ";
    type[5] = (char)('0' + length / 10u);
    type[6] = (char)('0' + length % 10u);
    if (length < 10u) {
        memmove(type + 5, type + 6, sizeof type - 6u);
    }
    return keyed(out, 'I', type, name, text, length);
}

size_t ulog_parameter(uint8_t *out, const char *name, float value) {
    uint8_t bytes[4];
    (void)bytes_put_f32(bytes, value);
    return keyed(out, 'P', "float ", name, bytes, sizeof bytes);
}

size_t ulog_subscribe(uint8_t *out, uint16_t message_id, const char *topic) {
    out[ULOG_HEADER_BYTES] = 0; /* one instance of each topic */
    uint8_t *at = bytes_put_u16(out + ULOG_HEADER_BYTES + 1, message_id);
    return finish(out, 'A', put_bytes(out, at, topic, strlen(topic)));
}

size_t ulog_data(uint8_t *out, uint16_t message_id, uint64_t timestamp_us, const void *fields,
                 size_t length) {
    uint8_t *at = bytes_put_u16(out + ULOG_HEADER_BYTES, message_id);
    at = bytes_put_u64(at, timestamp_us);
    return finish(out, 'D', put_bytes(out, at, fields, length));
}

size_t ulog_text(uint8_t *out, uint64_t timestamp_us, const char *text, size_t max) {
    const char *zero = memchr(text, '\0', max);
    const size_t length = zero == NULL ? max : (size_t)(zero - text);
    out[ULOG_HEADER_BYTES] = LEVEL_INFO;
    uint8_t *at = bytes_put_u64(out + ULOG_HEADER_BYTES + 1, timestamp_us);
    return finish(out, 'L', put_bytes(out, at, text, length));
}
