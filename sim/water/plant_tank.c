#include "plant_tank.h"

#include "drag_step.h"

#include <string.h>

#define SUBSTEP_S 0.005

uint32_t tank_delay(double delay_s, double *fraction) {
    const double steps = delay_s / SUBSTEP_S;
    const uint32_t whole = (uint32_t)(steps + 1e-6);
    const double rest = steps - whole;
    *fraction = rest > 1e-6 ? rest : 0;
    return whole;
}

void tank_init(tank_t *tank, const sim_config_t *config) {
    tank->kappa_per_m = config->kappa_per_m;
    tank->slope_m_s_rad = config->slope_m_s_rad;
    tank->dead_zone_rad = config->dead_zone_rad;
    tank->map_bend_m_s_rad2 = config->map_bend_m_s_rad2;
    tank->delay_steps = tank_delay(config->delay_s, &tank->delay_fraction);
    tank_begin(tank);
}

void tank_begin(tank_t *tank) {
    tank->step = 0;
    memset(tank->thrust, 0, sizeof tank->thrust);
}

double tank_step(tank_t *tank, double *v_m_s, const drive_t *drive, unsigned substep, double gain,
                 double dt_s) {
    const uint32_t now = tank->step++;
    tank->thrust[now % DELAY_RING] =
        tank_thrust(drive->amplitude_rad[substep], tank->dead_zone_rad, gain * tank->slope_m_s_rad,
                    gain * tank->map_bend_m_s_rad2);
    const double late = tank->thrust[(now - tank->delay_steps) % DELAY_RING];
    const double later = tank->thrust[(now - tank->delay_steps - 1u) % DELAY_RING];
    const double h = late + tank->delay_fraction * (later - late);
    return drag_step(v_m_s, h, drive->ripple_over[substep], drive->ripple_under[substep],
                     tank->kappa_per_m, dt_s);
}
