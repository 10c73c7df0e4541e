/*
 * The two models of the fish in the water. Speeds are over water; the tail cannot brake. Only a
 * hand can: a held fish stands still over ground, a pushed one gets faster, or drifts backwards.
 */
#ifndef SIM_PLANT_H
#define SIM_PLANT_H

#include "sim_config.h"
#include "tail.h"

#define DELAY_RING 2048u /* substeps; a power of two */
#define DELAY_MAX_S 5.0
#define QUADRATURE 8u

/* (8.13): thrust is the mean over the beat, for the amplitude of the moment. */
typedef struct {
    double mass_kg, drag_kg_m;
    double h1_scale;                           /* H1 = h1_scale * amplitude^2 * mean(sec^4 cos^2) */
    double h2_scale;                           /* H2 = h2_scale * mean(tan^2) */
    double sine[QUADRATURE], cos2[QUADRATURE]; /* a quarter beat; the others mirror it */
    double known_rad, known_h1, known_h2;      /* last amplitude asked for */
} thesis_t;

/* dv/dt = kappa*((g*vss(amplitude(t - delay)))^2 * ripple - v*|v|), vss = slope*beyond +
 * bend*beyond^2 and never negative, beyond = what the amplitude has over the dead zone. */
typedef struct {
    double kappa_per_m, slope_m_s_rad, dead_zone_rad, map_bend_m_s_rad2;
    uint32_t delay_steps;  /* whole substeps */
    double delay_fraction; /* of one more */
    uint32_t step;
    double thrust[DELAY_RING]; /* vss^2 by substep */
} tank_t;

typedef struct {
    sim_plant_t kind;
    thesis_t thesis;
    tank_t tank;
    double gain; /* on the speed that thrust settles at */
    double flow_m_s;
    double water_v_m_s;
    double x_m;                   /* over ground */
    bool held;                    /* somebody has caught it ... */
    double held_s, held_from_m_s; /* ... so long ago, at that speed over ground, ... */
    double held_for_s;            /* ... and lets go after so long */
    double push_left_s, push_m_s2;
    /* over ground at the ends of the substeps of the last frame */
    double trace_x_m[SUBSTEPS + 1], trace_v_m_s[SUBSTEPS + 1];
} plant_t;

bool plant_config_valid(const sim_config_t *config);
void plant_init(plant_t *plant, const sim_config_t *config);

/* At x = 0 with |start_m_s| over water, thrust forgotten. */
void plant_begin(plant_t *plant, double start_m_s, double gain, double flow_m_s);
/* From the next frame on somebody, or something in its way, holds the fish for |hold_s| (INFINITY:
 * until plant_begin); its speed over ground falls smoothly to 0. One that is held already stays so
 * for that time from its catch. */
void plant_catch(plant_t *plant, double hold_s);
/* From the next frame on a hand changes its speed by |by_m_s|, within 0.3 s. */
void plant_push(plant_t *plant, double by_m_s);
void plant_frame(plant_t *plant, const drive_t *drive, double frame_s);

void thesis_init(thesis_t *thesis, const sim_config_t *config, double beat_s);
double thesis_step(thesis_t *thesis, double *v_m_s, double amplitude_rad, double gain, double dt_s);

/* Whole substeps in a delay, and the fraction of one more. */
uint32_t tank_delay(double delay_s, double *fraction);
void tank_init(tank_t *tank, const sim_config_t *config);
void tank_begin(tank_t *tank);
/* Thrust as the square of the speed it would settle at; |slope| and |bend| times the gain. */
static inline double tank_thrust(double amplitude_rad, double dead_zone_rad, double slope,
                                 double bend) {
    const double over = amplitude_rad - dead_zone_rad;
    const double beyond = over > 0 ? over : 0;
    const double vss = slope * beyond + bend * beyond * beyond;
    return vss > 0 ? vss * vss : 0;
}
double tank_step(tank_t *tank, double *v_m_s, double amplitude_rad, double ripple, double gain,
                 double dt_s);

#endif
