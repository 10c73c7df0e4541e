#include "plant_reactive.h"

#include <math.h>

#define TWO_PI 6.28318530717958647692
#define SPEED_OF_SHARE_M_S 0.08 /* where drag_linear is a share of the quadratic drag */
/* A body of the fish's length and mass, and the water that moves with it (mass_kg has that of the
 * surge): so that it swings by 6 to 7 degrees at 0.6 rad, as its makers tell of theirs. */
#define SWAY_MASS_PART 1.7
#define GYRATION_M 0.1
#define SWAY_DRAG_KG_M 20.0
#define YAW_DRAG_KG_M2 0.05
#define HINGE_M 0.10
#define TAIL_M 0.12
#define FIN_M 0.06
#define PEDUNCLE_DEPTH_M 0.03
#define FIN_DRAG 1.2

static reactive_config_t body(const sim_config_t *config) {
    const double drag_kg_m = config->kappa_per_m * config->mass_kg;
    return (reactive_config_t){
        .mass_kg = config->mass_kg,
        .sway_mass_kg = SWAY_MASS_PART * config->mass_kg,
        .inertia_kg_m2 = config->mass_kg * GYRATION_M * GYRATION_M,
        .hinge_m = HINGE_M,
        .tail_m = TAIL_M,
        .fin_m = FIN_M,
        .fin_depth_m = config->fin_depth_m,
        .peduncle_depth_m = PEDUNCLE_DEPTH_M,
        .water_kg_m3 = config->water_density_kg_m3,
        .drag_kg_m = drag_kg_m,
        .drag_linear_kg_s = config->drag_linear * drag_kg_m * SPEED_OF_SHARE_M_S,
        .drag_per_rad = config->drag_per_rad,
        .sway_drag_kg_m = SWAY_DRAG_KG_M,
        .yaw_drag_kg_m2 = YAW_DRAG_KG_M2,
        .fin_drag = FIN_DRAG,
        .thrust_exponent = config->thrust_exponent,
        .collapse_rad = config->collapse_rad,
        .asymmetry = config->asymmetry,
        .wake_share = config->wake_share,
        .wake_s = config->wake_s,
        .delay_s = config->delay_s,
    };
}

void reactive_plant_init(reactive_plant_t *own, const sim_config_t *config) {
    own->config = body(config);
    own->omega_rad_s = TWO_PI / config->beat_s;
    own->lag_s = config->servo_lag_s;
    own->rate_rad_s = config->servo_rate_rad_s;
    own->backlash_rad = config->servo_backlash_rad;
    own->shaft_rad = own->tail_rad = 0;
    own->frames_per_beat = tail_beat_frames(config->beat_s);
}

/* The path's heading is the mean of the nose's over the last beat. */
static void know_heading(reactive_plant_t *own, double yaw_rad) {
    for (uint32_t i = 0; i < own->frames_per_beat; i++) {
        own->yaw_rad[i] = yaw_rad;
    }
    own->yaw_sum_rad = yaw_rad * own->frames_per_beat;
    own->frame = 0;
}

static void set_heading(plant_motion_t *motion, double path_rad) {
    motion->cosine = cos(path_rad);
    motion->sine = sin(path_rad);
}

void reactive_plant_begin(reactive_plant_t *own, plant_motion_t *motion, double surge_m_s) {
    reactive_init(&own->fish);
    own->fish.x_m = motion->x_m;
    own->fish.y_m = motion->y_m;
    own->fish.yaw_rad = motion->heading_rad;
    reactive_set_speed(&own->fish, &own->config, own->tail_rad, 0,
                       (reactive_speed_t){.surge_m_s = surge_m_s});
    know_heading(own, motion->heading_rad);
    set_heading(motion, motion->heading_rad);
    own->v_m_s[0] = surge_m_s * motion->cosine;
    own->v_m_s[1] = surge_m_s * motion->sine;
}

/* The shaft follows with lag and rate limit; the tail stays where the play leaves it. */
static void follow(reactive_plant_t *own, double commanded_rad, double dt) {
    const double share = own->lag_s > 0 ? 1 - exp(-dt / own->lag_s) : 1;
    const double most = own->rate_rad_s > 0 ? own->rate_rad_s * dt : INFINITY;
    own->shaft_rad += fmax(-most, fmin(most, share * (commanded_rad - own->shaft_rad)));
    const double play = 0.5 * own->backlash_rad;
    own->tail_rad = fmax(own->shaft_rad - play, fmin(own->shaft_rad + play, own->tail_rad));
}

static void step(reactive_plant_t *own, plant_motion_t *motion, double gain, double commanded_rad,
                 double dt) {
    const double from_rad = own->tail_rad;
    const double x_m = own->fish.x_m, y_m = own->fish.y_m;
    follow(own, commanded_rad, dt);
    reactive_step(&own->fish, &own->config, gain, from_rad, own->tail_rad, own->omega_rad_s, dt);
    own->fish.x_m += plant_current_m_s(motion) * dt;
    const double rate = (own->tail_rad - from_rad) / dt;
    reactive_speed_t speed = reactive_speed(&own->fish, &own->config, own->tail_rad, rate);
    const double push_m_s = plant_stroke(&motion->push, dt);
    if (fabs(push_m_s) > 0) {
        speed.surge_m_s += push_m_s;
        reactive_set_speed(&own->fish, &own->config, own->tail_rad, rate, speed);
    }
    plant_stir_on(motion, dt);
    motion->x_m = own->fish.x_m;
    motion->y_m = own->fish.y_m;
    motion->heading_rad = own->fish.yaw_rad;
    motion->way_m += (motion->x_m - x_m) * motion->cosine + (motion->y_m - y_m) * motion->sine;
    const double ahead = cos(own->fish.yaw_rad), aside = sin(own->fish.yaw_rad);
    own->v_m_s[0] = speed.surge_m_s * ahead - speed.sway_m_s * aside;
    own->v_m_s[1] = speed.surge_m_s * aside + speed.sway_m_s * ahead;
    motion->water_v_m_s = own->v_m_s[0] * motion->cosine + own->v_m_s[1] * motion->sine;
}

plant_point_t reactive_plant_point(const reactive_plant_t *own, const plant_motion_t *motion) {
    return (plant_point_t){
        .x_m = motion->x_m,
        .y_m = motion->y_m,
        .heading_rad = motion->heading_rad,
        .vx_m_s = own->v_m_s[0] + plant_current_m_s(motion),
        .vy_m_s = own->v_m_s[1],
    };
}

void reactive_plant_frame(reactive_plant_t *own, plant_motion_t *motion, double gain,
                          const drive_t *drive, double bias_rad, double frame_s) {
    const double dt = frame_s / SUBSTEPS;
    motion->trace[0] = reactive_plant_point(own, motion);
    for (unsigned i = 0; i < SUBSTEPS && dt > 0; i++) {
        const double part = (i + 1.0) / SUBSTEPS;
        const double commanded_rad =
            drive->commanded_rad[0] * (1 - part) + drive->commanded_rad[1] * part + bias_rad;
        step(own, motion, gain, commanded_rad, dt);
        motion->trace[i + 1] = reactive_plant_point(own, motion);
    }
    double *oldest = &own->yaw_rad[own->frame++ % own->frames_per_beat];
    own->yaw_sum_rad += motion->heading_rad - *oldest;
    *oldest = motion->heading_rad;
    set_heading(motion, own->yaw_sum_rad / own->frames_per_beat);
}
