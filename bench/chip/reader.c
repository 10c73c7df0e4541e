/*
 * The IMU reader on the fish's processor. bench/reader_cost.py puts in front of it: |stream| and
 * EXACT, whether the reader believes in the fish's own header only, and VALUES, whether the values
 * are decoded, too. Marks the begin of a pass over
 * the stream, its end, and how many messages it gave.
 */
#include "imu/frame.h"
#include "imu/push_all.h"

void panic(const char *where);

_Noreturn void panic(const char *where) {
    (void)where;
    for (;;) {
    }
}

static imu_reader_t reader;
static volatile float sum;

void program(void) {
    imu_reader_init(&reader, EXACT ? imu_frame_header : NULL, EXACT ? IMU_FRAME_HEADER_BYTES : 0);
    sum = push_all(&reader, stream, sizeof stream, VALUES);
    const uint32_t before = reader.counters.binary + reader.counters.lines;
    MARK = 0;
    sum = push_all(&reader, stream, sizeof stream, VALUES);
    MARK = 1;
    MARK = reader.counters.binary + reader.counters.lines - before;
}
