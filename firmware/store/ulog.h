/*
 * ULog messages, version 1 (PX4's file format), as bytes. Pure functions: each writes one whole
 * message to |out|, which holds ULOG_MESSAGE_MAX_BYTES, and returns its length.
 */
#ifndef STORE_ULOG_H
#define STORE_ULOG_H

#include <stddef.h>
#include <stdint.h>

#define ULOG_MESSAGE_MAX_BYTES 256u
#define ULOG_HEADER_BYTES 3u /* of every message: u16 length, type */
#define ULOG_FILE_HEADER_BYTES 16u

/* The file's first bytes; flag bits must follow. */
size_t ulog_file_header(uint8_t *out, uint64_t timestamp_us);
size_t ulog_flag_bits(uint8_t *out);

/* |format| as "topic:type field;...;", its first field "uint64_t timestamp". */
size_t ulog_format(uint8_t *out, const char *format);

/* |key| as "type name". The value is already little-endian bytes. */
size_t ulog_info(uint8_t *out, const char *key, const void *value, size_t length);
size_t ulog_info_u32(uint8_t *out, const char *key, uint32_t value);

/* |name| becomes "char[length] name". */
size_t ulog_info_text(uint8_t *out, const char *name, const char *text);
size_t ulog_parameter(uint8_t *out, const char *name, float value);
size_t ulog_subscribe(uint8_t *out, uint16_t message_id, const char *topic);

/* |fields| are those after the timestamp. */
size_t ulog_data(uint8_t *out, uint16_t message_id, uint64_t timestamp_us, const void *fields,
                 size_t length);

/* A logged line of level "info", cut at |max| characters. */
size_t ulog_text(uint8_t *out, uint64_t timestamp_us, const char *text, size_t max);

#endif
