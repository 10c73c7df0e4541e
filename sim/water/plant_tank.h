/* The fish of the tank: a map from amplitude to steady speed, with a delay. */
#ifndef SIM_PLANT_TANK_H
#define SIM_PLANT_TANK_H

#include "common/sim_config.h"
#include "tail_beat.h"

#include <stdint.h>

#define DELAY_RING 2048u /* substeps; a power of two */
#define DELAY_MAX_S 5.0

/* dv/dt = kappa*((g*vss(amplitude(t - delay)))^2 * ripple - v*|v|), vss = slope*beyond +
 * bend*beyond^2 and never negative, beyond = what the amplitude has over the dead zone. */
typedef struct {
    double kappa_per_m, slope_m_s_rad, dead_zone_rad, map_bend_m_s_rad2;
    uint32_t delay_steps;  /* whole substeps */
    double delay_fraction; /* of one more */
    uint32_t step;
    double thrust[DELAY_RING]; /* vss^2 by substep */
} tank_t;

/* Whole substeps in a delay, and the fraction of one more. */
uint32_t tank_delay(double delay_s, double *fraction);
void tank_init(tank_t *tank, const sim_config_t *config);
void tank_begin(tank_t *tank);
/* Thrust as the square of the speed it would settle at; |slope| and |bend| times the gain. */
static inline double tank_thrust(double amplitude_rad, double dead_zone_rad, double slope,
                                 double bend) {
    const double over = amplitude_rad - dead_zone_rad;
    const double beyond = over > 0 ? over : 0;
    const double vss = (slope + bend * beyond) * beyond;
    return vss > 0 ? vss * vss : 0;
}
/* One substep of a frame: the distance. */
double tank_step(tank_t *tank, double *v_m_s, const drive_t *drive, unsigned substep, double gain,
                 double dt_s);
/* The same, with the way summed up: the sum that grows by what is returned, and the way up to there
 * but for a constant, as drag_sum_step and drag_way. */
double tank_sum_step(tank_t *tank, double *v_m_s, const drive_t *drive, unsigned substep,
                     double gain, double dt_s);
double tank_way(const tank_t *tank, double sum_m_s, double v_m_s, double dt_s);

#endif
