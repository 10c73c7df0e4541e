/* A plant and its tail alone, without a world around them. */
#ifndef SIM_PLANT_BEATS_H
#define SIM_PLANT_BEATS_H

#include "common/sim_config.h"

#include <stdbool.h>
#include <stddef.h>

/* Noise-free: mean speed over each of |beats| beats for the given amplitudes, from rest. False when
 * the config makes no sense. No board, no allocation. */
bool sim_plant_beats(const sim_config_t *config, const double *amplitude_rad, size_t beats,
                     double beat_s, double *mean_m_s);

#endif
