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

#include "common/sim_config.h"
#include "plant_motion.h"
#include "plant_reactive.h"
#include "plant_tank.h"
#include "plant_thesis.h"
#include "tail_beat.h"

#include <stdbool.h>

/* Of the tank's and the thesis's fish: how its body goes with the tail. */
#define YAW_PER_TAIL (-10.0 / 45.0)
#define SWAY_M_PER_RAD 0.02
#define TURN_PER_M_RAD (-3.0) /* heading by metre, per rad of the tail's mean angle */

typedef struct {
    sim_plant_t kind;
    thesis_t thesis;
    tank_t tank;
    reactive_plant_t reactive;
    double yaw_per_tail, sway_m_per_rad; /* of the body beside its path, per tail angle */
    double gain;                         /* on the speed that thrust settles at */
    plant_motion_t motion;
    bool held;                   /* somebody has caught it ... */
    double held_s, held_from[2]; /* ... so long ago, at that velocity over ground, ... */
    double held_for_s;           /* ... and lets go after so long */
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

#endif
