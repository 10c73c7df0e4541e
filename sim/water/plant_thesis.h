/* The fish of the thesis: equation (8.13). */
#ifndef SIM_PLANT_THESIS_H
#define SIM_PLANT_THESIS_H

#include "common/sim_config.h"

#define QUADRATURE 8u

/* Thrust is the mean over the beat, for the amplitude of the moment. */
typedef struct {
    double mass_kg, drag_kg_m;
    double h1_scale;                           /* H1 = h1_scale * amplitude^2 * mean(sec^4 cos^2) */
    double h2_scale;                           /* H2 = h2_scale * mean(tan^2) */
    double sine[QUADRATURE], cos2[QUADRATURE]; /* a quarter beat; the others mirror it */
    double known_rad, known_h1, known_h2;      /* last amplitude asked for */
} thesis_t;

void thesis_init(thesis_t *thesis, const sim_config_t *config, double beat_s);
double thesis_step(thesis_t *thesis, double *v_m_s, double amplitude_rad, double gain, double dt_s);

#endif
