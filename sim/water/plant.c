#include "plant.h"

#include <math.h>

#define CATCH_S 0.3
#define PUSH_S 0.3

static bool within(double x, double low, double high) { return x >= low && x <= high; }

bool plant_config_valid(const sim_config_t *config) {
    return config->plant <= SIM_PLANT_REACTIVE && within(config->mass_kg, 1e-3, 1e6) &&
           within(config->body_length_m, 1e-3, 1e3) &&
           within(config->water_density_kg_m3, 1.0, 1e5) &&
           within(config->tail_area_m2, 1e-6, 1e3) && within(config->drag_kg_m, 1e-3, 1e9) &&
           within(config->kappa_per_m, 1e-3, 1e4) && within(config->delay_s, 0, DELAY_MAX_S) &&
           within(config->slope_m_s_rad, 0, 100) && within(config->dead_zone_rad, 0, 3) &&
           within(config->map_bend_m_s_rad2, -100, 100) && within(config->servo_lag_s, 0, 10) &&
           within(config->servo_rate_rad_s, 0, 1e4) && within(config->tail_centre_rad, -0.5, 0.5) &&
           within(config->servo_backlash_rad, 0, 1) && within(config->fin_depth_m, 1e-3, 1) &&
           within(config->thrust_exponent, 1, 4) && within(config->drag_linear, 0, 100) &&
           within(config->drag_per_rad, 0, 10) && within(config->wake_share, 0, 1) &&
           within(config->wake_s, 0, 60) && within(config->asymmetry, -0.9, 0.9) &&
           within(config->collapse_rad, 0, 3);
}

void plant_init(plant_t *plant, const sim_config_t *config) {
    plant->kind = config->plant;
    thesis_init(&plant->thesis, config, config->beat_s);
    tank_init(&plant->tank, config);
    reactive_plant_init(&plant->reactive, config);
    const bool by_itself = plant->kind == SIM_PLANT_REACTIVE;
    plant->yaw_per_tail = by_itself ? 0 : YAW_PER_TAIL;
    plant->sway_m_per_rad = by_itself ? 0 : SWAY_M_PER_RAD;
    plant->motion.stir_m_s = 0;
    plant->motion.stir = (plant_stroke_t){0, 0};
    plant_place(plant, 0, 0, 0);
    plant_begin(plant, 0, 1, 0);
}

double plant_speed_m_s(const plant_t *plant) {
    return plant->motion.water_v_m_s + plant_current_m_s(&plant->motion) * plant->motion.cosine;
}

static plant_point_t point(const plant_t *plant, double side_m_s) {
    const double along = plant_speed_m_s(plant);
    return (plant_point_t){
        .x_m = plant->motion.x_m,
        .y_m = plant->motion.y_m,
        .heading_rad = plant->motion.heading_rad,
        .vx_m_s = along * plant->motion.cosine - side_m_s * plant->motion.sine,
        .vy_m_s = along * plant->motion.sine + side_m_s * plant->motion.cosine,
    };
}

plant_point_t plant_point(const plant_t *plant) {
    if (plant->kind == SIM_PLANT_REACTIVE && !plant->held) {
        return reactive_plant_point(&plant->reactive, &plant->motion);
    }
    return point(plant, plant->held ? 0 : -plant_current_m_s(&plant->motion) * plant->motion.sine);
}

static void trace_all(plant_t *plant) {
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        plant->motion.trace[i] = plant_point(plant);
    }
}

static void begin_reactive(plant_t *plant, double surge_m_s) {
    if (plant->kind == SIM_PLANT_REACTIVE) {
        reactive_plant_begin(&plant->reactive, &plant->motion, surge_m_s);
    }
}

void plant_begin(plant_t *plant, double start_m_s, double gain, double flow_m_s) {
    tank_begin(&plant->tank);
    plant->gain = gain;
    plant->motion.flow_m_s = flow_m_s;
    plant->motion.water_v_m_s = start_m_s;
    plant->motion.way_m = 0;
    plant->held = false;
    plant->motion.push = (plant_stroke_t){0, 0};
    begin_reactive(plant, start_m_s);
    trace_all(plant);
}

void plant_place(plant_t *plant, double x_m, double y_m, double heading_rad) {
    tank_begin(&plant->tank);
    plant->motion.x_m = x_m;
    plant->motion.y_m = y_m;
    plant->motion.heading_rad = heading_rad;
    plant->motion.cosine = cos(heading_rad);
    plant->motion.sine = sin(heading_rad);
    plant->motion.flow_m_s = 0;
    plant->motion.water_v_m_s = 0;
    plant->held = false;
    plant->motion.push = (plant_stroke_t){0, 0};
    begin_reactive(plant, 0);
    trace_all(plant);
}

