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

/* Puts the thrust of this substep away, and takes the one that works in it. */
static drag_push_t next_push(tank_t *tank, const drive_t *drive, unsigned substep, double gain) {
    const uint32_t now = tank->step++;
    tank->thrust[now % DELAY_RING] =
        tank_thrust(drive->amplitude_rad[substep], tank->dead_zone_rad, gain * tank->slope_m_s_rad,
                    gain * tank->map_bend_m_s_rad2);
    const double late = tank->thrust[(now - tank->delay_steps) % DELAY_RING];
    const double later = tank->thrust[(now - tank->delay_steps - 1u) % DELAY_RING];
    return (drag_push_t){
        .thrust = late + tank->delay_fraction * (later - late),
        .over = drive->ripple_over[substep],
        .under = drive->ripple_under[substep],
    };
}

double tank_step(tank_t *tank, double *v_m_s, const drive_t *drive, unsigned substep, double gain,
                 double dt_s) {
    return drag_step(v_m_s, next_push(tank, drive, substep, gain), tank->kappa_per_m, dt_s);
}

double tank_sum_step(tank_t *tank, double *v_m_s, const drive_t *drive, unsigned substep,
                     double gain, double dt_s) {
    return drag_sum_step(v_m_s, next_push(tank, drive, substep, gain), tank->kappa_per_m, dt_s);
}

double tank_way(const tank_t *tank, double sum_m_s, double v_m_s, double dt_s) {
    return drag_way(sum_m_s, v_m_s, dt_s, drag_twelfth(tank->kappa_per_m * dt_s, dt_s));
}
