/* Swims with a simulated fish that knows its speed by the IMU alone (SPD_SOURCE 2), with a sensor
 * and hands that are not perfect. For the unit test and for bench/imu_coverage.py. */
#ifndef HELD_SWIMS_H
#define HELD_SWIMS_H

#include "base/panic.h"
#include "base/units.h"
#include "gait/gait.h"
#include "imu/frame.h"
#include "speed/estimate.h"
#include "speed/motion.h"
#include "speed/rest.h"
#include "world.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define BEATS 40u
#define BEAT_FRAMES 50u
#define SETUP_FRAMES 100u
#define REST_FRAMES 300u
#define COAST_FRAMES 30u
#define CAUGHT_FRAMES 550u
#define LATE_S 1.5f
#define HELD_S 60 /* beyond the end */
#define DEG (3.14159265358979323846 / 180)
#define TAIL_RAD 0.55 /* of the cruising beats */

/* A stress range, not a data sheet's. */
typedef struct {
    const char *name;
    double bias_mg, scale, misaligned_rad, roll_rad, tremor_rad;
    float scale_sd; /* as IMU_SCALE_SD */
} level_t;

static const level_t levels[] = {
    {"data sheet", 1, 0, 0, 0, 0, 1e-3f},
    {"mild", 1, 5e-4, 0.05 * DEG, 2 * DEG, 0.02 * DEG, 1e-3f},
    {"stress", 5, 1e-3, 0.05 * DEG, 3 * DEG, 0.05 * DEG, 1e-3f},
    {"stress, 16 mg", 16, 1e-3, 0.05 * DEG, 3 * DEG, 0.05 * DEG, 1e-3f},
    /* What bench/imu_calibration.py leaves of its scales and axes, and more. */
    {"stress, calibrated", 5, 1e-4, 0.01 * DEG, 3 * DEG, 0.05 * DEG, 2e-4f},
};
#define LEVELS (sizeof levels / sizeof levels[0])
/* Of level 2, but with the noise of a real sensor at rest; for the test only. */
static const level_t recorded_stress = {
    "stress, recorded noise", 0, 1e-3, 0.05 * DEG, 3 * DEG, 0.05 * DEG, 1e-3f};

/* A field recording of a VN-100 that lies still, 10 Hz: what it says beyond its means. */
#define RECORDED "F00294_B.parsed.csv"
#define RECORDED_MAX 200u
#define RECORDED_COLUMN 3 /* acceleration, then rate */
static float noise[RECORDED_MAX][6];
static unsigned noise_count, noise_at;

typedef struct {
    double true_m_s[BEATS];
    speed_beat_t beat[BEATS];
} swim_t;

static world_t *world;
static rest_t rest;
static motion_t motion;
static speed_t speed;
static imu_sequence_t sequence;
static estimate_t estimate;
static float speed_m_s[BEATS_MAX], sigma_m_s[BEATS_MAX], applied_rad[BEATS];
static uint64_t start_us; /* of the swim; 0 = not yet */

static float since_start_s(uint64_t time_us) {
    return (float)(((double)time_us - (double)start_us) * 1e-6);
}

static void tell_imu(const char *body) {
    char line[80];
    unsigned check = 0;
    for (const char *c = body; *c != '\0'; c++) {
        check ^= (unsigned)(unsigned char)*c;
    }
    const int length = snprintf(line, sizeof line, "$%s*%02X\r\n", body, check);
    world_imu_write(world, world_time_us(world), (const uint8_t *)line, (size_t)length, 115200);
}

