/*
 * What is different from one trial to the next, and within one: drawn from the seed of the fish and
 * the number of the trial, for any plant, by the world as by the batch. Pure.
 */
#ifndef SIM_DISTURBANCE_H
#define SIM_DISTURBANCE_H

#include "common/sim_config.h"

#include <stdbool.h>
#include <stdint.h>

#define DISTURBANCE_WAVES 4u

/* A slow wave of the flow. */
typedef struct {
    double m_s, rad_s, phase_rad;
} disturbance_wave_t;

typedef struct {
    double gain; /* on the speed that thrust settles at: scatter, drift and outlier */
    double flow_m_s, start_m_s;                 /* at the begin, over water */
    double place_x_m, place_y_m, place_rad;     /* where the hand puts it */
    disturbance_wave_t wave[DISTURBANCE_WAVES]; /* the moving part of the flow ... */
    disturbance_wave_t standing;                /* ... and the wave that stands in the tank */
    bool moves;                                 /* any of them is not 0 */
    uint64_t lost_key;
    double lost_beats;
} disturbance_t;

void disturbance_draw(disturbance_t *drawn, const sim_config_t *config, uint32_t trial);

/* Flow beyond flow_m_s, |time_s| after the begin, |x_m| from the start along the tank. */
double disturbance_flow_m_s(const disturbance_t *drawn, double time_s, double x_m);

/* Whether the camera sees nothing in all of |beat|. */
bool disturbance_hides(const disturbance_t *drawn, uint64_t beat);

#endif
