/* The world of the random walk: time, ticks and passes as they come, hosts, IMU, battery, flash. */
#ifndef WALK_WORLD_H
#define WALK_WORLD_H

#include "imu_stream.h"
#include "walk_model.h"

#include <stdlib.h>

#define TICK_US 20000u
#define PASS_US 10000u
#define HOSTS 4u
#define HEARTBEAT_US 200000u
#define GOOD_MV 8000u

static const host_t HOST[HOSTS] = {
    {HAL_PORT_RADIO, 255}, {HAL_PORT_CONSOLE, 250}, {HAL_PORT_RADIO, 250}, {HAL_PORT_CONSOLE, 255}};

typedef enum { IMU_LEVEL, IMU_SILENT, IMU_TILTED, IMU_TURNED_OVER, IMU_NOT_NUMBERS } imu_mood_t;

static struct {
    uint64_t random;
    uint64_t tick_at_us, pass_at_us; /* the next ones */
    uint64_t tick_due_us;            /* as the servo's timer means it */
    uint64_t heartbeat_at_us[HOSTS];
    bool talks[HOSTS];
    imu_mood_t imu;
    uint64_t sensor_ns;
    uint64_t sag_until_us; /* 0 = the battery stays as it is */
    uint32_t resets;       /* that the board asked for */
    double boots_s;        /* time of earlier boots */
    uint32_t boots;
} world;

/* xorshift64* */
static uint32_t draw(uint32_t below) {
    world.random ^= world.random >> 12;
    world.random ^= world.random << 25;
    world.random ^= world.random >> 27;
    const uint64_t mixed = world.random * 2685821657736338717ull;
    return (uint32_t)(((mixed >> 32) * below) >> 32);
}

static bool chance(uint32_t one_in) { return draw(one_in) == 0; }

static void set_angles(uint8_t *frame) {
    const float tilt_deg = world.imu == IMU_TILTED        ? 25.0f + (float)draw(60)
                           : world.imu == IMU_TURNED_OVER ? 180.0f
                           : world.imu == IMU_NOT_NUMBERS ? NAN
                                                          : (float)draw(20);
    const bool pitches = world.imu == IMU_TILTED && chance(2);
    const float signed_deg = chance(2) ? tilt_deg : -tilt_deg;
    const float ypr_deg[3] = {(float)draw(360) - 180.0f, pitches ? signed_deg : 0.0f,
                              pitches ? 0.0f : signed_deg};
    memcpy(frame + 14, ypr_deg, sizeof ypr_deg);
    model.frame_good = world.imu != IMU_NOT_NUMBERS;
    if (model.frame_good) {
        model.tilt_rad = tilt_deg * 0.0174532925f;
    }
}

/* One waits on the line when the main loop comes by. */
static void send_frame(void) {
    uint8_t frame[sizeof OWN_FRAME];
    memcpy(frame, OWN_FRAME, sizeof frame);
    world.sensor_ns += PASS_US * 1000u;
    memcpy(frame + 6, &world.sensor_ns, sizeof world.sensor_ns);
    set_angles(frame);
    seal_frame(frame, sizeof frame);
    mock_feed(&hal, HAL_PORT_IMU, frame, sizeof frame);
    model.frame_waits = true;
}

static void one_tick(void) {
    hal.pulse_count = 0;
    app_tick_isr(&app);
    CHECK(hal.pulse_count == 1);
    model_tick(hal.pulses[0]);
    world.tick_due_us += TICK_US;
    world.tick_at_us = world.tick_due_us;
}

/* The pass has just read what the tick before found, and has yet to act on it. */
static void tick_comes_in_between(hal_t *board) {
    board->on_unlock = NULL;
    one_tick();
    seen.in_between++;
}

static void start_world(hal_reset_cause_t cause) {
    world.boots_s += (double)hal.now_us * 1e-6;
    world.boots++;
    hal.now_us = 0;
    hal.reset_cause = cause;
    world.tick_at_us = world.tick_due_us = TICK_US;
    world.pass_at_us = PASS_US;
    world.sag_until_us = 0;
    memset(world.heartbeat_at_us, 0, sizeof world.heartbeat_at_us);
    for (int port = 0; port < HAL_PORT_COUNT; port++) {
        hal.rx[port].head = hal.rx[port].tail = 0;
    }
    world.resets = hal.resets;
}

static state_t state_after_boot(hal_reset_cause_t cause, bool crashed, fault_t *reason) {
    *reason = crashed                       ? FAULT_CRASH
              : cause == HAL_RESET_WATCHDOG ? FAULT_WATCHDOG
              : hal.clock_inexact           ? FAULT_CLOCK
                                            : FAULT_NONE;
    if (app.supervisor.reason == FAULT_STORAGE && model.flash_hurt) {
        *reason = FAULT_STORAGE;
    }
    return *reason == FAULT_NONE ? STATE_IDLE : STATE_FAULT;
}

