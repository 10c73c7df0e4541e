/*
 * Motion by IMU alone: acceleration turned into the level frame by our own attitude, and summed up
 * in the slots of 0.1 s that the speed estimate runs on.
 *
 * Attitude starts from a rest (down by the accelerometers, gyroscope bias by their mean) and
 * follows the gyroscopes. What is wrong with it (tilt, biases) makes an acceleration error that
 * changes slowly, which the estimate finds. The sensor's own attitude is not used: its filter takes
 * steady acceleration for tilt.
 *
 * "Forward" is the heading averaged over one beat, twice: what swings with the beat leaves no trace
 * in it, even while the swing grows or fades. The fish swings its head by some +-10 degrees.
 * Integrating along its nose would give metres per second of nonsense; so would a direction that
 * swings by one degree in step with the sway: decimetres per second.
 *
 * Pure, float32, no libm. Not for interrupts.
 */
#ifndef SPEED_MOTION_H
#define SPEED_MOTION_H

#include "speed/rest.h"
#include "speed/speed.h"

#define MOTION_SLOTS 88u /* two of the longest beats (4 s) and 0.8 s to spare */

typedef struct {
    uint16_t index;       /* from the start of the swim */
    int16_t turn_100urad; /* of the heading, clockwise from above; SPEED_NO_MOTION = too much */
    float covered_s;      /* of the slot, by frames */
    float gain_m_s[2];    /* velocity gained, along the level axes */
    float way_m[2];       /* way beyond that of the velocity at the slot's begin */
    float nose_s[2];      /* integral of the level part of the unit vector along the nose */
} motion_slot_t;

typedef struct {
    bool begun;
    bool follows; /* |last| and |period_s| are known */
    bool lost;    /* for the rest of the swim */
    float q[4];   /* body to level frame, scalar first */
    float rate_bias_rad_s[3];
    float first_nose[3]; /* unit vector along the nose at the start, level frame */
    float last[6];       /* of the frame before: angular rate less bias, specific force */
    float period_s;      /* of the frames */
    float coned_rad[3];  /* pitch that would come of a scale error of 1, each gyroscope's */
    float until_s;       /* motion is summed up to here, from the start */
    uint16_t index;      /* of the slot of that time, at most */
    float turn_rad;      /* of the last slot, unrounded */
    motion_slot_t slots[MOTION_SLOTS]; /* ring */
} motion_t;

/* Starts at time 0. |rest|: as measured before; NULL = the fish was not still: then |last| gives
 * the first attitude (its accelerometers), and the biases are taken as 0. */
void motion_begin(motion_t *motion, const rest_mean_t *rest, const imu_frame_t *last);

/* One frame, the means over the frame period that ends at |time_s| after the start (may be before
 * it); |dt_s| since the frame before. Frames are recognised as missing when dt_s is more than 1.5
 * frame periods. Up to MOTION_GAP_MAX_S of them are replaced by the mean of their neighbours. After
 * a longer gap, or a restart of the sensor (dt_s = 0), nobody knows how the body turned meanwhile,
 * and a degree would be 0.17 m/s^2: the motion is lost, and what follows is not looked at. */
#define MOTION_GAP_MAX_S 0.05f
void motion_push(motion_t *motion, const imu_frame_t *frame, float time_s, float dt_s);

/* Forward motion in slot |index|. False when frames do not cover it whole or it is no longer (or
 * not yet) in the ring. Heading is averaged over the slots from a beat before to a beat after it,
 * as many as there are; before the start it is the first one. Call it once a beat and a slot of
 * later slots are in: earlier, the swing does not average out. */
bool motion_forward(const motion_t *motion, uint16_t index, float beat_s, float *gain_m_s,
                    float *way_m);

/* How far off the tilt may be at the end of the swim because no gyroscope's scale is exact (each
 * axis's has a relative standard deviation of |scale_sigma|): a fish that rolls out of step with
 * its yaw turns that into tilt, beat by beat. */
float motion_tilt_sigma(const motion_t *motion, float scale_sigma);

/* How far the nose's heading turned in slot |index|, in 1e-4 rad, clockwise from above.
 * SPEED_NO_MOTION where frames do not cover it whole, where it is not in the ring, and beyond 3.27
 * rad. */
int16_t motion_turn(const motion_t *motion, uint16_t index);

#endif
