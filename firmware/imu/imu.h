/*
 * The IMU as the fish uses it: bytes of the serial line in, frames with their time out, and the
 * sensor kept set up. Reader, frame decoding, sequence and driver in one; main loop only.
 */
#ifndef IMU_IMU_H
#define IMU_IMU_H

#include "imu/driver.h"
#include "imu/frame.h"
#include "imu/reader.h"

/* Monotonic since imu_init(). */
typedef struct {
    uint32_t frames;      /* good ones */
    uint32_t implausible; /* CRC right, values impossible */
} imu_counters_t;

/* Health word: 0 = all is well. Bits 0..7 tell of the last whole span of IMU_HEALTH_SPAN_US. */
#define IMU_HEALTH_DAMAGED 0x01u   /* frames or lines with a wrong check */
#define IMU_HEALTH_REJECTS 0x02u   /* bytes that belong to no message */
#define IMU_HEALTH_LOST 0x04u      /* frames missing */
#define IMU_HEALTH_OVERRUN 0x08u   /* bytes lost in our own port */
#define IMU_HEALTH_RESTARTED 0x10u /* the sensor restarted */
#define IMU_HEALTH_IMPLAUSIBLE 0x20u
#define IMU_HEALTH_SILENT 0x100u     /* no frame now */
#define IMU_HEALTH_NOT_SET_UP 0x200u /* the driver is not done */
#define IMU_HEALTH_SPAN_US 5000000u

/* A frame and when it was made, by the board's clock: the sensor's clock, whose offset follows the
 * quickest arrivals, so that what waits in our ring does not shift it. What a frame always takes on
 * the line (5.6 ms at 115200 baud) is in it. */
typedef struct {
    imu_frame_t frame;
    uint64_t time_us;
    float dt_s; /* since the frame before, by the sensor's clock; 0 = first or restarted */
    imu_step_t step;
} imu_sample_t;

typedef struct {
    imu_reader_t reader;
    imu_sequence_t sequence;
    imu_driver_t driver;
    imu_counters_t counters;
    imu_frame_t last;      /* zero when none */
    uint64_t last_us;      /* board time at which it came in; 0 = none yet */
    uint64_t last_byte_us; /* 0 = none yet */
    int64_t offset_us;     /* board clock minus sensor clock */
    uint64_t offset_at_us; /* up to when it has been let rise */
    uint16_t health;
    uint64_t health_at_us; /* when the span began */
    uint32_t health_base[6];
} imu_t;

/* |config| must be valid. */
void imu_init(imu_t *imu, const imu_driver_config_t *config, uint64_t now_us);

/* Consumes received bytes up to and including the end of the next good frame of our layout. Returns
 * how many of |length| were taken; *got says whether |sample| was filled. Call again with the rest
 * until all are taken and nothing more is got. */
size_t imu_push(imu_t *imu, const uint8_t *bytes, size_t length, uint64_t now_us,
                imu_sample_t *sample, bool *got);

/* What the line needs now; call it until it answers IMU_DO_NOTHING, once all bytes that have
 * arrived are pushed: what came since then is silence. |overruns|: bytes lost in our own port since
 * boot. */
imu_action_t imu_poll(imu_t *imu, uint32_t overruns, uint64_t now_us);

/* Another configuration: the sensor is set up anew. */
void imu_configure(imu_t *imu, const imu_driver_config_t *config, uint64_t now_us);

#endif