/* False: it is not there. */
static bool load_noise(void) {
    const char *folder = getenv("TAILBEAT_RECORDINGS");
    char path[512], line[1024];
    double mean[6] = {0};
    (void)snprintf(path, sizeof path, "%s/" RECORDED, folder != NULL ? folder : ".");
    FILE *file = fopen(path, "r");
    while (file != NULL && noise_count < RECORDED_MAX && fgets(line, sizeof line, file) != NULL) {
        const char *at = line;
        for (int column = 0; column < RECORDED_COLUMN && at != NULL; column++) {
            at = strchr(at, ',') != NULL ? strchr(at, ',') + 1 : NULL;
        }
        float *row = noise[noise_count];
        if (at != NULL && sscanf(at, "%f,%f,%f,%f,%f,%f", &row[0], &row[1], &row[2], &row[3],
                                 &row[4], &row[5]) == 6) {
            noise_count++;
        }
    }
    if (file != NULL) {
        (void)fclose(file);
    }
    for (unsigned i = 0; i < noise_count * 6u; i++) {
        mean[i % 6u] += (double)noise[i / 6u][i % 6u] / noise_count;
    }
    for (unsigned i = 0; i < noise_count * 6u; i++) {
        noise[i / 6u][i % 6u] -= (float)mean[i % 6u];
    }
    return noise_count > 0;
}

/* To and fro, so that it goes on without a jump. */
static void add_noise(imu_frame_t *frame) {
    if (noise_count == 0) {
        return;
    }
    const unsigned at = noise_at++ / 10u % (2u * noise_count);
    const float *row = noise[at < noise_count ? at : 2u * noise_count - 1u - at];
    for (unsigned i = 0; i < 3; i++) {
        frame->accel_m_s2[i] += row[i];
        frame->rate_rad_s[i] += row[3u + i];
    }
}

static void hear_imu(uint64_t now_us) {
    uint8_t bytes[WORLD_IMU_MESSAGE_MAX];
    while (world_imu_due_us(world) <= now_us) {
        const uint64_t time_us = world_imu_due_us(world);
        imu_frame_t frame;
        float dt_s;
        if (world_imu_read(world, bytes) != IMU_FRAME_BYTES || bytes[0] != 0xFA) {
            continue;
        }
        REQUIRE(imu_frame_decode(bytes, &frame));
        add_noise(&frame);
        (void)imu_sequence_next(&sequence, frame.time_startup_ns, &dt_s);
        rest_push(&rest, &frame, dt_s);
        if (motion.begun) {
            motion_push(&motion, &frame, since_start_s(time_us), dt_s);
        }
    }
}

static void close_slots(uint64_t now_us) {
    uint16_t index;
    while (speed_slot_due(&speed, since_start_s(now_us) - LATE_S, &index)) {
        speed_motion_t moved;
        const bool known = motion_forward(&motion, index, 1.0f, &moved.gain_m_s, &moved.way_m);
        (void)speed_close_slot(&speed, known ? &moved : NULL);
    }
    while (estimate.next < BEATS + SMOOTHER_AFTER &&
           (float)speed.next_close * SPEED_SLOT_S >= estimate_needs_s(&estimate)) {
        const uint16_t k = estimate.next;
        (void)estimate_beat(&estimate, &speed, k < BEATS ? applied_rad[k] : 0.0f);
    }
}

static void frames(unsigned count, uint16_t pulse_ticks) {
    for (unsigned i = 0; i < count; i++) {
        const uint64_t now_us = world_time_us(world) + WORLD_FRAME_US;
        world_frame(world, now_us, pulse_ticks);
        hear_imu(now_us);
        if (start_us != 0) {
            close_slots(now_us);
        }
    }
}

