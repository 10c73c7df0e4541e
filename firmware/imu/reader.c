#include "imu/reader.h"

#include "base/crc.h"
#include "base/panic.h"
#include "imu/line.h"

#include <string.h>

/* How much is taken in at a time as long as it is not known how much is missing. */
#define LOOK_AHEAD_BYTES 64u

_Static_assert(IMU_LINE_MAX_BYTES + LOOK_AHEAD_BYTES <= IMU_BINARY_MAX_BYTES,
               "the window holds it");

/* A CRC that the sync byte turns into 0: the sum then runs over whole words of a frame. */
#define CRC_BEFORE_SYNC ((uint16_t)(IMU_SYNC << 8))

#define LINE_BEGIN "$VN"
#define LINE_BEGIN_BYTES 3u

typedef enum { NO_MESSAGE, HALF_MESSAGE, WHOLE_MESSAGE } verdict_t;

static size_t smaller(size_t a, size_t b) { return a < b ? a : b; }

static imu_header_t judge_header(const imu_reader_t *reader, const uint8_t *bytes, size_t held,
                                 uint16_t *frame_bytes) {
    if (reader->header_bytes == 0) {
        return imu_layout_header(bytes, held, frame_bytes);
    }
    if (memcmp(bytes, reader->header, smaller(held, reader->header_bytes)) != 0) {
        return IMU_HEADER_IMPOSSIBLE;
    }
    *frame_bytes = reader->frame_bytes;
    return held < reader->header_bytes ? IMU_HEADER_CUT : IMU_HEADER_COMPLETE;
}

/* |known|: the frame's length as judged before, or 0. */
static verdict_t judge_frame(imu_reader_t *reader, const uint8_t *bytes, size_t held,
                             uint16_t known) {
    uint16_t frame_bytes = known;
    const imu_header_t header =
        known != 0 ? IMU_HEADER_COMPLETE : judge_header(reader, bytes, held, &frame_bytes);
    if (header == IMU_HEADER_IMPOSSIBLE) {
        reader->counters.header_rejects++;
        return NO_MESSAGE;
    }
    if (header == IMU_HEADER_CUT) {
        return HALF_MESSAGE;
    }
    if (held < frame_bytes) {
        reader->wanted = frame_bytes;
        return HALF_MESSAGE;
    }
    if (crc16_update(CRC_BEFORE_SYNC, bytes, frame_bytes) != 0) {
        reader->counters.crc_failed++;
        return NO_MESSAGE;
    }
    reader->counters.binary++;
    reader->taken = frame_bytes;
    return WHOLE_MESSAGE;
}

static verdict_t judge_check(imu_reader_t *reader, const uint8_t *line, size_t length) {
    const imu_line_t verdict = imu_line_verify(line, length);
    reader->counters.checksum_failed += verdict == IMU_LINE_DAMAGED;
    if (verdict != IMU_LINE_GOOD) {
        return NO_MESSAGE;
    }
    reader->counters.lines++;
    reader->taken = (uint16_t)length;
    return WHOLE_MESSAGE;
}

/* |known|: how many bytes were found to be the line's before, or 0. */
static verdict_t judge_line(imu_reader_t *reader, const uint8_t *bytes, size_t held, size_t known) {
    if (known == 0) {
        known = smaller(held, LINE_BEGIN_BYTES);
        if (memcmp(bytes, LINE_BEGIN, known) != 0) {
            return NO_MESSAGE;
        }
        if (known < LINE_BEGIN_BYTES) {
            return HALF_MESSAGE;
        }
    }
    const size_t most = smaller(held, IMU_LINE_MAX_BYTES);
    const size_t plain = known + imu_line_plain(bytes + known, most - known);
    const size_t end = plain + (plain < most && bytes[plain] == '\r' ? 1u : 0u);
    if (end < most) {
        return bytes[end] == '\n' ? judge_check(reader, bytes, end + 1u) : NO_MESSAGE;
    }
    if (most == IMU_LINE_MAX_BYTES) {
        return NO_MESSAGE;
    }
    reader->plain = (uint16_t)plain;
    return HALF_MESSAGE;
}

