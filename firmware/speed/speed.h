/*
 * Slots: what cameras and the IMU say of each 100 ms, and what follows from them about a beat.
 *
 * Camera samples are merged and the IMU's forward motion summed up in slots. Slots hold rounded
 * numbers, and a closed slot never changes: the slots are what the estimate (estimate.h) runs on
 * and what the trial file records, so that a host can recompute every beat from the file, bit for
 * bit.
 *
 * The camera's speed signal is piecewise linear between the slots. Across a hole (slots further
 * apart than gap_max_s) and beyond the first and last slot there is no line; there a slot's value
 * is held for at most gap_max_s/2.
 *
 * A sample may itself be a mean over a window (a camera fits a line over one beat): the mean over a
 * beat is then the exact mean of the signal over the interval that is left when half a window is
 * taken off both ends; for a window of one beat that is the value in the middle of the beat. A beat
 * is measured when the signal exists everywhere in that interval.
 *
 * The standard deviation is the signal's sigma (interpolated and averaged like the speed) divided
 * by sqrt(n), n = min(samples, beat_s / window_s): as many samples as do not overlap. A window of
 * one beat gives n = 1, point samples give n = samples.
 *
 * Pure, float32, no libm. Not for interrupts.
 */
#ifndef SPEED_SPEED_H
#define SPEED_SPEED_H

#include "base/units.h"
#include "speed/source.h"

#include <stdbool.h>
#include <stdint.h>

#define SPEED_SLOT_S 0.1f
#define SPEED_SLOTS 112u     /* closed ones kept: two of the longest beats (4 s) and 3 s to spare */
#define SPEED_OPEN_SLOTS 64u /* how far ahead of the closed ones a sample may lie */

/* Taken for a sample that comes without a usable sigma (NaN, infinite, <= 0): about what a line
 * through one beat of camera positions has. */
#define SPEED_SIGMA_DEFAULT_M_S 0.001f

/* One sample of speed along the swim direction. Times count from the start of the trial. */
typedef struct {
    float time_s; /* middle of the sample's window */
    float speed_m_s;
    float sigma_m_s; /* > 0; anything else = unknown */
} speed_sample_t;

/* What is known of [index*0.1 s, (index+1)*0.1 s). */
typedef struct {
    float speed_m_s; /* mean of the camera samples */
    uint16_t index;
    uint16_t sigma_10um_s; /* their mean sigma, at least 1: neighbouring windows overlap, so their
                            * noise does not average out */
    int16_t gain_10um_s;   /* IMU: forward speed gained; SPEED_NO_MOTION = not known */
    int16_t way_um;        /* IMU: way beyond that of the speed at the slot's begin */
    uint8_t samples;       /* of the camera; 0 = none, then speed and sigma are 0 */
    uint8_t at_ms;         /* their mean time, since the slot's begin, 0..99 */
} speed_slot_t;

#define SPEED_NO_MOTION (-32768) /* the least int16_t */

typedef struct {
    float window_s;      /* window of one sample, 0..beat_s; 0 = point samples */
    float gap_max_s;     /* a hole in the samples longer than this leaves the beat unmeasured */
    float plausible_m_s; /* |speed| beyond this is not believed */
} speed_config_t;

typedef struct {
    float speed_m_s;  /* NaN when not measured */
    float sigma_m_s;  /* NaN when not measured */
    uint16_t samples; /* in all slots that shaped the mean, those just outside the interval too */
    bool measured;
} speed_beat_t;

/* What became of the samples. */
typedef struct {
    uint32_t accepted;
    uint32_t implausible; /* not finite, beyond plausible_m_s, or more than a slot counts (255) */
    uint32_t late;        /* its slot was closed, or before the trial */
    uint32_t early;       /* beyond the open slots */
} speed_counters_t;

/* A slot in the making, unrounded. */
typedef struct {
    float at_s, speed_m_s, sigma_m_s; /* means; time since the slot's begin */
    uint8_t samples;
} speed_open_t;

typedef struct {
    speed_slot_t slots[SPEED_SLOTS];     /* ring of closed slots: slot i lives at i % SPEED_SLOTS */
    speed_open_t open[SPEED_OPEN_SLOTS]; /* ring of open ones, empty ones all zero */
    uint16_t next_close;                 /* first slot that is still open */
    speed_counters_t counters;
} speed_t;

void speed_init(speed_t *speed);

/* Merges one camera sample. Implausible, non-finite, too late (slot closed) and too early (beyond
 * the open slots) samples are counted and dropped; returns whether it was used. */
bool speed_add(speed_t *speed, const speed_config_t *config, speed_sample_t sample);

/* Number of the slot to be closed next, if all of it lies before |closed_until_s|. Ends at slot
 * 65000 (6500 s), beyond the longest trial. */
bool speed_slot_due(const speed_t *speed, float closed_until_s, uint16_t *index);

/* Closes that slot: it takes no more samples. |motion|: forward motion of the IMU in it, NULL = not
 * known; what does not fit the rounded numbers (0.328 m/s, 32.8 mm) counts as not known. Returns
 * it, possibly empty. Never beyond slot 65000. */
typedef struct {
    float gain_m_s, way_m;
} speed_motion_t;
speed_slot_t speed_close_slot(speed_t *speed, const speed_motion_t *motion);

/* Puts back a closed slot, as the host does with those of a trial file: in rising order; slots left
 * out are empty. False when its number does not rise. */
bool speed_restore_slot(speed_t *speed, const speed_slot_t *slot);

/* A closed slot that is still in the ring; NULL = there is none of that number. */
const speed_slot_t *speed_slot_at(const speed_t *speed, uint32_t index);

/* The camera's mean speed over the beat [begin_s, begin_s + beat_s), from the closed slots; slots
 * that end later than begin + beat + gap_max_s are not looked at: the result does not depend on how
 * many more there are. All slots up to there should be closed, and begin - gap_max_s no further
 * back than the ring reaches. Non-finite arguments give a beat that is not measured. */
speed_beat_t speed_beat(const speed_t *speed, const speed_config_t *config, float begin_s,
                        float beat_s);

/* By the IMU: mean speed over the beat [begin_s, begin_s + beat_s) minus that over the beat before
 * it; for begin_s = 0 minus the speed at time 0. Both are taken in whole frames of 20 ms; where a
 * beat ends within a slot, acceleration there is the straight line that fits the slot's gain and
 * way. NaN when a slot's motion is not known or no longer in the ring. */
float speed_rise(const speed_t *speed, float begin_s, float beat_s);

#endif
