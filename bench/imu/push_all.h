/* The loop that is measured, here and on the fish's processor. */
#ifndef BENCH_IMU_PUSH_ALL_H
#define BENCH_IMU_PUSH_ALL_H

#include "imu/frame.h"
#include "imu/line.h"
#include "imu/reader.h"

#define CHUNK_BYTES 64u
#define VALUES_MAX 32u

/* Decodes what the firmware can decode: the fish's own frame, and each number of a line. The sum
 * keeps the compiler from leaving it out. */
static inline float sum_of_values(const imu_message_t *message) {
    float sum = 0.0f, values[VALUES_MAX];
    imu_frame_t frame;
    if (message->kind == IMU_LINE) {
        const unsigned count = imu_line_floats(message, values, VALUES_MAX);
        for (unsigned i = 0; i < count; i++) {
            sum += values[i];
        }
    } else if (message->length == IMU_FRAME_BYTES && imu_frame_decode(message->bytes, &frame)) {
        sum = frame.ypr_deg[0] + frame.accel_m_s2[0] + frame.rate_rad_s[0];
    }
    return sum;
}

/* Pushes |length| bytes in chunks and takes every message; decodes its |values|, too, if asked. */
static inline float push_all(imu_reader_t *reader, const uint8_t *bytes, size_t length,
                             bool values) {
    float sum = 0.0f;
    for (size_t begin = 0; begin < length; begin += CHUNK_BYTES) {
        const size_t left = length - begin;
        const size_t chunk = left < CHUNK_BYTES ? left : CHUNK_BYTES;
        size_t taken = 0;
        bool got = true;
        while (taken < chunk || got) {
            imu_message_t message;
            taken += imu_reader_push(reader, bytes + begin + taken, chunk - taken, &message, &got);
            sum += values && got ? sum_of_values(&message) : 0.0f;
        }
    }
    return sum;
}

#endif
