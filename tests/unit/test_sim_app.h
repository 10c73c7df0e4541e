/*
 * A stand-in for the firmware in the simulator's own tests: swims the given amplitudes from a given
 * tick on, repeats every |repeat_ticks|, sends a message now and then and digests what it receives.
 * The LED is on in the ticks that |led| says.
 */
#ifndef TEST_SIM_APP_H
#define TEST_SIM_APP_H

#include "app/app.h"
#include "hal/clock.h"
#include "hal/serial.h"
#include "hal/servo.h"
#include "hal/system.h"
#include "imu/imu.h"
#include "sim.h"

#include <math.h>
#include <string.h>

#define TEST_TWO_PI 6.28318530717958647692

static struct {
    hal_t *hal;
    const double *amplitude_rad;
    unsigned beats, start_tick, repeat_ticks;
    unsigned inits, ticks, polls;
    unsigned stop_tick;         /* straight to no pulses; 0 = never */
    bool (*led)(unsigned tick); /* NULL = never */
    bool quiet;
    bool reset_at_next_poll;
    uint64_t last_poll_us, longest_gap_us;
    uint32_t digest;
    uint8_t radio[8192];
    size_t radio_length;
    imu_t imu;
    imu_frame_t imu_frame;
    unsigned imu_frames;
} script;

static const imu_driver_config_t script_imu = {
    .baud = 115200, .rate_hz = 100, .port = 0, .heading = -1, .mount = 0};

static inline void script_reset(const double *amplitude_rad, unsigned beats, unsigned start_tick) {
    memset(&script, 0, sizeof script);
    script.amplitude_rad = amplitude_rad;
    script.beats = beats;
    script.start_tick = start_tick;
}

void app_init(app_t *app, hal_t *hal) {
    (void)app;
    script.hal = hal;
    script.inits++;
    script.ticks = 0;
    script.last_poll_us = 0;
    imu_init(&script.imu, &script_imu, 0);
}

static void digest(const uint8_t *bytes, size_t length) {
    for (size_t i = 0; i < length; i++) {
        script.digest = (script.digest ^ bytes[i]) * 16777619u;
    }
}

static void take_imu(void) {
    uint8_t bytes[512];
    const size_t length = hal_serial_read(script.hal, HAL_PORT_IMU, bytes, sizeof bytes);
    digest(bytes, length);
    for (size_t at = 0; at < length;) {
        bool got = false;
        imu_sample_t sample;
        at +=
            imu_push(&script.imu, bytes + at, length - at, hal_time_us(script.hal), &sample, &got);
        script.imu_frames += got;
        script.imu_frame = got ? sample.frame : script.imu_frame;
    }
}

static void serve_imu(void) {
    const uint32_t overruns = hal_serial_errors(script.hal, HAL_PORT_IMU).overruns;
    for (;;) {
        const imu_action_t action = imu_poll(&script.imu, overruns, hal_time_us(script.hal));
        if (action.what == IMU_DO_NOTHING) {
            return;
        }
        if (action.what == IMU_DO_SET_BAUD) {
            uint8_t old[512];
            hal_serial_set_baud(script.hal, HAL_PORT_IMU, action.baud);
            while (hal_serial_read(script.hal, HAL_PORT_IMU, old, sizeof old) > 0) {
            }
        } else {
            hal_serial_write(script.hal, HAL_PORT_IMU, (const uint8_t *)action.bytes,
                             action.length);
        }
    }
}

void app_poll(app_t *app) {
    (void)app;
    const uint64_t now = hal_time_us(script.hal);
    const uint64_t gap = now - script.last_poll_us;
    script.longest_gap_us = gap > script.longest_gap_us ? gap : script.longest_gap_us;
    script.last_poll_us = now;
    take_imu();
    serve_imu();
    uint8_t *at = script.radio + script.radio_length;
    script.radio_length +=
        hal_serial_read(script.hal, HAL_PORT_RADIO, at, sizeof script.radio - script.radio_length);
    if (++script.polls % 7 == 0 && !script.quiet) {
        uint8_t message[24];
        memset(message, (int)(script.digest & 0xFF), sizeof message);
        hal_serial_write(script.hal, HAL_PORT_RADIO, message, 1 + script.polls % sizeof message);
    }
    if (script.reset_at_next_poll) {
        script.reset_at_next_poll = false;
        hal_reset(script.hal);
    }
}

void app_tick_isr(app_t *app) {
    (void)app;
    const unsigned tick = script.ticks++;
    hal_led_isr(script.hal, script.led != NULL && script.led(tick));
    unsigned frame = tick - script.start_tick;
    if (script.repeat_ticks != 0 && tick >= script.start_tick) {
        frame %= script.repeat_ticks;
    }
    const bool stopped = script.stop_tick != 0 && tick >= script.stop_tick;
    if (tick < script.start_tick || frame >= script.beats * 50 || stopped) {
        hal_servo_pulse_isr(script.hal, HAL_SERVO_TAIL, 0);
        return;
    }
    const double angle = script.amplitude_rad[frame / 50] * sin(TEST_TWO_PI * (frame % 50) / 50);
    hal_servo_pulse_isr(script.hal, HAL_SERVO_TAIL,
                        (uint16_t)lround(3 * (1500 + 572.9578 * angle)));
}

#endif
