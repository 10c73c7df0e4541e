#include "fish.h"

#include <math.h>

#define SILENT_FRAMES 10u /* 0.2 s */
#define FRAMES_PER_SPEED 2u

/* The hand that moves it is not felt as a push; that it was turned is. */
static void carried_from(fish_t *fish, const plant_point_t *before) {
    const plant_point_t after = plant_point(&fish->plant);
    felt_carried(&fish->felt, after.vx_m_s - before->vx_m_s, after.vy_m_s - before->vy_m_s,
                 after.heading_rad - before->heading_rad);
}

void fish_place(fish_t *fish, double x_m, double y_m, double heading_rad) {
    const plant_point_t before = plant_point(&fish->plant);
    plant_place(&fish->plant, x_m, y_m, heading_rad);
    fish->placed = true;
    carried_from(fish, &before);
}

/* At the start of the next swim, as well as a hand can. */
static void put_back(fish_t *fish) {
    disturbance_t next;
    disturbance_draw(&next, &fish->config, fish->next_swim_key);
    fish_place(fish, next.place_x_m, next.place_y_m, next.place_rad);
}

void fish_init(fish_t *fish, const sim_config_t *config) {
    fish->config = *config;
    fish->beat_s = config->beat_s;
    fish->caught_after_us = (uint64_t)(config->caught_after_s * 1e6 + 0.5);
    fish->placed_after_us = (uint64_t)(config->placed_after_s * 1e6 + 0.5);
    fish->gain = 1;
    tail_init(&fish->tail, config, tail_beat_frames(config->beat_s));
    plant_init(&fish->plant, config);
    fish->silent_frames = SILENT_FRAMES;
    fish->next_swim_key = 1;
    put_back(fish);
    felt_init(&fish->felt, config);
    fish->placed = false; /* the first swim may be another one than it was put there for */
}

static void begin_swim(fish_t *fish, uint16_t first_pulse) {
    if (!fish->placed) {
        put_back(fish);
    }
    fish->placed = false;
    fish->swims++;
    fish->swim_key = fish->next_swim_key++;
    fish->swim_frame = 0;
    fish->beats = fish->speeds = 0;
    fish->beat_start_m = 0;
    fish->tail_from_rad = fish->tail_to_rad = 0;
    fish->bias_from_rad = fish->bias_to_rad = fish->tail.bias_rad;
    tail_begin(&fish->tail, first_pulse);
    const plant_point_t before = plant_point(&fish->plant);
    disturbance_draw(&fish->drawn, &fish->config, fish->swim_key);
    const disturbance_t *drawn = &fish->drawn;
    plant_begin(&fish->plant, fish->start_known ? fish->start_m_s : drawn->start_m_s,
                fish->gain * drawn->gain, drawn->flow_m_s);
    fish->start_known = false;
    carried_from(fish, &before);
}

static void record_speed(fish_t *fish) {
    if (fish->swim_frame % FRAMES_PER_SPEED == 0 && fish->speeds < FISH_SPEEDS_MAX) {
        fish->speed_m_s[fish->speeds++] = plant_speed_m_s(&fish->plant);
    }
}

static void record_beat(fish_t *fish) {
    fish->swim_frame++;
    if (fish->swim_frame % fish->tail.frames_per_beat != 0) {
        return;
    }
    if (fish->beats < FISH_BEATS_MAX) {
        fish->beat_m_s[fish->beats++] =
            (fish->plant.motion.way_m - fish->beat_start_m) / fish->beat_s;
    }
    fish->beat_start_m = fish->plant.motion.way_m;
}

static bool waited(const fish_t *fish, uint64_t for_us) {
    return for_us > 0 && fish->time_us - fish->last_pulse_us >= for_us;
}

static void be_handled(fish_t *fish) {
    if (fish->swims == 0 || fish->placed) {
        return;
    }
    if (waited(fish, fish->caught_after_us)) {
        plant_catch(&fish->plant, INFINITY);
    }
    if (waited(fish, fish->placed_after_us) && plant_stopped(&fish->plant)) {
        put_back(fish);
    }
}

/* Where the tail is about its mean. */
static double beat_rad(const fish_t *fish) {
    const plant_t *plant = &fish->plant;
    return plant->kind == SIM_PLANT_REACTIVE ? plant->reactive.tail_rad - fish->tail.bias_rad
                                             : fish->tail.servo_rad;
}

