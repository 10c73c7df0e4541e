/*
 * The arithmetic of batch.c on BATCH_LANES fish at once, compiled for several instruction sets with
 * the same bits: nothing in it is reordered, contracted or approximated.
 */
#ifndef SIM_BATCH_LANES_H
#define SIM_BATCH_LANES_H

#include "water/plant.h"

#include <stddef.h>

#define BATCH_LANES 64u
#define BATCH_STEP 16u /* lanes are computed by so many */

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
    unsigned lanes; /* that are computed, by whole BATCH_STEP */
    double frame_s;
    double to_amplitude; /* from what a tail moves in a substep */
    bool has_servo, lossy;
    bool same_delay, whole_delay; /* of all lanes; in substeps, of each */
    bool drifts;                  /* the water of any lane, within the trial */
    bool summed;                  /* the way is drag_way of sum_m_s, otherwise way_m */
    bool bends;                   /* the map of any lane */
    uint64_t ring_mask, step;
    double half_window_s;
    uint32_t pictures_per_window, pictures_min;
    /* water and tail */
    batch_row_t amplitude_rad; /* of the present beat */
    batch_row_t tail_rad[2];   /* as the last frame began and ended */
    batch_row_t late;
    /* at the points of the last frame, over water */
    batch_row_t v_m_s[SUBSTEPS + 1], sum_m_s[SUBSTEPS + 1], way_m[SUBSTEPS + 1];
    batch_row_t half_slope, quarter_bend, twice_dead_zone_rad; /* of tank_thrust, times the gain */
    batch_row_t kt, twice_kt, kt_fifteenth, twelfth;           /* of drag_step.h */
    batch_row_t delay_fraction;
    batch_row_t ahead_frames, settle, most_rad; /* tail_servo_t */
    batch_keys_t delay_steps;
    batch_row_t late_most; /* thrust; beyond the fraction of drag_step.h the lane is wrong */
    batch_row_t begin_m;   /* the way as the beat began, which is never 0 by drag_way */
    /* camera */
    batch_row_t flow_m_s, base_m;     /* position where the way is 0 */
    batch_row_t drifted_m, drift_m_s; /* by the moving water: before the last frame, and in it */
    batch_row_t ahead;                /* part of the way that is along the tank */
    batch_row_t sway_m_per_rad;       /* of the head along it, per angle of the tail */
    batch_row_t noise_m;
    batch_keys_t noise_key, lost_key, lost_below;
    batch_window_t window[2];
    batch_row_t speed_m_s, sigma_m_s; /* of the window that was fitted last */
    batch_row_t *thrust;              /* ring of ring_mask + 1 substeps */
} batch_block_t;

/* One frame of a tail that is to go from |sine| to |next_sine| times the amplitude; |ripple| serves
 * fish without a servo. */
typedef struct {
    double sine, next_sine;
    const double *ripple; /* by substep */
} batch_frame_t;

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
    void (*frame)(batch_block_t *block, const batch_frame_t *frame);
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
