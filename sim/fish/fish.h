/*
 * The fish in its tank: tail, plant and the swims. A pulse train that begins after 0.2 s of silence
 * means a new swim. Some time after the last pulse somebody catches the fish and holds it, and puts
 * it back at the start, x = y = heading = 0: later on, or when the next swim begins. Once put
 * somewhere it lies free, and the next swim begins from where it lies then.
 */
#ifndef SIM_FISH_H
#define SIM_FISH_H

#include "felt.h"
#include "tail.h"
#include "water/disturbance.h"
#include "water/plant.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define FISH_BEATS_MAX 640u
#define FISH_SPEEDS_MAX 32768u

typedef struct {
    sim_config_t config;
    double beat_s;
    disturbance_t drawn;      /* of the present swim */
    uint64_t caught_after_us; /* 0 = never */
    uint64_t placed_after_us; /* 0 = when the next swim begins */
    double gain;              /* of thrust speed, beside each swim's own */
    tail_t tail;
    plant_t plant;
    uint64_t time_us;  /* up to which the plant has been advanced */
    uint64_t frame_us; /* length of the last frame */
    uint16_t pulse;    /* of the present frame, 0 = none */
    uint32_t silent_frames;
    uint64_t last_pulse_us; /* end of the last frame with one */
    uint32_t swims;         /* begun */
    uint32_t swim_key;      /* of the present swim's noise; 0 = no swim yet */
    uint32_t next_swim_key;
    bool start_known; /* the next swim starts at |start_m_s| over water, whatever is drawn */
    double start_m_s;
    bool placed;                       /* since the last swim */
    uint32_t swim_frame;               /* frames with pulses in this swim */
    double beat_start_m;               /* way */
    double tail_from_rad, tail_to_rad; /* about its mean, at the ends of the last frame */
    double bias_from_rad, bias_to_rad; /* the mean */
    drive_t drive;
    felt_t felt;
    size_t beats, speeds;
    double beat_m_s[FISH_BEATS_MAX];
    double speed_m_s[FISH_SPEEDS_MAX]; /* over ground at 0.04*i s */
} fish_t;

/* Where the body is: it sways and swings about its path. */
typedef struct {
    double x_m, y_m, heading_rad;
    double tail_rad; /* real angle against the body */
} fish_moment_t;

void fish_init(fish_t *fish, const sim_config_t *config);

/* The frame that ends at |now_us|, where |next_pulse| begins. True when a new swim begins there. */
bool fish_frame(fish_t *fish, uint64_t now_us, uint16_t next_pulse);

/* Somebody carries it there. */
void fish_place(fish_t *fish, double x_m, double y_m, double heading_rad);

/* Whether the camera sees nothing of it in the present beat. */
bool fish_is_hidden(const fish_t *fish);

/* At |time_us| within the last frame. */
fish_moment_t fish_at(const fish_t *fish, uint64_t time_us);

#endif
