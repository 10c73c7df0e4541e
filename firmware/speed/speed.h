/*
 * From speed samples to one mean speed per beat, with its standard deviation.
 *
 * Samples (a camera's, later also the IMU's) are merged into slots of 100 ms; the slots are what
 * the estimator runs on and what the trial file records, so that a host can recompute every beat
 * from the file, bit for bit.
 *
 * The speed signal is piecewise linear between the slots. Across a hole (slots further apart than
 * gap_max_s) and beyond the first and last slot there is no line; there a slot's value is held for
 * at most gap_max_s/2.
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

#include <stdbool.h>
#include <stdint.h>

#define SPEED_SLOT_S 0.1f
#define SPEED_SLOTS 128u     /* half for open slots, so at least 6.4 s of closed ones are kept */
#define SPEED_OPEN_SLOTS 64u /* how far ahead of the closed ones a sample may lie */

/* Taken for a sample that comes without a usable sigma (NaN, infinite, <= 0): about what a line
 * through one beat of camera positions has. */
#define SPEED_SIGMA_DEFAULT_M_S 0.001f

typedef enum {
    SPEED_SOURCE_VISION = 0,
    SPEED_SOURCE_UPLOAD = 1,
    SPEED_SOURCE_COUNT
} speed_source_t;

/* One sample of speed along the swim direction. Times count from the start of the trial. */
typedef struct {
    float time_s; /* middle of the sample's window */
    float speed_m_s;
    float sigma_m_s; /* > 0; anything else = unknown */
} speed_sample_t;

/* Merged samples of [index*0.1 s, (index+1)*0.1 s). */
typedef struct {
    uint16_t index;
    uint16_t samples; /* 0 = empty */
    float time_s;     /* mean time of the samples */
    float speed_m_s;  /* mean */
    float sigma_m_s;  /* mean sigma: neighbouring windows overlap, so their noise does not average
                         out */
} speed_slot_t;

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
    uint32_t implausible; /* not finite or beyond plausible_m_s, or more than a slot can count */
    uint32_t late;        /* its slot was closed, or before the trial */
    uint32_t early;       /* beyond the open slots */
} speed_counters_t;

typedef struct {
    speed_slot_t slots[SPEED_SLOTS]; /* ring: slot i lives at i % SPEED_SLOTS */
    uint16_t next_close;             /* first slot that is still open */
    speed_counters_t counters;
} speed_t;

void speed_init(speed_t *speed);

/* Merges one sample. Implausible, non-finite, too late (slot closed) and too early (beyond the open
 * slots) samples are counted and dropped; returns whether it was used. */
bool speed_add(speed_t *speed, const speed_config_t *config, speed_sample_t sample);

/* Closes the next slot if all of it lies before |closed_until_s|. A closed slot takes no more
 * samples. Returns true and the slot (possibly empty) when one was closed; call until false. Ends
 * at slot 65000 (6500 s), beyond the longest trial. */
bool speed_close_slot(speed_t *speed, float closed_until_s, speed_slot_t *closed);

/* Mean over the beat [begin_s, begin_s + beat_s) from slots in rising order of time; empty slots
 * and slots that do not rise in time are skipped. Slots that end later than begin + beat +
 * gap_max_s are not looked at: the result does not depend on how many more there are. This is the
 * one estimator: board, host and recompute call it. Non-finite arguments give a beat that is not
 * measured. */
speed_beat_t speed_beat_mean(const speed_slot_t *slots, uint16_t count,
                             const speed_config_t *config, float begin_s, float beat_s);

/* The same over the closed slots in the ring of |speed|. All slots up to begin + beat + gap_max_s
 * should be closed, and begin - gap_max_s no further back than the ring reaches. */
speed_beat_t speed_beat(const speed_t *speed, const speed_config_t *config, float begin_s,
                        float beat_s);

#endif
