/* A wire to the simulated VN-100 without a board: says commands, collects lines and frames. */
#ifndef TEST_SIM_VN100_H
#define TEST_SIM_VN100_H

#include "base/crc.h"
#include "unity.h"
#include "world.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define DEG 0.017453292519943295
#define G_M_S2 9.793746
#define FRAME_BYTES 64u
#define FISH_FRAME "VNWRG,75,2,8,11,0129,0040"

/* The fish's 64-byte frame, by the offsets of the manual. */
typedef struct {
    uint64_t due_us, time_ns;
    double ypr_deg[3], rate_rad_s[3], accel_m_s2[3], linear_m_s2[3];
} reading_t;

typedef struct {
    world_t *world;
    uint64_t now_us;
    double amplitude_rad; /* of the tail, 1 Hz; 0 = no pulses */
    unsigned swum;        /* frames of this swim */
    uint32_t baud;        /* of our end */
    char line[700];       /* the last one, without CR LF */
    char answer[700];     /* the last one that is no measurement */
    unsigned lines, answers, errors, messages, frames, bad;
    size_t bytes;
    uint32_t digest;
    void (*take)(const reading_t *reading); /* of each frame; may be NULL */
    reading_t last;
} wire_t;

static inline sim_config_t vn100_config(double noise) {
    sim_config_t c;
    sim_config_default(&c, SIM_PLANT_TANK);
    c.imu_noise = noise;
    c.start_sigma_m_s = c.flow_sigma_m_s = 0;
    c.place_sigma_m = c.place_sigma_rad = 0;
    return c;
}

static inline void wire_open(wire_t *wire, const sim_config_t *config) {
    memset(wire, 0, sizeof *wire);
    wire->world = world_new(config);
    TEST_ASSERT_NOT_NULL(wire->world);
    wire->baud = 115200;
    world_imu_power_on(wire->world, 0);
}

static inline void wire_close(wire_t *wire) {
    world_free(wire->world);
    wire->world = NULL;
}

static inline uint16_t wire_pulse(wire_t *wire) {
    if (wire->amplitude_rad <= 0) {
        wire->swum = 0;
        return 0;
    }
    const double angle =
        wire->amplitude_rad * sin(2 * 3.14159265358979323846 * (wire->swum++ % 50) / 50);
    return (uint16_t)lround(3 * (1500 + 572.9578 * angle));
}

static inline void wire_follow(wire_t *wire, uint64_t until_us) {
    while (world_time_us(wire->world) + WORLD_FRAME_US <= until_us) {
        world_frame(wire->world, world_time_us(wire->world) + WORLD_FRAME_US, wire_pulse(wire));
    }
}

static inline void wire_triple(const uint8_t *at, double out[3]) {
    for (unsigned i = 0; i < 3; i++) {
        float value;
        memcpy(&value, at + 4 * i, 4);
        out[i] = (double)value;
    }
}

static inline reading_t wire_reading(const uint8_t *frame, uint64_t due_us) {
    reading_t r = {.due_us = due_us};
    memcpy(&r.time_ns, frame + 6, 8);
    wire_triple(frame + 14, r.ypr_deg);
    wire_triple(frame + 26, r.rate_rad_s);
    wire_triple(frame + 38, r.accel_m_s2);
    wire_triple(frame + 50, r.linear_m_s2);
    return r;
}

static inline void wire_line(wire_t *wire) {
    static const char *const measured[] = {"YPR", "YMR", "YBA", "YIA", "IMU", "QMR"};
    for (unsigned i = 0; i < sizeof measured / sizeof measured[0]; i++) {
        if (strncmp(wire->line + 3, measured[i], 3) == 0) {
            return;
        }
    }
    memcpy(wire->answer, wire->line, sizeof wire->line);
    wire->answers++;
    wire->errors += strncmp(wire->line, "$VNERR", 6) == 0;
}

static inline void wire_message(wire_t *wire, const uint8_t *bytes, size_t length, uint64_t due) {
    wire->messages++;
    wire->bytes += length;
    for (size_t i = 0; i < length; i++) {
        wire->digest = (wire->digest ^ bytes[i]) * 16777619u;
    }
    if (length > 2 && bytes[0] == '$' && bytes[length - 1] == '\n') {
        memcpy(wire->line, bytes, length - 2);
        wire->line[length - 2] = '\0';
        wire->lines++;
        wire_line(wire);
    } else if (length > 0 && bytes[0] == 0xFA && crc16_update(0, bytes + 1, length - 1) == 0) {
        wire->frames++;
        if (length == FRAME_BYTES) {
            wire->last = wire_reading(bytes, due);
            if (wire->take != NULL) {
                wire->take(&wire->last);
            }
        }
    } else {
        wire->bad++;
    }
}

/* All messages that begin by |until_us|. */
static inline void wire_run(wire_t *wire, uint64_t until_us) {
    uint8_t bytes[WORLD_IMU_MESSAGE_MAX];
    for (uint64_t due; (due = world_imu_due_us(wire->world)) <= until_us;) {
        wire_follow(wire, due);
        wire_message(wire, bytes, world_imu_read(wire->world, bytes), due);
    }
    wire_follow(wire, until_us);
    wire->now_us = until_us;
}

static inline void wire_say(wire_t *wire, const char *text) {
    world_imu_write(wire->world, wire->now_us, (const uint8_t *)text, strlen(text), wire->baud);
}

/* Says |text| as it stands and CR LF; what came back within 20 ms, "" = nothing. */
static inline const char *wire_ask(wire_t *wire, const char *text) {
    const unsigned before = wire->answers;
    wire_say(wire, text);
    wire_say(wire, "\r\n");
    wire_run(wire, wire->now_us + 20000);
    return wire->answers != before ? wire->answer : "";
}

/* Says a body without check; the body of what comes back. */
static inline const char *wire_command(wire_t *wire, const char *body) {
    static char reply[sizeof wire->answer];
    wire_say(wire, "$");
    wire_say(wire, body);
    const char *got = wire_ask(wire, "*XX");
    memset(reply, 0, sizeof reply);
    memcpy(reply, got + (got[0] == '$'), strcspn(got + (got[0] == '$'), "*"));
    return reply;
}

static inline void wire_set(wire_t *wire, const char *body) {
    TEST_ASSERT_EQUAL_STRING(body, wire_command(wire, body));
}

/* Started, with nothing but the fish's frame at 100 Hz, averaged over the whole period. */
static inline void wire_stream(wire_t *wire) {
    wire_run(wire, 1000000);
    wire_set(wire, "VNWRG,06,0");
    wire_set(wire, "VNWRG,85,0,8,8,4,0,0,3,3,3,0");
    wire_set(wire, FISH_FRAME);
}

#endif
