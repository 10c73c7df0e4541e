/*
 * The fish of the thesis, (8.13), with its amplitude held for samples of any length: for sampled
 * control, where the simulator swims whole beats. The thrust of a sample is the mean over a beat,
 * as in (8.5)-(8.10), however short the sample is. Pure; the caller owns all buffers.
 */
#ifndef CRUISE_H
#define CRUISE_H

#include "common/sim_config.h"

#include <stddef.h>

/* H1, N, and H2, kg/m, of |samples| amplitudes >= 0, rad. */
void cruise_thrust(const sim_config_t *config, const double *amplitude_rad, size_t samples,
                   double *h1_n, double *h2_kg_m);

/* Speed at the end of every sample of |step_s| > 0, and the way swum in it; from rest. |h1_n| >= 0.
 * The step is exact for thrust held within it, hence stable however long it is. */
void cruise_speeds(const sim_config_t *config, const double *h1_n, const double *h2_kg_m,
                   size_t samples, double step_s, double *v_m_s, double *way_m);

#endif
