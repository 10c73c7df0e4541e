/* TAILBEAT_IMU: raw frames of the IMU, for the one port whose host asked for them. */
#ifndef LINK_IMU_STREAM_H
#define LINK_IMU_STREAM_H

#include "imu/imu.h"
#include "link/outbox.h"

#define IMU_STREAM_FRAMES 4u /* in one message */

/* Begins as zeros, but for the pointer. */
typedef struct {
    outbox_t *outbox;
    uint32_t interval_us; /* 0 = nobody asked */
    uint64_t next_us;
    uint32_t frames; /* since boot */
    uint32_t first;  /* number of the first one held */
    uint8_t port;
    uint8_t held;
    uint32_t time_us[IMU_STREAM_FRAMES];
    imu_frame_t frame[IMU_STREAM_FRAMES];
} imu_stream_t;

/* MAV_CMD_SET_MESSAGE_INTERVAL: -1 = off, 0 = all frames; false = out of range. It lasts until no
 * host is heard on |port| any more. */
bool imu_stream_set_interval(imu_stream_t *stream, hal_port_t port, float interval_us);

/* A frame of the IMU. */
void imu_stream_add(imu_stream_t *stream, const imu_sample_t *sample);

#endif
