/*
 * What speeds cost on the fish's processor: frames of the IMU, slots and beats of a swim that has
 * all of them. Every piece lies between a mark BEGIN + kind and a mark END
 * (bench/estimate_cost.py).
 */
#include "speed/estimate.h"
#include "base/crc.h"
#include "base/real.h"
#include "imu/imu.h"
#include "speed/motion.h"

#include <string.h>

/* motion.c as it would be in floating point, for comparison. */
#define PLAIN_SLOTS 48
#define REAL float
#define ROOT(x) real_sqrt(x)
#define NAME(x) x##_float
#include "motion_plain.h"

enum {
    IMU_PUSH,
    REST_PUSH,
    MOTION_PUSH,
    MOTION_FORWARD,
    FORWARD,
    BACK = FORWARD + 4,
    MOTION_PLAIN = BACK + 4
};
#define BEGIN 0x100u
#define END 0u

#define RATE_HZ 100u
#define FRAMES (4u * RATE_HZ)
#define BEATS 32u
#define SLOTS ((BEATS + 12u) * 10u)

void panic(const char *where);

_Noreturn void panic(const char *where) {
    (void)where;
    for (;;) {
    }
}

static imu_t imu;
static rest_t rest;
static motion_t motion;
static plain_t_float plain;
static speed_t speed;
static estimate_t estimate;
static float speed_m_s[BEATS_MAX], sigma_m_s[BEATS_MAX];
static uint32_t random_state;

/* -1 to 1 */
static float noise(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return (float)(int32_t)random_state * (1.0f / 2147483648.0f);
}

static void make_frame(uint32_t number, uint8_t frame[IMU_FRAME_BYTES]) {
    const uint64_t time_ns = number * (1000000000ull / RATE_HZ);
    float values[12];
    for (uint32_t i = 0; i < 12u; i++) {
        values[i] = noise();
    }
    values[8] -= 9.81f;
    memcpy(frame, imu_frame_header, IMU_FRAME_HEADER_BYTES);
    memcpy(frame + IMU_FRAME_HEADER_BYTES, &time_ns, sizeof time_ns);
    memcpy(frame + IMU_FRAME_HEADER_BYTES + sizeof time_ns, values, sizeof values);
    const uint16_t crc = crc16_update(0, frame + 1, IMU_FRAME_BYTES - 3u);
    frame[IMU_FRAME_BYTES - 2u] = (uint8_t)(crc >> 8);
    frame[IMU_FRAME_BYTES - 1u] = (uint8_t)crc;
}

static bool push_frame(uint32_t number, imu_sample_t *sample) {
    uint8_t frame[IMU_FRAME_BYTES];
    bool got;
    make_frame(number, frame);
    MARK = BEGIN + IMU_PUSH;
    (void)imu_push(&imu, frame, sizeof frame, number * (1000000u / RATE_HZ), sample, &got);
    MARK = END;
    return got;
}

static void feel(void) {
    const imu_driver_config_t config = {.baud = 115200, .rate_hz = RATE_HZ, .heading = -1};
    imu_sample_t sample;
    imu_init(&imu, &config, 0);
    imu.driver.state = IMU_STREAMING;
    rest_init(&rest);
    memset(&motion, 0, sizeof motion);
    for (uint32_t i = 1; i <= FRAMES; i++) {
        if (!push_frame(i, &sample)) {
            continue;
        }
        if (!motion.begun) {
            motion_begin(&motion, NULL, &sample.frame);
            begin_float(&plain, &(rest_mean_t){.accel_m_s2 = {0.0f, 0.0f, -9.81f}});
        }
        MARK = BEGIN + REST_PUSH;
        rest_push(&rest, &sample.frame, sample.dt_s);
        MARK = END;
        MARK = BEGIN + MOTION_PUSH;
        motion_push(&motion, &sample.frame, (float)i / RATE_HZ, sample.dt_s);
        MARK = END;
        MARK = BEGIN + MOTION_PLAIN;
        push_float(&plain, &sample.frame, (float)i / RATE_HZ, sample.dt_s);
        MARK = END;
    }
    for (uint16_t slot = 10; slot < 20; slot++) {
        float gain_m_s, way_m;
        MARK = BEGIN + MOTION_FORWARD;
        (void)motion_forward(&motion, slot, 1.0f, &gain_m_s, &way_m);
        MARK = END;
    }
}

static estimate_config_t config_of(speed_source_t source) {
    return (estimate_config_t){
        .source = source,
        .beat_s = 1.0f,
        .beats = BEATS,
        .vision = {.window_s = 1.0f, .gap_max_s = 0.5f, .plausible_m_s = 0.5f},
        .thrust = {.kappa_per_m = 10.0f,
                   .slope_m_s_rad = 0.219f,
                   .dead_zone_rad = 0.197f,
                   .delay_s = 0.3f},
        .model_sigma = 0.25f,
        .rest_sigma_m_s = 0.003f,
        .rest_min_s = 5.0f,
        .sigma_max_m_s = 0.02f,
    };
}

static speed_slot_t make_slot(uint16_t index, speed_source_t source) {
    speed_slot_t slot = {.index = index,
                         .gain_10um_s = (int16_t)(200.0f * noise()),
                         .way_um = (int16_t)(100.0f * noise())};
    if (source == SPEED_SOURCE_VISION && index < BEATS * 10u) {
        slot.speed_m_s = 0.05f + 0.001f * noise();
        slot.sigma_10um_s = 100;
        slot.samples = 3;
        slot.at_ms = 50;
    }
    return slot;
}

static void swim(speed_source_t source) {
    const estimate_config_t config = config_of(source);
    const estimate_rest_t before = {.begin_s = -8.0f, .still_s = 8.0f};
    const estimate_rest_t after = {.begin_s = (float)BEATS + 3.0f, .still_s = 8.0f};
    speed_init(&speed);
    estimate_begin(&estimate, &config, &before, speed_m_s, sigma_m_s);
    for (uint16_t i = 0; i < SLOTS; i++) {
        const speed_slot_t slot = make_slot(i, source);
        (void)speed_restore_slot(&speed, &slot);
        while ((float)speed.next_close * SPEED_SLOT_S >= estimate_needs_s(&estimate)) {
            MARK = BEGIN + FORWARD + (uint32_t)source;
            (void)estimate_beat(&estimate, &speed, 0.4f);
            MARK = END;
        }
    }
    estimate_after(&estimate, BEATS, source == SPEED_SOURCE_IMU ? &after : &(estimate_rest_t){0});
    bool done = false;
    while (!done) {
        MARK = BEGIN + BACK + (uint32_t)source;
        done = estimate_finish(&estimate);
        MARK = END;
    }
}

void program(void) {
    random_state = 1;
    feel();
    swim(SPEED_SOURCE_VISION);
    swim(SPEED_SOURCE_IMU);
    swim(SPEED_SOURCE_MODEL);
}
