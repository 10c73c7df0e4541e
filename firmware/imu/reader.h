/*
 * VN-100 byte stream in, checked messages out: binary frames and ASCII lines, mixed, any chunking.
 *
 * A message is taken only when all of it is right: a binary frame's header announces known groups
 * and fields (or is exactly the one that is expected) and its CRC fits; a line is $VN...,
 * printable, at most IMU_LINE_MAX_BYTES, with a right 8-bit or 16-bit check, ended by LF, CR
 * optional. What fails is searched again from the byte after its first one, so that one lost byte
 * costs one message and never more. Split packets (sync FB) are no messages. A line is given up at
 * the first byte that cannot be in it, so it never hides a frame. What comes out does not depend on
 * the chunks.
 *
 * Every byte pushed is in exactly one of: a message, counters.skipped_bytes, or still held. Bounded
 * memory (one window), no heap; time per byte is bounded but for repeated searches: at most one CRC
 * over 600 bytes per sync byte found. Not for interrupts.
 *
 * Source: VN-100 user manual UM001, binary and ASCII message formats.
 */
#ifndef IMU_READER_H
#define IMU_READER_H

#include "imu/layout.h"
#include "imu/message.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define IMU_LINE_MAX_BYTES 256u /* '$' to LF */

/* Monotonic. */
typedef struct {
    uint32_t binary;          /* good frames */
    uint32_t lines;           /* good lines */
    uint32_t crc_failed;      /* frames with a possible header, all of their length, wrong CRC */
    uint32_t checksum_failed; /* lines that end in '*' and a check that does not fit */
    uint32_t header_rejects;  /* sync bytes that begin no frame */
    uint32_t dropped; /* half messages given up in a silence: frames and lines, or their begins */
    uint32_t skipped_bytes; /* that belonged to no message */
} imu_reader_counters_t;

typedef struct {
    uint8_t header[IMU_HEADER_MAX_BYTES]; /* the one binary header that is expected */
    uint8_t header_bytes;                 /* 0 = any that is possible */
    uint16_t frame_bytes;                 /* of a frame with that header */
    uint16_t held;
    uint16_t taken;  /* bytes at the window's begin that were handed out as a message */
    uint16_t wanted; /* bytes to hold before the frame at the window's begin can be judged, or 0 */
    uint16_t plain;  /* bytes of the line at the window's begin that are known to belong to it */
    imu_reader_counters_t counters;
    uint8_t window[IMU_BINARY_MAX_BYTES];
} imu_reader_t;

/* |header|: the only binary header to be believed, all |header_bytes| of it, copied; NULL, 0 = any.
 * With it a false sync byte costs at most that many bytes of delay, without it up to 600. */
void imu_reader_init(imu_reader_t *reader, const uint8_t *header, uint8_t header_bytes);

/* Consumes bytes up to and including the end of the next good message. Returns how many of |length|
 * were taken, none when the message was among what was held; *got says whether |message| was
 * filled. Call again with the rest until all are taken and nothing more is got. */
size_t imu_reader_push(imu_reader_t *reader, const uint8_t *bytes, size_t length,
                       imu_message_t *message, bool *got);

/* The stream is silent (longer than any gap within a message) or at its end: what is held can no
 * longer become what it began as. Gives it up and searches its rest; true and |message| when that
 * holds a whole one. Call until false. */
bool imu_reader_silence(imu_reader_t *reader, imu_message_t *message);

#endif
