/*
 * Whether the fish is still, by its IMU, and what the IMU says then: where down is and how far its
 * gyroscopes are off. A fish that coasts evenly feels the same as one that rests; who asks for rest
 * must see to it that it is held. So does one that turns about the vertical by less than a degree
 * per second: the gyroscopes may be off by as much.
 *
 * Frames are averaged in blocks of REST_BLOCK_S; the fish is still as long as each block is quiet
 * within itself, down stays where it was, and it has not turned by more than a trembling hand does.
 * Pure, float32, no libm. Not for interrupts.
 */
#ifndef SPEED_REST_H
#define SPEED_REST_H

#include "imu/frame.h"

#define REST_BLOCK_S 0.5f
#define REST_BLOCKS 20u /* the mean is over the last 10 s of stillness at most */

/* Over the last still blocks: the acceleration of the body as it stands now, after the newest
 * frame, and what the gyroscopes say when it does not turn. A hand that trembles is neither tilt
 * nor drift: the gyroscopes follow it. */
typedef struct {
    float still_s; /* how long it has been still without a break; may exceed the averaged time */
    float mean_s;  /* averaged time */
    float accel_m_s2[3];
    float rate_rad_s[3];
    float
        tilt_sigma_rad; /* of the nose's pitch, by how well the gyroscope's angle kept to a line */
} rest_mean_t;

/* Acceleration and angular rate, side by side. */
#define REST_CHANNELS 6u

typedef struct {
    float time_s; /* of the block being filled */
    uint16_t frames;
    float first[REST_CHANNELS]; /* frame of the block; sums count from it */
    float sum[REST_CHANNELS];
    float squares[2];                         /* of the whole acceleration, of the whole rate */
    float angle_rad[3];                       /* turned since the block's begin */
    float angle_sum_rad[3];                   /* ... summed over the frames' middles */
    float angles_rad[REST_BLOCKS][3];         /* ring of its means */
    float blocks[REST_BLOCKS][REST_CHANNELS]; /* ring of the means of still blocks */
    uint16_t next, filled;
    float still_s;
} rest_t;

void rest_init(rest_t *rest);

/* |dt_s|: since the frame before, by the sensor's clock; 0 or more than 0.1 s breaks the rest. */
void rest_push(rest_t *rest, const imu_frame_t *frame, float dt_s);

/* false: moving, or still for less than one block. */
bool rest_get(const rest_t *rest, rest_mean_t *mean);

#endif
