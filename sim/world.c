#include "world.h"

#include "base/panic.h"
#include "camera/camera.h"
#include "config_valid.h"
#include "fish/fish.h"
#include "sensor/vn100.h"

#include <stdlib.h>

#define IMU_POWER_LATER_US 61000u
#define LOAD_RAD 0.78539816339744830962

_Static_assert(WORLD_IMU_MESSAGE_MAX == VN100_MESSAGE_MAX, "one message of the IMU");

struct world {
    fish_t fish;
    camera_t camera;
    vn100_t vn100;
    double battery_v, battery_sag_v_per_trial, battery_load_v;
    uint32_t battery_swims; /* begun before this pack was put in */
};

world_t *world_new(const sim_config_t *config) {
    world_t *world = sim_config_valid(config) ? calloc(1, sizeof *world) : NULL;
    if (world == NULL) {
        return NULL;
    }
    fish_init(&world->fish, config);
    camera_init(&world->camera, config);
    vn100_init(&world->vn100, config, &world->fish.felt);
    world->battery_v = config->battery_v;
    world->battery_sag_v_per_trial = config->battery_sag_v_per_trial;
    world->battery_load_v = config->battery_load_v;
    return world;
}

void world_free(world_t *world) { free(world); }

void world_frame(world_t *world, uint64_t now_us, uint16_t next_pulse_ticks) {
    REQUIRE(now_us >= world->fish.time_us);
    fish_frame(&world->fish, now_us, next_pulse_ticks);
    camera_follow(&world->camera, &world->fish);
}

uint64_t world_time_us(const world_t *world) { return world->fish.time_us; }

void world_imu_power_on(world_t *world, uint64_t board_power_us) {
    vn100_power_on(&world->vn100, board_power_us + IMU_POWER_LATER_US);
}

void world_imu_power_off(world_t *world) { vn100_power_off(&world->vn100); }

uint64_t world_imu_due_us(const world_t *world) { return vn100_due_us(&world->vn100); }

uint32_t world_imu_baud(const world_t *world) { return vn100_baud(&world->vn100); }

size_t world_imu_read(world_t *world, uint8_t out[WORLD_IMU_MESSAGE_MAX]) {
    return vn100_read(&world->vn100, out);
}

void world_imu_write(world_t *world, uint64_t now_us, const uint8_t *bytes, size_t length,
                     uint32_t baud) {
    vn100_write(&world->vn100, now_us, bytes, length, baud);
}

void world_imu_reboot(world_t *world, uint64_t now_us) { vn100_reboot(&world->vn100, now_us); }

void world_imu_wedge(world_t *world) { vn100_wedge(&world->vn100); }

double world_battery_v(const world_t *world) {
    const fish_t *fish = &world->fish;
    const uint32_t swims = fish->swims - world->battery_swims;
    const double load = fish->drive.amplitude_rad[SUBSTEPS - 1] / LOAD_RAD;
    const double v = world->battery_v - world->battery_sag_v_per_trial * swims -
                     (fish->pulse != 0 ? world->battery_load_v * load : 0);
    return v > 0 ? v : 0;
}

void world_led(world_t *world, uint64_t now_us, bool on) {
    REQUIRE(now_us >= world->fish.time_us);
    light_set(&world->camera.light, now_us, on);
}

uint64_t world_camera_due_us(const world_t *world) { return camera_due_us(&world->camera); }

size_t world_camera_read(world_t *world, uint64_t now_us, sim_camera_frame_t *out, size_t max) {
    return camera_read(&world->camera, now_us, out, max);
}

sim_truth_t world_truth(const world_t *world) {
    const fish_t *fish = &world->fish;
    return (sim_truth_t){
        .time_s = (double)fish->time_us * 1e-6,
        .x_m = fish->plant.motion.x_m,
        .y_m = fish->plant.motion.y_m,
        .heading_rad = fish->plant.motion.heading_rad,
        .v_m_s = plant_speed_m_s(&fish->plant),
        .tail_rad = fish->tail_to_rad + fish->bias_to_rad,
        .amplitude_rad = fish->drive.amplitude_rad[SUBSTEPS - 1],
        .swims = fish->swims,
        .swimming = fish->pulse != 0,
        .pulse_ticks = fish->pulse,
    };
}

static size_t copy_out(const double *values, size_t count, double *out, size_t max) {
    for (size_t i = 0; i < count && i < max; i++) {
        out[i] = values[i];
    }
    return count;
}

size_t world_true_beats(const world_t *world, double *out, size_t max) {
    return copy_out(world->fish.beat_m_s, world->fish.beats, out, max);
}

size_t world_true_speeds_25hz(const world_t *world, double *out, size_t max) {
    return copy_out(world->fish.speed_m_s, world->fish.speeds, out, max);
}

void world_set_swim(world_t *world, uint32_t next_swim) { world->fish.next_swim_key = next_swim; }

void world_set_start(world_t *world, double start_m_s) {
    world->fish.start_known = true;
    world->fish.start_m_s = start_m_s;
}

void world_push(world_t *world, double by_m_s) { plant_push(&world->fish.plant, by_m_s); }

void world_hold(world_t *world, double hold_s) { plant_catch(&world->fish.plant, hold_s); }

void world_stir(world_t *world, double by_m_s) { plant_stir(&world->fish.plant, by_m_s); }

void world_place(world_t *world, double x_m, double y_m, double heading_rad) {
    fish_place(&world->fish, x_m, y_m, heading_rad);
}

void world_swap_battery(world_t *world, double volts, double gain, double centre_rad) {
    world_set_battery_v(world, volts);
    world->battery_swims = world->fish.swims;
    world->fish.gain *= gain;
    world->fish.tail.mounted_rad += centre_rad;
}

void world_set_battery_v(world_t *world, double volts) {
    world->battery_v = volts >= 0 && volts <= 60 ? volts : 0;
}

void world_set_imu(world_t *world, uint64_t now_us, bool plugged) {
    vn100_plug(&world->vn100, now_us, plugged);
}

void world_set_camera(world_t *world, bool on) { world->camera.on = on; }

void world_set_tilt_rad(world_t *world, double roll_rad) {
    world->fish.felt.tilt_wanted_rad = roll_rad;
}

void world_turn(world_t *world, double roll_rad, double pitch_rad, double yaw_rad,
                double within_s) {
    const double angle_rad[3] = {yaw_rad, pitch_rad, roll_rad};
    felt_turn(&world->fish.felt, angle_rad, within_s, world->fish.time_us);
}
