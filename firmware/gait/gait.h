/*
 * The tail gait: theta(t) = amplitude * sin(2*pi*t/beat), one set-point per 20 ms frame, phase
 * continuous; a new amplitude is taken over only at a beat boundary, where theta = 0.
 *
 * Off: no pulses. Swim: the sine, from frame 0 of beat 0 with the tail at the centre. Coast: half a
 * raised cosine from where the last frame left the tail to the centre, reached in the last of
 * coast_frames frames, then off. A stop that comes when the beat is whole closes the sine: the tail
 * goes to the centre at once and is held there as long. A slew limit slower than the coast does not
 * prolong it. A zero-initialised command means stop.
 *
 * A swim begins from off only: a swim command during a coast waits for its end.
 *
 * Pure functions of (state, command) -> (state, output); called by the 50 Hz tick, so they are
 * interrupt-safe and bounded (at most 2 float divisions and about 40 cheaper float operations).
 */
#ifndef GAIT_GAIT_H
#define GAIT_GAIT_H

#include "gait/servo.h"

#include <stdbool.h>
#include <stdint.h>

#define GAIT_FRAMES_PER_BEAT_MIN 4u
#define GAIT_FRAMES_PER_BEAT_MAX 1000u

typedef enum { GAIT_OFF = 0, GAIT_SWIM = 1, GAIT_COAST = 2 } gait_mode_t;

typedef struct {
    servo_config_t servo;
    uint16_t frames_per_beat; /* 50 for 1 Hz */
    uint16_t coast_frames;    /* 0 = off at once */
} gait_config_t;

typedef struct {
    bool swim;           /* false = stop: coast to the centre, then no pulses */
    float amplitude_rad; /* for the next beat; >= 0, already saturated */
} gait_command_t;

typedef struct {
    gait_mode_t mode;
    uint16_t frame;       /* within the beat, 0..frames_per_beat-1 */
    uint16_t coast_frame; /* within the coast */
    uint32_t beat;        /* beats begun since the swim began, minus 1 */
    float amplitude_rad;  /* of the present beat */
    float coast_from_rad;
    servo_t servo;
} gait_t;

typedef struct {
    gait_mode_t mode;
    bool beat_start; /* this frame is frame 0 of |beat| */
    uint32_t beat;
    float angle_rad;      /* where the tail is told to be, after limits */
    uint16_t pulse_ticks; /* thirds of a microsecond; 0 = no pulse */
} gait_output_t;

bool gait_config_valid(const gait_config_t *config);

/* Off, at the centre. */
void gait_init(gait_t *gait);

/* One frame. Swimming starts with frame 0 of beat 0 at the frame where |swim| first is true. */
gait_output_t gait_frame_isr(gait_t *gait, const gait_config_t *config, gait_command_t command);

#endif