void plant_catch(plant_t *plant, double hold_s) {
    plant->held_for_s = hold_s;
    if (!plant->held) {
        const plant_point_t from = plant_point(plant);
        plant->held = true;
        plant->held_s = 0;
        plant->held_from[0] = from.vx_m_s;
        plant->held_from[1] = from.vy_m_s;
    }
}

bool plant_stopped(const plant_t *plant) { return plant->held && plant->held_s >= CATCH_S; }

void plant_push(plant_t *plant, double by_m_s) {
    plant->motion.push = (plant_stroke_t){PUSH_S, by_m_s / PUSH_S};
}

void plant_stir(plant_t *plant, double by_m_s) {
    plant->motion.stir = (plant_stroke_t){PUSH_S, by_m_s / PUSH_S};
}

/* Speed and way since the catch, as parts of the speed before and of that times CATCH_S. */
static void hold(double part, double *speed, double *way) {
    const double u = part < 1 ? part : 1;
    *speed = 1 - u * u * (3 - 2 * u);
    *way = u - u * u * u * (1 - 0.5 * u);
}

static void held_frame(plant_t *plant, double frame_s) {
    const double from[2] = {plant->held_from[0], plant->held_from[1]};
    const double along = from[0] * plant->motion.cosine + from[1] * plant->motion.sine;
    double speed, way, way_begin;
    hold(plant->held_s / CATCH_S, &speed, &way_begin);
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        hold((plant->held_s + frame_s * i / SUBSTEPS) / CATCH_S, &speed, &way);
        plant->motion.trace[i] = (plant_point_t){
            .x_m = plant->motion.x_m + from[0] * CATCH_S * (way - way_begin),
            .y_m = plant->motion.y_m + from[1] * CATCH_S * (way - way_begin),
            .heading_rad = plant->motion.heading_rad,
            .vx_m_s = from[0] * speed,
            .vy_m_s = from[1] * speed,
        };
        plant_stir_on(&plant->motion, i < SUBSTEPS ? frame_s / SUBSTEPS : 0);
    }
    plant->held_s += frame_s;
    plant->motion.water_v_m_s =
        along * speed - plant_current_m_s(&plant->motion) * plant->motion.cosine;
    plant->motion.way_m += along * CATCH_S * (way - way_begin);
    plant->motion.x_m = plant->motion.trace[SUBSTEPS].x_m;
    plant->motion.y_m = plant->motion.trace[SUBSTEPS].y_m;
    plant->held = plant->held_s < plant->held_for_s;
    begin_reactive(plant, plant->motion.water_v_m_s);
}

static void turn_by(plant_t *plant, double by_rad) {
    if (fabs(by_rad) > 0) {
        plant->motion.heading_rad += by_rad;
        plant->motion.cosine = cos(plant->motion.heading_rad);
        plant->motion.sine = sin(plant->motion.heading_rad);
    }
}

/* Straight on, halfway through the turn: an arc's chord but for a part in 1e8 at 5 ms. */
static void advance(plant_t *plant, double distance_m, double bias_rad, double dt) {
    const double half_rad = 0.5 * TURN_PER_M_RAD * bias_rad * distance_m;
    turn_by(plant, half_rad);
    plant->motion.way_m += distance_m;
    plant->motion.x_m += distance_m * plant->motion.cosine;
    plant->motion.y_m += distance_m * plant->motion.sine;
    turn_by(plant, half_rad);
    plant->motion.way_m += plant_current_m_s(&plant->motion) * plant->motion.cosine * dt;
    plant->motion.x_m += plant_current_m_s(&plant->motion) * dt;
}

static double swim_on(plant_t *plant, const drive_t *drive, unsigned i, double dt) {
    double *v = &plant->motion.water_v_m_s;
    return plant->kind == SIM_PLANT_TANK
               ? tank_step(&plant->tank, v, drive, i, plant->gain, dt)
               : thesis_step(&plant->thesis, v, drive->amplitude_rad[i], plant->gain, dt);
}

void plant_frame(plant_t *plant, const drive_t *drive, double bias_rad, double frame_s) {
    if (plant->held) {
        held_frame(plant, frame_s);
        return;
    }
    if (plant->kind == SIM_PLANT_REACTIVE) {
        reactive_plant_frame(&plant->reactive, &plant->motion, plant->gain, drive, bias_rad,
                             frame_s);
        return;
    }
    const double dt = frame_s / SUBSTEPS;
    plant->motion.trace[0] = plant_point(plant);
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        const double distance_m = swim_on(plant, drive, i, dt);
        plant->motion.water_v_m_s += plant_stroke(&plant->motion.push, dt);
        plant_stir_on(&plant->motion, dt);
        advance(plant, distance_m, bias_rad, dt);
        plant->motion.trace[i + 1] = plant_point(plant);
    }
}
