/* The loop that is measured, here and on the fish's processor. */
#ifndef BENCH_IMU_PUSH_ALL_H
#define BENCH_IMU_PUSH_ALL_H

#include "imu/reader.h"

#define CHUNK_BYTES 64u

/* Pushes |length| bytes in chunks and takes every message. */
static inline void push_all(imu_reader_t *reader, const uint8_t *bytes, size_t length) {
    for (size_t begin = 0; begin < length; begin += CHUNK_BYTES) {
        const size_t left = length - begin;
        const size_t chunk = left < CHUNK_BYTES ? left : CHUNK_BYTES;
        size_t taken = 0;
        bool got = true;
        while (taken < chunk || got) {
            imu_message_t message;
            taken += imu_reader_push(reader, bytes + begin + taken, chunk - taken, &message, &got);
        }
    }
}

#endif
