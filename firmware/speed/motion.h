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
 * In fixed point: the fish's processor has no floating point, and rounds less often this way
 * (bench/estimate_cost.py, test_motion_error.c). Pure. Not for interrupts.
 */
#ifndef SPEED_MOTION_H
#define SPEED_MOTION_H

#include "speed/attitude.h"
#include "speed/rest.h"
#include "speed/speed.h"

#define MOTION_SLOTS 88u /* two of the longest beats (4 s) and 0.8 s to spare */

/* Fixed point as base/fixed.h has it. */
typedef struct {
    uint16_t index;       /* from the start of the swim */
    int16_t turn_100urad; /* of the heading, clockwise from above; SPEED_NO_MOTION = too much */
    int32_t covered;      /* of the slot, by frames; s, Q33 */
    int32_t gain[2];      /* velocity gained, along the level axes; m/s, Q29 */
    int32_t way[2];       /* way beyond that of the velocity at the slot's begin; m, Q32 */
    int32_t nose[2];      /* integral of the level part of the unit vector along the nose; s, Q33 */
} motion_slot_t;

/* Of the slot being filled, unrounded. */
typedef struct {
    int64_t gain[2], way[2]; /* m/s, Q55; m, Q62 */
    int64_t turn;            /* rad, Q53 */
} motion_sums_t;

typedef struct {
    bool begun;
    bool follows; /* |last| and |period| are known */
    bool lost;    /* for the rest of the swim */
    attitude_t attitude;
    int64_t rate_bias[3];  /* rad/s, Q46 */
    int32_t first_nose[2]; /* what a slot before the start has as its nose */
    int32_t last[6]; /* of the frame before: rate less bias, specific force; rad/s, Q24, m/s^2, Q22
                      */
    int32_t felt_left[6], force_left[3], accel_left[2]; /* of what was rounded so far */
    int32_t period;                                     /* of the frames; s, Q33 */
    int64_t coned[3]; /* pitch that would come of a scale error of 1, each gyroscope's; rad, Q30 */
    int64_t until;    /* motion is summed up to here, from the start; s, Q33 */
    uint16_t index;   /* of the slot of that time, at most */
    motion_sums_t filling;
    motion_slot_t slots[MOTION_SLOTS]; /* ring */
} motion_t;

/* Starts at time 0. |rest|: as measured before; NULL = the fish was not still: then |last| gives
 * the first attitude (its accelerometers), and the biases are taken as 0. */
void motion_begin(motion_t *motion, const rest_mean_t *rest, const imu_frame_t *last);

/* One frame, the means over the frame period that ends at |time_s| after the start (may be before
 * it); |dt_s| since the frame before. Frames are recognised as missing when dt_s is more than 1.5
 * frame periods. Up to MOTION_GAP_MAX_S of them are replaced by the mean of their neighbours. After
 * a longer gap, or a restart of the sensor (dt_s = 0), nobody knows how the body turned meanwhile,
 * and a degree would be 0.17 m/s^2: the motion is lost, and what follows is not looked at. The same
 * after a turn of more than 0.75 rad within a frame or a gap, which is beyond the sensor's range at
 * 50 Hz. */
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
