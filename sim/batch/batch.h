/*
 * Many simulated fish side by side: water, tail and overhead camera of the simulator, without a
 * board. A fish swims its sines as sim_plant_beats' does, with the disturbances that the whole
 * simulator draws for the same seed and swim. All tails are trimmed: they swim straight. Any
 * number of threads.
 */
#ifndef SIM_BATCH_H
#define SIM_BATCH_H

#include "common/sim_config.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Every fish swims once: |beats| beats of |beat_s|, which stands in for its config's. |swims|: the
 * number that keys each one's noise (1 = first). |amplitude_rad| and the results: fish x beats,
 * row-major. No fish depends on its neighbours.
 *
 * |true_m_s|: mean speed over ground per beat, as world_true_beats. Without disturbances it has the
 * bits of sim_plant_beats (tank plant).
 * |speed_m_s|, |sigma_m_s|: the same from the camera, a line through the pictures of one beat, both
 * ends included, that begin with the first one in the beat (the first of all is taken 0.33 of a
 * picture period after the start); lost ones are left out. Sigma follows from the scatter about the
 * line, at least 1e-5 m/s. Both NaN with more than 5 lost in a row or fewer than 60 % there.
 * Both NULL = no camera.
 *
 * What it works on is allocated, for the longest delay among them. False, and results undefined,
 * when a value makes no sense or there is no memory. */
bool batch_swim(const sim_config_t *configs, size_t fish, const uint32_t *swims,
                const double *amplitude_rad, size_t beats, double beat_s, double *true_m_s,
                double *speed_m_s, double *sigma_m_s);

#endif
