/*
 * The models of the fish in the water. Speeds are over water; the tail cannot brake. Only a
 * hand can: a held fish stands still over ground, a pushed one gets faster, or drifts backwards.
 *
 * Level frame: x along the tank, y to the right of it; headings clockwise from above. The water
 * moves along x. A tail that beats about a bent mean is a rudder: the fish turns by so much per
 * metre over water, whatever its speed. A tip to port turns it to port.
 */
#ifndef SIM_PLANT_H
#define SIM_PLANT_H

#include "reactive.h"
#include "sim_config.h"
#include "tail.h"

#define DELAY_RING 2048u /* substeps; a power of two */
#define DELAY_MAX_S 5.0
#define QUADRATURE 8u
/* Of the tank's and the thesis's fish: how its body goes with the tail. */
#define YAW_PER_TAIL (-10.0 / 45.0)
#define SWAY_M_PER_RAD 0.02
#define TURN_PER_M_RAD (-3.0) /* heading by metre, per rad of the tail's mean angle */

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

/* reactive.h with a servo of its own: lag, rate limit, play. Its body swings and sways by itself.
 */
typedef struct {
    reactive_config_t config;
    reactive_t fish;
    double omega_rad_s, lag_s, rate_rad_s, backlash_rad;
    double shaft_rad, tail_rad;          /* of the servo; of the tail, which has play on it */
    double v_m_s[2];                     /* over water, x and y */
    double yaw_rad[FRAMES_PER_BEAT_MAX]; /* of the last beat, by frame */
    double yaw_sum_rad;
    uint32_t frames_per_beat, frame;
} reactive_plant_t;

/* Over ground. */
typedef struct {
    double x_m, y_m, heading_rad;
    double vx_m_s, vy_m_s;
} plant_point_t;

/* A hand or a paddle, at work for so long still. */
typedef struct {
    double left_s, m_s2;
} plant_stroke_t;

typedef struct {
    sim_plant_t kind;
    thesis_t thesis;
    tank_t tank;
    reactive_plant_t reactive;
    double yaw_per_tail, sway_m_per_rad; /* of the body beside its path, per tail angle */
    double gain;                         /* on the speed that thrust settles at */
    double flow_m_s;
    double stir_m_s; /* what the water moves beyond that, dying down */
    double water_v_m_s;
    double way_m; /* along the heading, over ground, since plant_begin */
    double x_m, y_m, heading_rad, cosine, sine;
    bool held;                   /* somebody has caught it ... */
    double held_s, held_from[2]; /* ... so long ago, at that velocity over ground, ... */
    double held_for_s;           /* ... and lets go after so long */
    plant_stroke_t push, stir;
    plant_point_t trace[SUBSTEPS + 1]; /* at the ends of the substeps of the last frame */
} plant_t;

bool plant_config_valid(const sim_config_t *config);
void plant_init(plant_t *plant, const sim_config_t *config);

/* Where it is, with |start_m_s| over water, thrust forgotten. */
void plant_begin(plant_t *plant, double start_m_s, double gain, double flow_m_s);
/* From the next frame on somebody, or something in its way, holds the fish for |hold_s| (INFINITY:
 * until plant_begin); its speed over ground falls smoothly to 0. One that is held already stays so
 * for that time from its catch. */
void plant_catch(plant_t *plant, double hold_s);
/* From the next frame on a hand changes its speed by |by_m_s|, within 0.3 s. */
void plant_push(plant_t *plant, double by_m_s);
/* From the next frame on the water gets faster by |by_m_s|, within 0.3 s; it comes to rest again
 * with a time constant of 8 s. */
void plant_stir(plant_t *plant, double by_m_s);
/* Somebody puts it there, into water that carries no flow but what it was stirred by, at rest in
 * it. */
void plant_place(plant_t *plant, double x_m, double y_m, double heading_rad);
/* Caught, and it has come to a stop. */
bool plant_stopped(const plant_t *plant);
/* Along its heading and over ground; the same as a velocity. */
double plant_speed_m_s(const plant_t *plant);
plant_point_t plant_point(const plant_t *plant);
/* |bias_rad|: mean angle of the tail. */
void plant_frame(plant_t *plant, const drive_t *drive, double bias_rad, double frame_s);

/* The tail's own mean angle is in the drive of the reactive plant. */
void reactive_plant_init(reactive_plant_t *own, const sim_config_t *config);
/* Where the plant has it, with |surge_m_s|, thrust forgotten. Nothing for another kind. */
void reactive_plant_begin(plant_t *plant, double surge_m_s);
void reactive_plant_frame(plant_t *plant, const drive_t *drive, double bias_rad, double frame_s);

/* For the files of the plants. What a hand adds to a speed in one substep. */
double plant_stroke(plant_stroke_t *stroke, double dt);
void plant_stir_on(plant_t *plant, double dt);
double plant_current_m_s(const plant_t *plant);

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
