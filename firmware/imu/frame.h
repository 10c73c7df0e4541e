/*
 * The one binary frame the fish's VN-100 is set to: 64 bytes, groups 0x11, Common 0x0129
 * (TimeStartup, YawPitchRoll, AngularRate, Accel), Attitude 0x0040 (LinearAccelBody). Decoding,
 * plausibility, and what the sensor's own clock tells about lost frames and restarts.
 *
 * Pure, callable from interrupts.
 */
#ifndef IMU_FRAME_H
#define IMU_FRAME_H

#include <stdbool.h>
#include <stdint.h>

#define IMU_FRAME_BYTES 64u
#define IMU_FRAME_HEADER_BYTES 6u
extern const uint8_t imu_frame_header[IMU_FRAME_HEADER_BYTES];

/* A good CRC is not enough: values beyond what the sensor can measure drop the frame. Per axis;
 * half a per mille is left for rounding. Linear acceleration may exceed the range by the gravity
 * taken off. */
#define IMU_ACCEL_MAX_M_S2 157.0f
#define IMU_LINEAR_ACCEL_MAX_M_S2 167.0f
#define IMU_RATE_MAX_RAD_S 34.92f
#define IMU_PITCH_MAX_DEG 90.0f

typedef struct {
    uint64_t time_startup_ns; /* sensor clock since its start-up */
    float ypr_deg[3];         /* yaw, pitch, roll */
    float rate_rad_s[3];
    float accel_m_s2[3];        /* with gravity; body frame: x ahead, y right, z down */
    float linear_accel_m_s2[3]; /* body frame, gravity removed by the sensor */
} imu_frame_t;

/* |bytes|: IMU_FRAME_BYTES with a right header and CRC. False when a value is impossible. */
bool imu_frame_decode(const uint8_t *bytes, imu_frame_t *frame);

typedef enum {
    IMU_STEP_FIRST, /* nothing to compare with */
    IMU_STEP_NEXT,
    IMU_STEP_GAP,    /* frames are missing before this one */
    IMU_STEP_RESTART /* the clock fell or stands: the sensor has started anew */
} imu_step_t;

typedef struct {
    uint64_t last_ns;
    uint32_t nominal_ns; /* wanted time between frames; 0 = not judged */
    bool any;
    uint32_t lost; /* frames missing in gaps, monotonic */
    uint32_t restarts;
} imu_sequence_t;

void imu_sequence_init(imu_sequence_t *sequence, uint32_t nominal_ns);

/* Follows the frame's clock. *dt_s: time since the frame before; 0 after first and restart. A step
 * within half the nominal one is NEXT (the sensor's jitter is 30 us at most, facts of recordings).
 */
imu_step_t imu_sequence_next(imu_sequence_t *sequence, uint64_t time_ns, float *dt_s);

#endif