/* What a reset keeps: the flash. A trial that was open may have been saved as far as it went. */
static void compare_after_boot(bool was_pending, bool was_open) {
    CHECK(model.flash_hurt || was_open || app.trial.run.pending == was_pending);
    CHECK(model.flash_hurt || !was_pending || app.trial.run.pending);
    model.pending = app.trial.run.pending;
    CHECK(model.flash_hurt || model.beats == app.learner.reference.beats);
    model.beats = app.learner.reference.beats;
    model.beat_s = app.learner.reference.beat_s;
    model.params = app.params;
    compare_state();
}

/* The board restarts; its pins let go of the servo meanwhile. */
static void boot(hal_reset_cause_t cause) {
    const bool was_pending = model.pending, was_open = app.trial.run.open, crashed = hal.crashed;
    start_world(cause);
    app_init(&app, &hal);
    const uint16_t beats = model.beats;
    const uint32_t last_started = model.last_started, next_seen = model.next_seen;
    const bool fails = model.flash_fails, hurt = model.flash_hurt;
    const float beat_s = model.beat_s;
    memset(&model, 0, sizeof model);
    model.beats = beats;
    model.beat_s = beat_s;
    model.last_started = last_started;
    model.next_seen = next_seen;
    model.flash_fails = fails;
    model.flash_hurt = hurt;
    model.armer = (host_t){HAL_PORT_RADIO, 0};
    fault_t reason;
    const state_t state = state_after_boot(cause, crashed, &reason);
    model_enter(state, reason);
    compare_after_boot(was_pending, was_open);
    model.flash_hurt = fails;
}

static void talk(void) {
    for (uint32_t i = 0; i < HOSTS; i++) {
        if (world.talks[i] && hal.now_us >= world.heartbeat_at_us[i]) {
            world.heartbeat_at_us[i] = hal.now_us + HEARTBEAT_US;
            app.link.handlers.heartbeat(&app, HOST[i].port, HOST[i].system, 190);
            model_heartbeat(HOST[i]);
        }
    }
}

static void one_pass(void) {
    talk();
    if (world.imu != IMU_SILENT) {
        send_frame();
    }
    if (world.sag_until_us != 0 && hal.now_us >= world.sag_until_us) {
        world.sag_until_us = 0;
        hal.battery_mv = GOOD_MV;
    }
    const bool was_open = app.trial.run.open;
    model_reads_tick();
    app_poll(&app);
    hal.tx[HAL_PORT_RADIO].head = hal.tx[HAL_PORT_RADIO].tail = 0;
    hal.tx[HAL_PORT_CONSOLE].head = hal.tx[HAL_PORT_CONSOLE].tail = 0;
    hal.tx[HAL_PORT_IMU].head = hal.tx[HAL_PORT_IMU].tail = 0;
    model_pass(was_open);
    if (hal.resets != world.resets) {
        CHECK(model.reboot_us != 0 && hal.now_us >= model.reboot_us);
        boot(HAL_RESET_SOFTWARE);
    } else {
        CHECK(model.reboot_us == 0 || hal.now_us < model.reboot_us);
    }
}

/* Whatever is due in the next |us|; a restart ends it. */
static void pass_time(uint64_t us, uint32_t pass_us) {
    const uint64_t end_us = hal.now_us + us;
    const uint32_t boots = world.boots;
    while (boots == world.boots) {
        const bool together = world.tick_at_us == world.pass_at_us && chance(4);
        const bool tick_first = world.tick_at_us <= world.pass_at_us && !together;
        const uint64_t next_us = tick_first ? world.tick_at_us : world.pass_at_us;
        if (next_us > end_us) {
            hal.now_us = end_us;
            return;
        }
        hal.now_us = next_us > hal.now_us ? next_us : hal.now_us;
        if (tick_first) {
            one_tick();
        } else {
            world.pass_at_us = hal.now_us + pass_us;
            hal.on_unlock = together ? tick_comes_in_between : NULL;
            one_pass();
        }
    }
}

static void mend_board(void) {
    world.imu = IMU_LEVEL;
    world.sag_until_us = 0;
    hal.battery_mv = GOOD_MV;
    hal.flash_fail_after = 0;
    model.flash_fails = false;
    for (uint32_t i = 0; i < HOSTS; i++) {
        world.talks[i] = true;
    }
}

static void let_flash_fail(void) {
    hal.flash_fail_after = hal.flash_writes;
    model.flash_fails = model.flash_hurt = true;
}

#endif
