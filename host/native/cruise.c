#include "cruise.h"

#include "water/drag_step.h"
#include "water/plant.h"

void cruise_thrust(const sim_config_t *config, const double *amplitude_rad, size_t samples,
                   double *h1_n, double *h2_kg_m) {
    thesis_t fish;
    thesis_init(&fish, config, config->beat_s);
    double unused_m_s = 0;
    for (size_t k = 0; k < samples; k++) {
        (void)thesis_step(&fish, &unused_m_s, amplitude_rad[k], 1, 1);
        h1_n[k] = fish.known_h1;
        h2_kg_m[k] = fish.known_h2;
    }
}

void cruise_speeds(const sim_config_t *config, const double *h1_n, const double *h2_kg_m,
                   size_t samples, double step_s, double *v_m_s, double *way_m) {
    double v = 0;
    for (size_t k = 0; k < samples; k++) {
        const double drag_kg_m = config->drag_kg_m + h2_kg_m[k];
        const drag_push_t push = {h1_n[k], 1, drag_kg_m};
        way_m[k] = drag_step(&v, push, drag_kg_m / config->mass_kg, step_s);
        v_m_s[k] = v;
    }
}
