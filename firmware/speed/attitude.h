/*
 * How the IMU lies in the level frame, followed by its gyroscopes, in fixed point.
 *
 * A quaternion of 62 bits takes all of each small turn, so that nothing is lost from frame to frame
 * but what its factors are rounded by, 1e-9 of a turn; rounding a turn itself leaves a rest that
 * the next one gets. Pure, bits as base/fixed.h. Not for interrupts.
 */
#ifndef SPEED_ATTITUDE_H
#define SPEED_ATTITUDE_H

#include <stdint.h>

#define ATTITUDE_BITS 30 /* of rows and of a turn in rad */
#define ATTITUDE_ONE (1 << ATTITUDE_BITS)
#define ATTITUDE_TURN_BITS 57

typedef struct {
    int64_t q[4];    /* body to level frame, scalar first, Q61 */
    int32_t left[3]; /* of the turns so far, Q57 */
} attitude_t;

/* Of a body at rest that feels the specific force |accel_m_s2|: down is against it, by the shortest
 * turn. What is no force, 0 or beyond 1e6, stands on its head. */
void attitude_stand(attitude_t *attitude, const float accel_m_s2[3]);

/* The matrix that turns a body vector into the level frame, Q30. */
void attitude_rows(const attitude_t *attitude, int32_t rows[3][3]);

/* Turns the body by a rotation vector in its axes: rad, Q57, at most 1.2 rad along each. */
void attitude_turn(attitude_t *attitude, const int64_t angle[3]);

#endif
