#include "plant.h"

#include "world.h"

#include <math.h>

#define CATCH_S 0.3
#define PUSH_S 0.3

static bool within(double x, double low, double high) { return x >= low && x <= high; }

bool plant_config_valid(const sim_config_t *config) {
    return (config->plant == SIM_PLANT_THESIS || config->plant == SIM_PLANT_TANK) &&
           within(config->mass_kg, 1e-3, 1e6) && within(config->body_length_m, 1e-3, 1e3) &&
           within(config->water_density_kg_m3, 1.0, 1e5) &&
           within(config->tail_area_m2, 1e-6, 1e3) && within(config->drag_kg_m, 1e-3, 1e9) &&
           within(config->kappa_per_m, 1e-3, 1e4) && within(config->delay_s, 0, DELAY_MAX_S) &&
           within(config->slope_m_s_rad, 0, 100) && within(config->dead_zone_rad, 0, 3) &&
           within(config->map_bend_m_s_rad2, -100, 100) && within(config->servo_lag_s, 0, 10) &&
           within(config->servo_rate_rad_s, 0, 1e4);
}

void plant_init(plant_t *plant, const sim_config_t *config) {
    plant->kind = config->plant;
    thesis_init(&plant->thesis, config, config->beat_s);
    tank_init(&plant->tank, config);
    plant_begin(plant, 0, 1, 0);
}

void plant_begin(plant_t *plant, double start_m_s, double gain, double flow_m_s) {
    tank_begin(&plant->tank);
    plant->gain = gain;
    plant->flow_m_s = flow_m_s;
    plant->water_v_m_s = start_m_s;
    plant->x_m = 0;
    plant->held = false;
    plant->push_left_s = 0;
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        plant->trace_x_m[i] = 0;
        plant->trace_v_m_s[i] = start_m_s + flow_m_s;
    }
}

void plant_catch(plant_t *plant, double hold_s) {
    plant->held_for_s = hold_s;
    if (!plant->held) {
        plant->held = true;
        plant->held_s = 0;
        plant->held_from_m_s = plant->water_v_m_s + plant->flow_m_s;
    }
}

void plant_push(plant_t *plant, double by_m_s) {
    plant->push_left_s = PUSH_S;
    plant->push_m_s2 = by_m_s / PUSH_S;
}

/* Speed and way since the catch, as parts of the speed before and of that times CATCH_S. */
static void hold(double part, double *speed, double *way) {
    const double u = part < 1 ? part : 1;
    *speed = 1 - u * u * (3 - 2 * u);
    *way = u - u * u * u * (1 - 0.5 * u);
}

static void held_frame(plant_t *plant, double frame_s) {
    const double from = plant->held_from_m_s;
    double speed, way, way_begin;
    hold(plant->held_s / CATCH_S, &speed, &way_begin);
    for (unsigned i = 0; i <= SUBSTEPS; i++) {
        hold((plant->held_s + frame_s * i / SUBSTEPS) / CATCH_S, &speed, &way);
        plant->trace_v_m_s[i] = from * speed;
        plant->trace_x_m[i] = plant->x_m + from * CATCH_S * (way - way_begin);
    }
    plant->held_s += frame_s;
    plant->water_v_m_s = plant->trace_v_m_s[SUBSTEPS] - plant->flow_m_s;
    plant->x_m = plant->trace_x_m[SUBSTEPS];
    plant->held = plant->held_s < plant->held_for_s;
}

/* What the hand adds to the speed in one substep. */
static double pushed(plant_t *plant, double dt) {
    if (plant->push_left_s <= 0) {
        return 0;
    }
    const double part = dt < plant->push_left_s ? dt : plant->push_left_s;
    plant->push_left_s -= part;
    return plant->push_m_s2 * part;
}

void plant_frame(plant_t *plant, const drive_t *drive, double frame_s) {
    if (plant->held) {
        held_frame(plant, frame_s);
        return;
    }
    const double dt = frame_s / SUBSTEPS;
    double v = plant->water_v_m_s;
    double x = plant->x_m;
    plant->trace_x_m[0] = x;
    plant->trace_v_m_s[0] = v + plant->flow_m_s;
    for (unsigned i = 0; i < SUBSTEPS; i++) {
        if (plant->kind == SIM_PLANT_TANK) {
            x += tank_step(&plant->tank, &v, drive->amplitude_rad[i], drive->ripple[i], plant->gain,
                           dt);
        } else {
            x += thesis_step(&plant->thesis, &v, drive->amplitude_rad[i], plant->gain, dt);
        }
        v += pushed(plant, dt);
        x += plant->flow_m_s * dt;
        plant->trace_x_m[i + 1] = x;
        plant->trace_v_m_s[i + 1] = v + plant->flow_m_s;
    }
    plant->water_v_m_s = v;
    plant->x_m = x;
}

static double thesis_beat(plant_t *plant, double amplitude_rad, double beat_s) {
    return thesis_step(&plant->thesis, &plant->water_v_m_s, amplitude_rad, 1, beat_s);
}

static double tank_beat(plant_t *plant, tail_t *tail, double amplitude_rad, double beat_s) {
    const double frame_s = beat_s / tail->frames_per_beat;
    const double dt = frame_s / SUBSTEPS;
    double distance = 0;
    for (uint32_t frame = 0; frame < tail->frames_per_beat; frame++) {
        drive_t drive;
        tail_frame_sine(tail, amplitude_rad, frame_s, &drive);
        for (unsigned i = 0; i < SUBSTEPS; i++) {
            distance += tank_step(&plant->tank, &plant->water_v_m_s, drive.amplitude_rad[i],
                                  drive.ripple[i], 1, dt);
        }
    }
    return distance;
}

bool sim_plant_beats(const sim_config_t *config, const double *amplitude_rad, size_t beats,
                     double beat_s, double *mean_m_s) {
    const uint32_t frames = tail_frames(beat_s);
    if (!plant_config_valid(config) || frames == 0) {
        return false;
    }
    sim_config_t timed = *config;
    timed.beat_s = beat_s;
    tail_t tail;
    plant_t plant;
    tail_init(&tail, &timed, frames);
    plant_init(&plant, &timed);
    for (size_t k = 0; k < beats; k++) {
        if (!isfinite(amplitude_rad[k])) {
            return false;
        }
        const double amplitude = fabs(amplitude_rad[k]);
        const double distance = plant.kind == SIM_PLANT_TANK
                                    ? tank_beat(&plant, &tail, amplitude, beat_s)
                                    : thesis_beat(&plant, amplitude, beat_s);
        mean_m_s[k] = distance / beat_s;
    }
    return true;
}