static void drop(imu_reader_t *reader, size_t bytes) {
    reader->held = (uint16_t)(reader->held - bytes);
    if (bytes != 0 && reader->held != 0) {
        memmove(reader->window, reader->window + bytes, reader->held);
    }
}

static size_t next_begin(const uint8_t *bytes, size_t at, size_t length) {
    while (at < length && bytes[at] != IMU_SYNC && bytes[at] != '$') {
        at++;
    }
    return at;
}

/* Drops what begins no message. True: a whole one stands at the window's begin. |final|: no half
 * one will become whole. */
static bool search(imu_reader_t *reader, bool final) {
    const size_t held = reader->held;
    uint16_t frame_bytes = reader->wanted, plain = reader->plain;
    verdict_t verdict = NO_MESSAGE;
    size_t begin = next_begin(reader->window, 0, held);
    reader->wanted = 0;
    reader->plain = 0;
    while (begin < held) {
        const uint8_t *const bytes = reader->window + begin;
        verdict = *bytes == IMU_SYNC ? judge_frame(reader, bytes, held - begin, frame_bytes)
                                     : judge_line(reader, bytes, held - begin, plain);
        if (verdict == WHOLE_MESSAGE || (verdict == HALF_MESSAGE && !final)) {
            break;
        }
        reader->counters.dropped += verdict == HALF_MESSAGE;
        verdict = NO_MESSAGE;
        frame_bytes = 0;
        plain = 0;
        begin = next_begin(reader->window, begin + 1u, held);
    }
    if (final) {
        reader->wanted = 0;
        reader->plain = 0;
    }
    reader->counters.skipped_bytes += (uint32_t)begin;
    drop(reader, begin);
    return verdict == WHOLE_MESSAGE;
}

/* The message that was handed out goes. Whether the rest holds another one. */
static bool search_rest(imu_reader_t *reader, bool final) {
    drop(reader, reader->taken);
    reader->taken = 0;
    return reader->held != 0 && search(reader, final);
}

static imu_message_t message_of(const imu_reader_t *reader) {
    const imu_message_t message = {reader->window[0] == IMU_SYNC ? IMU_BINARY : IMU_LINE,
                                   reader->taken, reader->window};
    return message;
}

/* Takes in what may be missing and no more than the window has room for: only the begin of a header
 * or a line waits for nothing in particular. */
static size_t take_in(imu_reader_t *reader, const uint8_t *bytes, size_t length) {
    const size_t most =
        reader->wanted != 0 ? (size_t)(reader->wanted - reader->held) : (size_t)LOOK_AHEAD_BYTES;
    const size_t taken = smaller(length, most);
    memcpy(reader->window + reader->held, bytes, taken);
    reader->held = (uint16_t)(reader->held + taken);
    return taken;
}

/* Gives back what of the last |taken| bytes lies beyond the message. Returns how many are left. */
static size_t give_back(imu_reader_t *reader, size_t taken) {
    const size_t beyond = smaller((size_t)(reader->held - reader->taken), taken);
    reader->held = (uint16_t)(reader->held - beyond);
    return taken - beyond;
}

void imu_reader_init(imu_reader_t *reader, const uint8_t *header, uint8_t header_bytes) {
    memset(reader, 0, sizeof *reader);
    if (header_bytes != 0) {
        REQUIRE(header_bytes <= IMU_HEADER_MAX_BYTES);
        REQUIRE(imu_layout_header(header, header_bytes, &reader->frame_bytes) ==
                IMU_HEADER_COMPLETE);
        memcpy(reader->header, header, header_bytes);
        reader->header_bytes = header_bytes;
    }
}

size_t imu_reader_push(imu_reader_t *reader, const uint8_t *bytes, size_t length,
                       imu_message_t *message, bool *got) {
    size_t taken = 0;
    *got = reader->taken != 0 && search_rest(reader, false);
    while (!*got && taken < length) {
        taken += take_in(reader, bytes + taken, length - taken);
        *got = reader->held >= reader->wanted && search(reader, false);
    }
    if (*got) {
        taken = give_back(reader, taken);
        *message = message_of(reader);
    }
    return taken;
}

bool imu_reader_silence(imu_reader_t *reader, imu_message_t *message) {
    const bool got = search_rest(reader, true);
    if (got) {
        *message = message_of(reader);
    }
    return got;
}
