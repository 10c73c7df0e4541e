/*
 * The arithmetic of batch.c on BATCH_LANES fish at once, compiled for several instruction sets with
 * the same bits: nothing in it is reordered, contracted or approximated.
 */
#ifndef SIM_BATCH_LANES_H
#define SIM_BATCH_LANES_H

#include "water/plant.h"

#include <stddef.h>

#define BATCH_LANES 32u

typedef double batch_row_t[BATCH_LANES] __attribute__((aligned(64)));
typedef uint64_t batch_keys_t[BATCH_LANES] __attribute__((aligned(64)));

/* Sums over the pictures of one beat. */
typedef struct {
    bool open;
    uint64_t beat;
    uint32_t taken;                /* pictures that should be there */
    double begin_s;                /* first picture */
    double all_n, all_st, all_stt; /* as the rows below, of pictures that no lane misses */
    batch_row_t offset_m;          /* positions count from here */
    batch_row_t n, st, stt;        /* about the middle of the window; pictures that are there */
    batch_row_t sx, stx, sxx;
    batch_row_t missing, missing_max; /* in a row */
} batch_window_t;

/* One block of fish in mid-swim. Rows go by lane. */
typedef struct {
    /* the same for all */
    double frame_s, omega_rad_s;
    bool has_servo, lossy;
    bool same_delay, whole_delay; /* of all lanes; in substeps, of each */
    uint32_t traced;              /* bits: the points of this frame for which trace_... is filled */
    bool sways;                   /* the head of any lane, along the tank */
    bool bends;                   /* the map of any lane */
    uint64_t ring_mask, step;
    double half_window_s;
    uint32_t pictures_per_window, pictures_min;
    /* water and tail */
    batch_row_t amplitude_rad; /* of the present beat */
    batch_row_t v_m_s, servo_rad, late;
    batch_row_t over_kt[SUBSTEPS], under[SUBSTEPS]; /* of the present frame; a scale is left out */
    batch_row_t half_slope, quarter_bend, twice_dead_zone_rad; /* of tank_thrust, times the gain */
    batch_row_t kt, twice_kt, kt_fifteenth, twelfth;           /* of drag_step.h */
    batch_row_t delay_fraction;
    batch_row_t ahead_frames, settle, most_rad; /* tail_servo_t */
    batch_keys_t delay_steps;
    batch_row_t late_most;        /* thrust; beyond the fraction of drag_step.h the lane is wrong */
    batch_row_t sum_m_s, begin_m; /* drag_way's since the beat began, and drag_way then */
    batch_row_t trace_v_m_s[SUBSTEPS + 1], trace_way_m[SUBSTEPS + 1];
    /* camera */
    batch_row_t flow_m_s, base_m; /* position at the beat's begin */
    batch_row_t ahead;            /* part of the way that is along the tank */
    batch_row_t sway_m_per_rad;   /* of the tail */
    batch_row_t swayed_m[2];      /* the head's sway along it as the frame begins and ends */
    batch_row_t noise_m;
    batch_keys_t noise_key, lost_key, lost_below;
    batch_window_t window[2];
    batch_row_t speed_m_s, sigma_m_s; /* of the window that was fitted last */
    batch_row_t *thrust;              /* ring of ring_mask + 1 substeps */
} batch_block_t;

/* When and where in the frame a picture is taken. */
typedef struct {
    uint64_t sample;  /* its number in the swim */
    double time_s;    /* since the swim began */
    double in_beat_s; /* since the beat began */
    unsigned substep;
    double part; /* of that substep */
} batch_picture_t;

typedef struct {
    const char *name;
    /* One frame of the tail from |sine| to |next_sine| times the amplitude; |ripple| serves fish
     * without a servo. */
    void (*frame)(batch_block_t *block, double sine, double next_sine,
                  const double ripple[SUBSTEPS]);
    /* Adds a picture out of the last frame to the open windows. */
    void (*picture)(batch_block_t *block, const batch_picture_t *picture);
    void (*fit)(batch_block_t *block, const batch_window_t *window);
} batch_lanes_t;

/* The |index|-th set of instructions that this processor has, plainest first; NULL past the last.
 */
const batch_lanes_t *batch_lanes(size_t index);

/* batch_swim on one of them. */
bool batch_swim_on(const batch_lanes_t *lanes, const sim_config_t *configs, size_t fish,
                   const uint32_t *swims, const double *amplitude_rad, size_t beats, double beat_s,
                   double *true_m_s, double *speed_m_s, double *sigma_m_s);

#endif
