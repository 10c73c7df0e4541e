/*
 * The tail beat, as the water sees it: cut into frames of the servo and substeps, with what the
 * tail does to the water in each.
 */
#ifndef SIM_TAIL_BEAT_H
#define SIM_TAIL_BEAT_H

#include <stdint.h>

#define FRAME_SECONDS 0.02
#define SUBSTEPS 4u /* per frame */
#define FRAMES_PER_BEAT_MIN 4u
#define FRAMES_PER_BEAT_MAX 1000u

/* Added to both sides of the ripple's fraction: it is 1 for a tail that does not move at all, and
 * that of a moving one loses no bit. */
#define TAIL_REST_RAD2 1e-30

/* In the middle of each quarter of a frame. */
typedef struct {
    double amplitude_rad[SUBSTEPS];
    /* Thrust over its mean over the beat: 2 cos^2 of the tail's phase. A fraction, since the step
     * of the speed divides anyway. */
    double ripple_over[SUBSTEPS], ripple_under[SUBSTEPS];
    double commanded_rad[2]; /* at the ends of the frame, about the bias */
} drive_t;

/* Whole frames in |beat_s|; 0 when it is no multiple of a frame or out of range. */
uint32_t tail_beat_frames(double beat_s);

#endif
