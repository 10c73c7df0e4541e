/*
 * From speed samples to one mean speed per beat, with its standard deviation.
 *
 * Samples (a camera's, later also the IMU's) are merged into slots of 100 ms; the slots are what the
 * estimator runs on and what the trial file records, so that a host can recompute every beat from
 * the file, bit for bit. A sample may itself be a mean over a window (a camera fits a line over one
 * beat): the mean over a beat is then the mean of the piecewise-linear slot signal over the interval
 * that is left when half a window is taken off both ends; for a window of one beat that is the value
 * in the middle of the beat.
 *
 * Pure, float32, no libm. Not for interrupts.
 */
#ifndef SPEED_SPEED_H
#define SPEED_SPEED_H

#include "base/units.h"

#include <stdbool.h>
#include <stdint.h>

#define SPEED_SLOT_S 0.1f
#define SPEED_SLOTS 64u /* 6.4 s of history */

typedef enum { SPEED_SOURCE_VISION = 0, SPEED_SOURCE_UPLOAD = 1, SPEED_SOURCE_COUNT } speed_source_t;

/* One sample of speed along the swim direction. Times count from the start of the trial. */
typedef struct {
    float time_s; /* middle of the sample's window */
    float speed_m_s;
    float sigma_m_s; /* > 0 */
} speed_sample_t;

/* Merged samples of [index*0.1 s, (index+1)*0.1 s). */
typedef struct {
    uint16_t index;
    uint16_t samples;  /* 0 = empty */
    float time_s;      /* mean time of the samples */
    float speed_m_s;   /* mean */
    float sigma_m_s;   /* mean sigma: neighbouring windows overlap, so their noise does not average out */
} speed_slot_t;

typedef struct {
    float window_s;    /* window of one sample, 0..beat_s; 0 = point samples */
    float gap_max_s;   /* a hole in the samples longer than this leaves the beat unmeasured */
    float plausible_m_s; /* |speed| beyond this is not believed */
} speed_config_t;

typedef struct {
    float speed_m_s; /* NaN when not measured */
    float sigma_m_s;
    uint16_t samples;
    bool measured;
} speed_beat_t;

/* Counters of what was not used. */
typedef struct {
    uint32_t accepted, implausible, late, early;
} speed_counters_t;

typedef struct {
    speed_slot_t slots[SPEED_SLOTS]; /* ring: slot i lives at i % SPEED_SLOTS */
    uint16_t next_close;             /* first slot that is still open */
    speed_counters_t counters;
} speed_t;

void speed_init(speed_t *speed);

/* Merges one sample. Implausible, non-finite, too late (slot closed) and too early (beyond the ring)
 * samples are counted and dropped; returns whether it was used. */
bool speed_add(speed_t *speed, const speed_config_t *config, speed_sample_t sample);

/* Closes the next slot if all of it lies before |closed_until_s|. A closed slot takes no more
 * samples. Returns true and the slot (possibly empty) when one was closed; call until false. */
bool speed_close_slot(speed_t *speed, float closed_until_s, speed_slot_t *closed);

/* Mean over the beat [begin_s, begin_s + beat_s) from slots in rising order of time; empty slots are
 * skipped. This is the one estimator: board, host and recompute call it. */
speed_beat_t speed_beat_mean(const speed_slot_t *slots, uint16_t count, const speed_config_t *config,
                             float begin_s, float beat_s);

/* The same over the ring of |speed|. All slots up to begin + beat + gap_max should be closed. */
speed_beat_t speed_beat(const speed_t *speed, const speed_config_t *config, float begin_s,
                        float beat_s);

#endif