static void power_on(uint64_t seed, sim_plant_t plant, const level_t *level) {
    sim_config_t config;
    sim_config_default(&config, plant);
    config.seed = seed;
    config.caught_after_s = 1.5;
    config.placed_after_s = HELD_S;
    config.imu_port = 2;
    config.imu_baud = 115200;
    config.imu_noise = noise_count > 0 ? 0 : config.imu_noise;
    config.imu_bias_mg = level->bias_mg;
    noise_at = 137u * (unsigned)seed;
    config.imu_accel_scale = config.imu_rate_scale = level->scale;
    config.imu_misaligned_rad = level->misaligned_rad;
    config.roll_per_tail = level->roll_rad / TAIL_RAD;
    config.roll_lag_rad = 45 * DEG * ((double)(seed % 8u) - 4);
    config.cone_per_tail = 0.5 * level->roll_rad / TAIL_RAD;
    config.tremor_rad = level->tremor_rad;
    world = world_new(&config);
    REQUIRE(world != NULL);
    memset(&motion, 0, sizeof motion);
    speed_init(&speed);
    rest_init(&rest);
    imu_sequence_init(&sequence, 10000000u);
    start_us = 0;
    world_imu_power_on(world, world_time_us(world));
    frames(SETUP_FRAMES / 2u, 0);
    tell_imu("VNWRG,06,0");
    frames(10, 0);
    tell_imu("VNWRG,85,0,8,8,4,0,0,3,3,3,0");
    frames(10, 0);
    tell_imu("VNWRG,75,2,8,11,0129,0040");
    frames(SETUP_FRAMES / 2u + REST_FRAMES, 0);
}

/* Speeds up for 10 beats, cruises, slows down. */
static void set_amplitudes(void) {
    for (unsigned k = 0; k < BEATS; k++) {
        const double edge = fmin(1, fmin((k + 1.0) / 10, (BEATS - (double)k) / 10));
        applied_rad[k] = (float)(0.197 + 0.36 * edge * edge);
    }
}

static void begin(void) {
    const estimate_config_t config = {.source = SPEED_SOURCE_IMU,
                                      .beat_s = 1.0f,
                                      .beats = BEATS,
                                      .rest_sigma_m_s = 0.003f,
                                      .rest_min_s = 5.0f,
                                      .sigma_max_m_s = 1.0f};
    rest_mean_t mean;
    REQUIRE(rest_get(&rest, &mean));
    const estimate_rest_t before = {
        .begin_s = -mean.still_s, .still_s = mean.still_s, .tilt_sigma_rad = mean.tilt_sigma_rad};
    motion_begin(&motion, &mean, NULL);
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    start_us = world_time_us(world) + WORLD_FRAME_US;
}

static void swim_tail(void) {
    static const gait_config_t config = {.servo = {.centre_us = 1500.0f,
                                                   .us_per_rad = 572.9578f,
                                                   .min_us = 900.0f,
                                                   .max_us = 2100.0f,
                                                   .direction = 1.0f},
                                         .frames_per_beat = BEAT_FRAMES,
                                         .coast_frames = 25};
    gait_t gait;
    gait_init(&gait);
    for (unsigned i = 0; i < BEATS * BEAT_FRAMES + COAST_FRAMES; i++) {
        const unsigned next = (i + BEAT_FRAMES - 1u) / BEAT_FRAMES;
        const gait_command_t command = {.swim = i < BEATS * BEAT_FRAMES,
                                        .amplitude_rad =
                                            applied_rad[next < BEATS ? next : BEATS - 1u]};
        frames(1, gait_frame_isr(&gait, &config, command).pulse_ticks);
    }
}

static void end(swim_t *swim, const level_t *level) {
    rest_mean_t mean;
    REQUIRE(rest_get(&rest, &mean));
    const float begin_s = since_start_s(world_time_us(world)) - mean.still_s;
    const estimate_rest_t after = {.begin_s = begin_s,
                                   .still_s = (float)speed.next_close * SPEED_SLOT_S - begin_s,
                                   .tilt_sigma_rad = motion_tilt_sigma(&motion, level->scale_sd)};
    estimate_after(&estimate, BEATS, &after);
    while (!estimate_finish(&estimate)) {
    }
    REQUIRE(world_true_beats(world, swim->true_m_s, BEATS) == BEATS);
    for (uint16_t k = 0; k < BEATS; k++) {
        swim->beat[k] = estimate_result(&estimate, k);
    }
}

static void swim_once(swim_t *swim, uint64_t seed, sim_plant_t plant, const level_t *level) {
    set_amplitudes();
    power_on(seed, plant, level);
    begin();
    swim_tail();
    frames(CAUGHT_FRAMES, 0);
    end(swim, level);
    world_free(world);
}

#endif