/* Of the frame that is about to be, as at its begin. */
static void move_water(fish_t *fish) {
    const double since_s = fish->swim_frame * fish->beat_s / fish->tail.frames_per_beat;
    fish->plant.motion.flow_m_s =
        fish->drawn.flow_m_s + disturbance_flow_m_s(&fish->drawn, since_s, fish->plant.motion.x_m);
}

bool fish_frame(fish_t *fish, uint64_t now_us, uint16_t next_pulse) {
    const bool swimming = fish->pulse != 0;
    const double frame_s = (double)(now_us - fish->time_us) * 1e-6;
    if (swimming) {
        record_speed(fish);
        fish->last_pulse_us = now_us;
    } else {
        be_handled(fish);
    }
    fish->tail_from_rad = beat_rad(fish);
    fish->bias_from_rad = fish->tail.bias_rad;
    tail_frame(&fish->tail, fish->pulse, next_pulse, frame_s, &fish->drive);
    fish->bias_to_rad = fish->tail.bias_rad;
    if (fish->drawn.moves && !fish->placed) {
        move_water(fish);
    }
    plant_frame(&fish->plant, &fish->drive, fish->bias_to_rad, frame_s);
    fish->tail_to_rad = beat_rad(fish);
    if (swimming) {
        record_beat(fish);
    }
    felt_frame(&fish->felt, &fish->plant, !swimming, fish->tail_from_rad, fish->tail_to_rad,
               fish->time_us, now_us);
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
        begin_swim(fish, next_pulse);
    }
    return begins;
}

bool fish_is_hidden(const fish_t *fish) {
    const uint32_t frame = fish->swim_frame > 0 ? fish->swim_frame - 1 : 0;
    const uint32_t beat = frame / fish->tail.frames_per_beat;
    return fish->pulse != 0 && disturbance_hides(&fish->drawn, beat);
}

/* Cubic through position and speed at both ends of a substep. */
static double hermite(double x0, double x1, double dv0, double dv1, double u) {
    const double w = 1 - u;
    return x0 * w * w * (1 + 2 * u) + x1 * u * u * (3 - 2 * u) + u * w * (w * dv0 - u * dv1);
}

static double between(double from, double to, double part) { return from + part * (to - from); }

/* The body at a point of its path. */
static fish_moment_t body(const plant_t *plant, const plant_point_t *path, double beat_rad,
                          double bias_rad) {
    const double sway_m = plant->sway_m_per_rad * beat_rad;
    return (fish_moment_t){
        .x_m = path->x_m - sway_m * sin(path->heading_rad),
        .y_m = path->y_m + sway_m * cos(path->heading_rad),
        .heading_rad = path->heading_rad + plant->yaw_per_tail * beat_rad,
        .tail_rad = beat_rad + bias_rad,
    };
}

fish_moment_t fish_at(const fish_t *fish, uint64_t time_us) {
    const plant_t *plant = &fish->plant;
    if (fish->frame_us == 0) {
        const plant_point_t path = plant_point(plant);
        return body(plant, &path, fish->tail_to_rad, fish->bias_to_rad);
    }
    const uint64_t begin_us = fish->time_us - fish->frame_us;
    const uint64_t since_us = time_us > begin_us ? time_us - begin_us : 0;
    const double part = fmin(1, (double)since_us / (double)fish->frame_us);
    unsigned i = (unsigned)(part * SUBSTEPS);
    i = i < SUBSTEPS ? i : SUBSTEPS - 1;
    const double u = part * SUBSTEPS - i;
    const double dt = (double)fish->frame_us * 1e-6 / SUBSTEPS;
    const plant_point_t *p = plant->motion.trace + i;
    const plant_point_t path = {
        .x_m = hermite(p[0].x_m, p[1].x_m, p[0].vx_m_s * dt, p[1].vx_m_s * dt, u),
        .y_m = hermite(p[0].y_m, p[1].y_m, p[0].vy_m_s * dt, p[1].vy_m_s * dt, u),
        .heading_rad = between(p[0].heading_rad, p[1].heading_rad, u),
    };
    return body(plant, &path, between(fish->tail_from_rad, fish->tail_to_rad, part),
                between(fish->bias_from_rad, fish->bias_to_rad, part));
}
