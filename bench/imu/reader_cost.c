/*
 * Gives the IMU reader something to count: pushes a stream in chunks of 64 bytes, many times over.
 * For callgrind (bench/reader_cost.py); prints what it pushed and what the reader found.
 *
 * Usage: imu_reader_cost exact|any|ascii|mixed[+values] REPEATS [FILE]
 *   exact  64-byte frames, the reader believes in that header only
 *   any    the same frames among others of 52 and 40 bytes, any header is believed
 *   ascii  $VNYMR lines, as the sensor sends them out of the box
 *   mixed  all of it
 *   +values  decodes the values, too
 *   FILE   a recording instead; any header, or the fish's own with "exact"
 * 0 REPEATS write the stream itself.
 */
#include "base/crc.h"
#include "imu/line.h"
#include "imu/reader.h"
#include "push_all.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STREAM_MAX_BYTES (1u << 20)
#define ROUNDS 100u
#define LOST_BYTES 23u

_Noreturn void panic(const char *where) {
    fprintf(stderr, "imu_reader_cost: %s\n", where);
    exit(2);
}

typedef struct {
    uint8_t bytes[STREAM_MAX_BYTES];
    size_t length;
    uint32_t random;
} stream_t;

static const uint8_t OWN_HEADER[] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};
static const uint8_t TIME_IMU_HEADER[] = {0xFA, 0x06, 0x01, 0x00, 0x0E, 0x00};
static const uint8_t TIME_ATTITUDE_HEADER[] = {0xFA, 0x12, 0x01, 0x00, 0x02, 0x01};

static uint32_t next_random(stream_t *stream) {
    stream->random = stream->random * 1664525u + 1013904223u;
    return stream->random >> 8;
}

/* Any payload: sync bytes and '$' occur in it as often as in real frames. */
static void add_frame(stream_t *stream, const uint8_t header[6], size_t frame_bytes) {
    uint8_t *const frame = stream->bytes + stream->length;
    memcpy(frame, header, 6);
    for (size_t i = 6; i < frame_bytes - 2u; i++) {
        frame[i] = (uint8_t)next_random(stream);
    }
    const uint16_t crc = crc16_update(0, frame + 1, frame_bytes - 3u);
    frame[frame_bytes - 2u] = (uint8_t)(crc >> 8);
    frame[frame_bytes - 1u] = (uint8_t)crc;
    stream->length += frame_bytes;
}

static int thousandths(stream_t *stream) { return (int)(next_random(stream) % 1000u); }

static void add_line(stream_t *stream) {
    char *const line = (char *)stream->bytes + stream->length;
    int length = sprintf(line, "$VNYMR");
    for (int i = 0; i < 3; i++) {
        length += sprintf(line + length, ",%+08.3f", thousandths(stream) / 5.6 - 89.0);
    }
    for (int i = 0; i < 3; i++) {
        length += sprintf(line + length, ",%+08.4f", thousandths(stream) / 1e3 - 0.5);
    }
    for (int i = 0; i < 3; i++) {
        length += sprintf(line + length, ",%+07.3f", thousandths(stream) / 50.0 - 10.0);
    }
    for (int i = 0; i < 3; i++) {
        length += sprintf(line + length, ",%+010.6f", thousandths(stream) / 1e3 - 0.5);
    }
    stream->length += imu_line_seal(line, (uint16_t)length, IMU_CHECK_XOR8);
}

/* Begins with a few lost bytes: no frame lies in one chunk. */
static void make_stream(stream_t *stream, const char *mode) {
    const bool mixed = strcmp(mode, "mixed") == 0, any = mixed || strcmp(mode, "any") == 0;
    const bool binary = any || strcmp(mode, "exact") == 0;
    stream->length = LOST_BYTES;
    for (unsigned round = 0; round < ROUNDS; round++) {
        if (binary) {
            add_frame(stream, OWN_HEADER, 64);
        }
        if (any) {
            add_frame(stream, TIME_IMU_HEADER, 52);
            add_frame(stream, TIME_ATTITUDE_HEADER, 40);
        }
        if (mixed || !binary) {
            add_line(stream);
        }
    }
}

static bool read_stream(stream_t *stream, const char *path) {
    FILE *const file = fopen(path, "rb");
    if (file == NULL) {
        perror(path);
        return false;
    }
    stream->length = fread(stream->bytes, 1, sizeof stream->bytes, file);
    fclose(file);
    return true;
}

int main(int count, char **arguments) {
    static stream_t stream;
    static imu_reader_t reader;
    if (count < 3) {
        fprintf(stderr, "usage: %s exact|any|ascii|mixed[+values] REPEATS [FILE]\n", arguments[0]);
        return 2;
    }
    char *const plus = strchr(arguments[1], '+');
    const bool values = plus != NULL;
    if (values) {
        *plus = '\0';
    }
    const bool exact = strcmp(arguments[1], "exact") == 0;
    const unsigned long repeats = strtoul(arguments[2], NULL, 10);
    if (count == 3) {
        make_stream(&stream, arguments[1]);
    } else if (!read_stream(&stream, arguments[3])) {
        return 1;
    }
    if (repeats == 0) {
        return fwrite(stream.bytes, 1, stream.length, stdout) == stream.length ? 0 : 1;
    }
    imu_reader_init(&reader, exact ? OWN_HEADER : NULL, exact ? sizeof OWN_HEADER : 0);
    volatile float sum = 0.0f;
    for (unsigned long i = 0; i < repeats; i++) {
        sum = push_all(&reader, stream.bytes, stream.length, values);
    }
    (void)sum;
    printf("bytes %zu binary %" PRIu32 " lines %" PRIu32 " crc %" PRIu32 " checksum %" PRIu32
           " rejects %" PRIu32 " skipped %" PRIu32 "\n",
           stream.length * repeats, reader.counters.binary, reader.counters.lines,
           reader.counters.crc_failed, reader.counters.checksum_failed,
           reader.counters.header_rejects, reader.counters.skipped_bytes);
    return 0;
}
