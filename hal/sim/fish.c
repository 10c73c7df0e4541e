#include "fish.h"

#include "noise.h"

#include <math.h>

#define SILENT_FRAMES 10u /* 0.2 s */
#define FRAMES_PER_SPEED 2u

void fish_init(fish_t *fish, const sim_config_t *config) {
    fish->gain_sigma = config->gain_sigma;
    fish->flow_sigma_m_s = config->flow_sigma_m_s;
    fish->start_sigma_m_s = config->start_sigma_m_s;
    fish->beat_s = config->beat_s;
    fish->caught_after_us = (uint64_t)(config->caught_after_s * 1e6 + 0.5);
    fish->seed = config->seed;
    tail_init(&fish->tail, config, tail_frames(config->beat_s));
    plant_init(&fish->plant, config);
    fish->silent_frames = SILENT_FRAMES;
    fish->next_swim_key = 1;
}

static double disturbance(const fish_t *fish, noise_stream_t stream, double sigma) {
    return sigma * noise_normal(noise_key(fish->seed, stream, fish->swim_key), 0);
}

static void begin_swim(fish_t *fish) {
    fish->swims++;
    fish->swim_key = fish->next_swim_key++;
    fish->swim_frame = 0;
    fish->beats = fish->speeds = 0;
    fish->beat_start_m = 0;
    fish->tail_from_rad = fish->tail_to_rad = 0;
    tail_begin(&fish->tail);
    const double before_m_s = fish->plant.water_v_m_s + fish->plant.flow_m_s;
    const double drawn_m_s = fabs(disturbance(fish, NOISE_START, fish->start_sigma_m_s));
    plant_begin(&fish->plant, fish->start_known ? fish->start_m_s : drawn_m_s,
                fmax(0, 1 + disturbance(fish, NOISE_GAIN, fish->gain_sigma)),
                disturbance(fish, NOISE_FLOW, fish->flow_sigma_m_s));
    fish->start_known = false;
    felt_carried(&fish->felt, fish->plant.water_v_m_s + fish->plant.flow_m_s - before_m_s);
}

static void record_speed(fish_t *fish) {
    if (fish->swim_frame % FRAMES_PER_SPEED == 0 && fish->speeds < FISH_SPEEDS_MAX) {
        fish->speed_m_s[fish->speeds++] = fish->plant.water_v_m_s + fish->plant.flow_m_s;
    }
}

static void record_beat(fish_t *fish) {
    fish->swim_frame++;
    if (fish->swim_frame % fish->tail.frames_per_beat != 0) {
        return;
    }
    if (fish->beats < FISH_BEATS_MAX) {
        fish->beat_m_s[fish->beats++] = (fish->plant.x_m - fish->beat_start_m) / fish->beat_s;
    }
    fish->beat_start_m = fish->plant.x_m;
}

static void be_caught(fish_t *fish) {
    if (fish->swims > 0 && fish->caught_after_us > 0 &&
        fish->time_us - fish->last_pulse_us >= fish->caught_after_us) {
        plant_catch(&fish->plant, INFINITY);
    }
}

bool fish_frame(fish_t *fish, uint64_t now_us, uint16_t next_pulse) {
    const bool swimming = fish->pulse != 0;
    const double frame_s = (double)(now_us - fish->time_us) * 1e-6;
    if (swimming) {
        record_speed(fish);
        fish->last_pulse_us = now_us;
    } else {
        be_caught(fish);
    }
    fish->tail_from_rad = fish->tail.servo_rad;
    tail_frame(&fish->tail, fish->pulse, next_pulse, frame_s, &fish->drive);
    fish->tail_to_rad = fish->tail.servo_rad;
    plant_frame(&fish->plant, &fish->drive, frame_s);
    if (swimming) {
        record_beat(fish);
    }
    felt_frame(&fish->felt, &fish->plant, fish->tail_from_rad, fish->tail_to_rad, fish->time_us,
               now_us);
    fish->frame_us = now_us - fish->time_us;
    fish->time_us = now_us;
    fish->pulse = next_pulse;
    if (!swimming && fish->silent_frames < SILENT_FRAMES) {
        fish->silent_frames++;
    }
    if (next_pulse == 0) {
        return false;
    }
    const bool begins = fish->silent_frames >= SILENT_FRAMES;
    fish->silent_frames = 0;
    if (begins) {
        begin_swim(fish);
        fish->tail.angle_rad = tail_angle_rad(next_pulse);
    }
    return begins;
}

/* Cubic through position and speed at both ends of a substep. */
static double hermite(double x0, double x1, double dv0, double dv1, double u) {
    const double w = 1 - u;
    return x0 * w * w * (1 + 2 * u) + x1 * u * u * (3 - 2 * u) + u * w * (w * dv0 - u * dv1);
}

fish_moment_t fish_at(const fish_t *fish, uint64_t time_us) {
    const plant_t *plant = &fish->plant;
    if (fish->frame_us == 0) {
        return (fish_moment_t){.x_m = plant->x_m, .tail_rad = fish->tail_to_rad};
    }
    const uint64_t begin_us = fish->time_us - fish->frame_us;
    const uint64_t since_us = time_us > begin_us ? time_us - begin_us : 0;
    const double part = fmin(1, (double)since_us / (double)fish->frame_us);
    unsigned i = (unsigned)(part * SUBSTEPS);
    i = i < SUBSTEPS ? i : SUBSTEPS - 1;
    const double u = part * SUBSTEPS - i;
    const double dt = (double)fish->frame_us * 1e-6 / SUBSTEPS;
    const double v0 = plant->trace_v_m_s[i];
    const double v1 = plant->trace_v_m_s[i + 1];
    return (fish_moment_t){
        .x_m = hermite(plant->trace_x_m[i], plant->trace_x_m[i + 1], v0 * dt, v1 * dt, u),
        .tail_rad = fish->tail_from_rad + part * (fish->tail_to_rad - fish->tail_from_rad),
    };
}
