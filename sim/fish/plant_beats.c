#include "plant_beats.h"

#include "tail.h"
#include "water/plant.h"

#include <math.h>

static double thesis_beat(plant_t *plant, double amplitude_rad, double beat_s) {
    return thesis_step(&plant->thesis, &plant->motion.water_v_m_s, amplitude_rad, 1, beat_s);
}

static double reactive_beat(plant_t *plant, tail_t *tail, double amplitude_rad, double beat_s) {
    const double before_m = plant->motion.way_m;
    for (uint32_t frame = 0; frame < tail->frames_per_beat; frame++) {
        drive_t drive;
        tail_frame_sine(tail, amplitude_rad, beat_s / tail->frames_per_beat, &drive);
        plant_frame(plant, &drive, 0, beat_s / tail->frames_per_beat);
    }
    return plant->motion.way_m - before_m;
}

static double tank_beat(plant_t *plant, tail_t *tail, double amplitude_rad, double beat_s) {
    const double frame_s = beat_s / tail->frames_per_beat;
    const double dt = frame_s / SUBSTEPS;
    double *v_m_s = &plant->motion.water_v_m_s, sum_m_s = 0;
    const double begin_m = tank_way(&plant->tank, 0, *v_m_s, dt);
    for (uint32_t frame = 0; frame < tail->frames_per_beat; frame++) {
        drive_t drive;
        tail_frame_sine(tail, amplitude_rad, frame_s, &drive);
        for (unsigned i = 0; i < SUBSTEPS; i++) {
            sum_m_s += tank_sum_step(&plant->tank, v_m_s, &drive, i, 1, dt);
        }
    }
    return tank_way(&plant->tank, sum_m_s, *v_m_s, dt) - begin_m;
}

static double beat(plant_t *plant, tail_t *tail, double amplitude_rad, double beat_s) {
    switch (plant->kind) {
    case SIM_PLANT_TANK:
        return tank_beat(plant, tail, amplitude_rad, beat_s);
    case SIM_PLANT_REACTIVE:
        return reactive_beat(plant, tail, amplitude_rad, beat_s);
    default:
        return thesis_beat(plant, amplitude_rad, beat_s);
    }
}

bool sim_plant_beats(const sim_config_t *config, const double *amplitude_rad, size_t beats,
                     double beat_s, double *mean_m_s) {
    const uint32_t frames = tail_beat_frames(beat_s);
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
        mean_m_s[k] = beat(&plant, &tail, amplitude, beat_s) / beat_s;
    }
    return true;
}
