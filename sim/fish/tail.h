/*
 * The tail: from servo pulses to what the water feels of them, the amplitude of the beat and where
 * in the beat the tail is. Pulses are all it sees, with the nominal centre and scale.
 *
 * The first pulse of a swim is taken for the centre that the board believes in. About it the tail
 * beats; where it is with that pulse is its mean angle, the bias: 0 for a tail that is mounted
 * straight and for a trimmed one. A positive angle has the tip of the tail to port.
 */
#ifndef SIM_TAIL_H
#define SIM_TAIL_H

#include "common/sim_config.h"
#include "water/tail_beat.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t frames_per_beat;
    double omega_rad_s;
    bool has_servo;
    double lag_s, rate_rad_s;             /* 0 = none */
    double mounted_rad;                   /* askew by this */
    double sine[FRAMES_PER_BEAT_MAX + 1]; /* at the frames of a beat */
    double ripple[FRAMES_PER_BEAT_MAX * SUBSTEPS];
    uint32_t frame;        /* within the beat */
    double angle_rad;      /* commanded at the present frame */
    double fit_ps, fit_ss; /* sums of angle*sine and sine*sine over the beat so far */
    bool off_sine;         /* this beat's pulses are no sine: stopped, clipped */
    double servo_rad;      /* real angle, about the bias */
    int32_t centre_ticks;  /* of this swim's pulses */
    double bias_rad;       /* real mean angle; a limp tail trails straight */
} tail_t;

/* How a servo follows a command that goes straight on for |frame_s|, in a substep: it makes up
 * |settle| of what it lacks to a target that runs |ahead_frames| ahead of the command, by which the
 * lag is exact, but moves |most_rad| at most. */
typedef struct {
    double settle, ahead_frames, most_rad;
} tail_servo_t;

/* 0 = no lag, no limit. */
tail_servo_t tail_servo(double lag_s, double rate_rad_s, double frame_s);
/* Twice the amplitude's part in phase with the tail's speed, for each rad that it moves in a
 * substep. */
double tail_to_amplitude(const tail_t *tail, double frame_s);

void tail_init(tail_t *tail, const sim_config_t *config, uint32_t frames_per_beat);

/* The tail is put to the centre, which |pulse_ticks| is; the next frame is frame 0 of a beat. */
void tail_begin(tail_t *tail, uint16_t pulse_ticks);

/* The frame from the present pulse to the next; 0 = no pulses. */
void tail_frame(tail_t *tail, uint16_t pulse, uint16_t next_pulse, double frame_s, drive_t *drive);

/* The same for a tail that is known to swim a sine of |amplitude_rad|, free of rounding. */
void tail_frame_sine(tail_t *tail, double amplitude_rad, double frame_s, drive_t *drive);

#endif
