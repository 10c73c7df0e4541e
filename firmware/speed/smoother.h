/*
 * Speed of each beat from all that is known about it: a Kalman filter over the beats and a smoother
 * back over them (Rauch, Tung and Striebel; Bierman's way of taking one noise out at a time, so
 * that no matrix is inverted).
 *
 * State of beat k: u, its mean speed; a, the error of the IMU's level acceleration in its middle
 * (tilt and bias); r, how fast that grows (gyroscope bias times gravity); s, the relative error of
 * the thrust model.
 *   u[k+1] = u[k] + rise[k+1] - a T - r T^2/2 + noise,  a[k+1] = a[k] + r T + noise,  r, s constant
 * The first step leads from the start of beat 0 to its middle and is half as long (T/2 for T).
 * Evidence: a speed, u = speed +- sigma, or that of the model, u = (1 + s) speed +- sigma. Without
 * a rise (no IMU) u may jump as far as a fish can in a beat.
 * Evidence that contradicts a rise by more than |gate| is left out: one of the two is wrong.
 *
 * The covariance is kept as U D U' (Bierman): it stays positive whatever float32 rounds away.
 * Memory: one state per SMOOTHER_BLOCK beats is kept, the others are computed again on the way
 * back. Pure, float32, no libm; the caller owns all arrays. Not for interrupts.
 * Cost on the board: see docs/how-to/test.md (make bench).
 */
#ifndef SPEED_SMOOTHER_H
#define SPEED_SMOOTHER_H

#include "base/units.h"

#include <stdbool.h>
#include <stdint.h>

#define SMOOTHER_BLOCK 16u
#define SMOOTHER_AFTER 40u /* steps behind the last beat: coasting, then rest */
#define SMOOTHER_STEPS (BEATS_MAX + SMOOTHER_AFTER)
#define SMOOTHER_STATES 4u

/* Sigmas and noises > 0; those of a, r and s may be 0. */
typedef struct {
    float beat_s;
    float start_sigma_m_s;   /* of the speed at time 0, expected to be 0 */
    float error_sigma_m_s2;  /* of a at the start */
    float drift_sigma_m_s3;  /* of r */
    float model_sigma;       /* of s; relative */
    float accel_noise_m_s15; /* white noise of acceleration, per root Hz: m/s^1.5 */
    float tilt_walk_m_s25;   /* random walk of a, per root s: m/s^2.5 */
    float jump_m_s;          /* change of u from beat to beat when there is no rise */
    float gate;              /* most (evidence - expected)^2 / variance; 0 = all is believed */
} smoother_config_t;

typedef struct {
    float x[SMOOTHER_STATES];
    float u[6]; /* above the diagonal, by rows; on it are ones */
    float d[SMOOTHER_STATES];
} smoother_state_t;

/* One beat's evidence; NaN = there is none. */
typedef struct {
    float rise_m_s;             /* IMU: its mean speed minus that of the beat before */
    float speed_m_s, sigma_m_s; /* sigma > 0; the model's: about its scaled self */
    bool scaled;                /* it is the model's */
} smoother_evidence_t;

/* A noise that was added to one of the states. Given all that is known later, it was gain (x after
 * it - filtered x after it) on average, with variance |left|. */
typedef struct {
    float gain[SMOOTHER_STATES];
    float left;
} smoother_noise_t;

/* What one step did, for the way back. */
typedef struct {
    float tau;  /* a grew by r for so long ... */
    float from; /* ... and this times a was taken off u */
    float rise;
    bool refused; /* its evidence was */
    smoother_noise_t walk, jolt;
    float x[SMOOTHER_STATES]; /* filtered, all of this done, before the evidence */
} smoother_step_t;

typedef struct {
    smoother_config_t config;
    uint16_t steps; /* taken so far */
    float surprise; /* largest (evidence - expected)^2 / variance since the begin or a rewind */
    uint16_t refused, believed; /* steps with evidence, since the begin or a rewind */
    smoother_state_t now;
    smoother_state_t kept[(SMOOTHER_STEPS + SMOOTHER_BLOCK - 1u) / SMOOTHER_BLOCK];
    /* on the way back: the smoothed state after the last step that is left, and its covariance */
    bool turned;
    uint16_t left; /* steps not yet smoothed */
    float x[SMOOTHER_STATES];
    float p[SMOOTHER_STATES * SMOOTHER_STATES];
    smoother_step_t step[SMOOTHER_BLOCK]; /* of the block under way: too much for the stack */
} smoother_t;

void smoother_init(smoother_t *smoother, const smoother_config_t *config);

/* One beat forward; its estimate by what was known up to it. At most SMOOTHER_STEPS. */
void smoother_forward(smoother_t *smoother, const smoother_evidence_t *evidence, float *speed_m_s,
                      float *sigma_m_s);

/* The evidence of step |step| again, exactly as it was given to smoother_forward(). */
typedef smoother_evidence_t (*smoother_recall_t)(const void *context, uint16_t step);
/* Takes the result of step |step|; the sigma is INFINITY where evidence was refused: then nobody
 * knows whether the evidence was wrong or the rise. */
typedef void (*smoother_result_t)(void *context, uint16_t step, float speed_m_s, float sigma_m_s);

/* Forgets step |step| and all later ones, and those before it in the same block: the next one to be
 * taken is smoother->steps. For evidence that turned out different; only before the way back. */
void smoother_rewind(smoother_t *smoother, uint16_t step);

/* Smooths the last block not yet smoothed; false when all are done. */
bool smoother_back(smoother_t *smoother, smoother_recall_t recall, smoother_result_t result,
                   void *context);

#endif
