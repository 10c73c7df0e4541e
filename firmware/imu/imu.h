/*
 * VN-100 reader: bytes in, frames out.
 *
 * Expects the one binary frame the driver configures (64 bytes: groups 0x11, Common 0x0129 =
 * TimeStartup, YawPitchRoll, AngularRate, Accel; Attitude 0x0040 = LinearAccelBody). Any chunking.
 * After a failed match or CRC it searches on from the byte after the failed sync, so one lost byte
 * costs one frame. Bounded memory (one frame), no heap. Not for interrupts.
 *
 * Layout, CRC and field order: VN-100 user manual UM001, binary output messages.
 */
#ifndef IMU_IMU_H
#define IMU_IMU_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define IMU_FRAME_BYTES 64u

/* A good CRC is not enough: values beyond what the sensor can measure drop the frame, as does a
 * time that does not rise. A time that falls is the sensor's restart: that one frame is dropped,
 * the clock is followed from there, and the next frame is good again. Per axis; half a per mille is
 * left for rounding. Linear acceleration may exceed the range by the gravity taken off. */
#define IMU_ACCEL_MAX_M_S2 157.0f
#define IMU_LINEAR_ACCEL_MAX_M_S2 167.0f
#define IMU_RATE_MAX_RAD_S 34.92f
#define IMU_PITCH_MAX_DEG 90.0f

typedef struct {
    uint64_t time_startup_ns; /* sensor clock since its start-up */
    float ypr_deg[3];         /* yaw, pitch, roll */
    float rate_rad_s[3];
    float accel_m_s2[3];        /* with gravity */
    float linear_accel_m_s2[3]; /* body frame, gravity removed by the sensor */
} imu_frame_t;

/* Monotonic counters. Every byte pushed is in exactly one of: a frame, an implausible frame (64
 * bytes each), skipped_bytes, or still held. */
typedef struct {
    uint32_t frames;
    uint32_t crc_failed;    /* candidates with the right header; their bytes are searched again */
    uint32_t implausible;   /* CRC right, values impossible or time not increasing */
    uint32_t skipped_bytes; /* bytes that belonged to no frame */
} imu_counters_t;

typedef struct {
    uint8_t window[IMU_FRAME_BYTES]; /* bytes of a candidate frame, from its sync byte on */
    uint8_t held;
    uint64_t last_time_ns; /* of the last frame with a good CRC */
    imu_counters_t counters;
} imu_t;

void imu_init(imu_t *imu);

/* Consumes bytes up to and including the end of the next good frame. Returns how many of |length|
 * were taken; *got says whether |frame| was filled. Call again with the rest until all are taken.
 */
size_t imu_push(imu_t *imu, const uint8_t *bytes, size_t length, imu_frame_t *frame, bool *got);

#endif
