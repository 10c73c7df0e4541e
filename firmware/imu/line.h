/*
 * ASCII lines of a VN-100: fields of those the reader has checked, and commands with their check.
 * No strtof: fixed-point fields are read as integers with a decimal exponent. Widths vary between
 * firmware versions, so fields are found by their commas. UM001, "ASCII Output Message Format".
 *
 * Pure, callable from interrupts; the caller owns all text.
 */
#ifndef IMU_LINE_H
#define IMU_LINE_H

#include "imu/message.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define IMU_LINE_TYPE_CHARS 5u /* VNYMR, VNRRG, VNERR, ... */

/* Neither zero-terminated nor owned. */
typedef struct {
    const char *chars;
    uint16_t length;
} imu_text_t;

/* How the line was checked; the sensor wants its commands the same way. */
typedef enum { IMU_CHECK_XOR8 = 1, IMU_CHECK_CRC16 = 3 } imu_check_t;

typedef enum {
    IMU_LINE_NONE, /* does not end in '*' and two or four digits */
    IMU_LINE_DAMAGED,
    IMU_LINE_GOOD
} imu_line_t;

/* How many of |length| bytes may stand in a line one after the other: printable ASCII but for '$',
 * which begins another line. */
size_t imu_line_plain(const uint8_t *bytes, size_t length);

/* Judges the check of a line: '$', plain characters, CR if any, LF. Digits are upper case, as the
 * sensor sends them; "*XX", with which a host may ask for no check, is none. */
imu_line_t imu_line_verify(const uint8_t *line, size_t length);

/* What stands between '$' and '*'. |message| is a line the reader got. */
imu_text_t imu_line_body(const imu_message_t *message);
imu_check_t imu_line_check(const imu_message_t *message);

/* Whether the body begins with the five characters of |type|, zero-terminated. */
bool imu_line_is(imu_text_t body, const char *type);

/* Fields separated by commas; number 0 is the type. */
unsigned imu_line_fields(imu_text_t body);
/* Empty text when there is none. */
imu_text_t imu_line_field(imu_text_t body, unsigned number);

/* The whole field as a number of base 10 or 16 (upper case); false when it is none or does not fit.
 */
bool imu_text_unsigned(imu_text_t text, uint32_t base, uint32_t *value);
/* "+01.0640", "-9.81", "123": at most 9 digits, no exponent. At most 1 in the last place of float32
 * away from the nearest one. */
bool imu_text_float(imu_text_t text, float *value);

/* All fields behind the type as numbers, read in one pass, at most |most| of them; NaN for a field
 * that is none. Returns how many. |message| is a line the reader got. */
unsigned imu_line_floats(const imu_message_t *message, float *values, unsigned most);

/* $VNERR's code in either notation (firmware 2 prints decimal, firmware 3 hexadecimal); 0 when the
 * body is no $VNERR or its code is none. */
unsigned imu_line_error(imu_text_t body);

/* Completes a command: |line| holds '$' and the body, |length| bytes in all, and has room for 7
 * more; appends '*', the check, CR and LF. Returns the new length. */
uint16_t imu_line_seal(char *line, uint16_t length, imu_check_t check);

#endif
