/*
 * Which camera samples cannot be a fish's. They come in slots (speed.h); what is found out follows
 * from the slots alone, so that a host finds the same from a trial file.
 *
 *   stuck  The same bits for half a second: a tracker that has lost the fish repeats its last word.
 *          A fish that moved never stands quite still again, drag only slows it, and no two noisy
 *          samples are equal. So a run of equal slots is in doubt once the fish has been seen at
 *          another speed, and it says 0 or claims to be noisy; a run of zeros also where the IMU
 *          knows better. Not in doubt: without an IMU a fish that still rests where it started
 *          (a coarse camera sees just that), and a camera without noise.
 *   break  Means over a window cannot jump: from one to the next, dt later, they change by
 *          plausible_m_s dt/window at most, and by noise, 5 sigma. One of the two is wrong, and
 *          nobody knows which.
 *
 * A camera's mean that overlaps a stuck one has part of the lost time in it: the doubt reaches one
 * window beyond a run, half a window beyond a break (what lies between two of them is less than a
 * window apart, or a hole). Point samples (window 0) cannot break.
 *
 * Pure, float32, no libm. Not for interrupts.
 */
#ifndef SPEED_DOUBT_H
#define SPEED_DOUBT_H

#include "speed/speed.h"

typedef struct {
    bool any;   /* |last| is known */
    bool moved; /* the fish was seen at DOUBT_MOVING_M_S or more, and then at another speed */
    speed_slot_t last;
    float run_from_s; /* time of the first slot of the run that |last| is in */
    uint8_t run;      /* its slots, DOUBT_STUCK_SLOTS at most */
} doubt_t;

#define DOUBT_STUCK_SLOTS 5u
#define DOUBT_MOVING_M_S 0.01f

/* From time 0; all zero. */
void doubt_init(doubt_t *doubt);

/* The next slot with samples, in rising order. True when it brings the signal into doubt between
 * the two times (since the start of the trial; may be negative). */
bool doubt_slot(doubt_t *doubt, const speed_config_t *config, const speed_slot_t *slot,
                float *from_s, float *to_s);

#endif
