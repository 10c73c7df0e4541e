/*
 * The binary output of a VN-100: which groups and fields a frame announces in its header, and where
 * each of them lies in it. VN-100 user manual UM001, "Binary Output Message Configuration".
 *
 * FA | groups | one little-endian field word per group, ascending | payload | CRC, high byte first.
 * Groups Common (bit 0), Time (1), IMU (2) and Attitude (4) exist; sizes are known for all fields
 * of the family, so that frames of its other sensors can be skipped. Anything else is no frame.
 *
 * Pure, callable from interrupts.
 */
#ifndef IMU_LAYOUT_H
#define IMU_LAYOUT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define IMU_SYNC 0xFAu
#define IMU_HEADER_MAX_BYTES 10u /* sync, groups, four field words */
#define IMU_BINARY_MAX_BYTES 600u

typedef enum {
    IMU_GROUP_COMMON = 0,
    IMU_GROUP_TIME = 1,
    IMU_GROUP_IMU = 2,
    IMU_GROUP_ATTITUDE = 4
} imu_group_t;

typedef enum {
    IMU_HEADER_IMPOSSIBLE, /* no frame begins like this */
    IMU_HEADER_CUT,        /* so far it may be one */
    IMU_HEADER_COMPLETE
} imu_header_t;

/* Judges the |held| >= 1 bytes from a sync byte on. When complete, *frame_bytes is the length of
 * the whole frame, sync and CRC included, at most IMU_BINARY_MAX_BYTES. */
imu_header_t imu_layout_header(const uint8_t *bytes, size_t held, uint16_t *frame_bytes);

/* Where field |bit| of |group| lies in a frame with a complete header: its offset from the sync
 * byte and its size. False when the frame does not have it. */
bool imu_layout_field(const uint8_t *frame, imu_group_t group, unsigned bit, uint16_t *offset,
                      uint16_t *bytes);

#endif
